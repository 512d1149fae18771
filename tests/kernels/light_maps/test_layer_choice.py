"""Which layer of a split light map a receiver reads, against a loop in float64."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
import small_scenes
import warp as wp
from light_map_probe import LIGHTS, host_locate, locate_all

from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import FILTER_TEXELS
from wkernels.projections.focusing import fitted_view, light_space
from wkernels.scene.geometry import Bounds, Geometry
from wkernels.scene.views import HostView, LayerChoice

R = 64
ENDS = (10.0, 13.0, np.inf)


@pytest.mark.parametrize("rule", ["depth", "best"])
@pytest.mark.parametrize("kind", ["directional", "perspective"])
@pytest.mark.parametrize("distance", [np.inf, 0.7])
def test_the_layer_is_the_one_that_the_rule_names(
    rule: Literal["depth", "best"], kind: str, distance: float, device: str
) -> None:
    def projection(
        light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        scene = Bounds()
        scene.add(np.concatenate([receivers.corners, casters.corners]))
        space = light_space(light_ws, scene.corners, scene, eye)
        assert space is not None
        row = (*(float(x) for x in eye.forward_ws), -float(eye.forward_ws @ eye.eye_ws))
        parts = [0.25 * scene.corners + shift for shift in ((0, 0, -1.0), (0.5, 0, 0), (0, 0, 0))]
        sizes = (1.0, 1.5, 4.0)
        choices = [LayerChoice(rule, row, end) for end in ENDS]
        return [
            fitted_view(space, size * part, resolution, distance, None, choice)
            for size, part, choice in zip(sizes, parts, choices, strict=True)
        ]

    geometry = Geometry(small_scenes.cluttered(LIGHTS[kind]), device)  # type: ignore[arg-type]
    session = Session(geometry, width=8, height=8, device=device, projection=projection)
    light_map = session.light_map(R).map
    views = session.shown.views
    rng = np.random.default_rng(3)
    box = geometry.bounds(receivers=True)
    points = rng.uniform(box.low - 1.0, box.high + 1.0, (5000, 3)).astype(np.float32).astype(float)

    found = wp.zeros(len(points), dtype=wp.vec4, device=device)
    density = wp.zeros(len(points), dtype=wp.vec2, device=device)
    positions = wp.array(points.astype(np.float32), dtype=wp.vec3, device=device)
    launch(locate_all, len(points), [light_map, positions], [found, density], device=device)

    eye = session.eye()
    eye_depth = (points - eye.eye_ws) @ eye.forward_ws
    inside = host_locate(views, points, R)[2]
    expected = np.full(len(points), -1)
    for i in range(len(points)):
        held = [layer for layer in range(3) if inside[i, layer] >= 0.0]
        if rule == "depth":
            first = [layer for layer in held if eye_depth[i] < ENDS[layer]]
        else:
            first = [layer for layer in held if inside[i, layer] >= 2.0 * float(FILTER_TEXELS) / R]
        expected[i] = first[0] if first else held[-1] if held else -1
    # float32 may decide otherwise within rounding of a border
    border = np.abs(inside).min(axis=1) < 1e-4
    border |= np.abs(inside - 2.0 * float(FILTER_TEXELS) / R).min(axis=1) < 1e-4
    border |= np.abs(eye_depth[:, None] - np.array(ENDS[:2])).min(axis=1) < 1e-4
    layers = found.numpy()[:, 3].astype(int)
    np.testing.assert_array_equal(layers[~border], expected[~border])
    assert set(expected[~border]) == {-1, 0, 1, 2} and border.mean() < 0.05

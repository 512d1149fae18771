"""pcf_split_kernel: softness in the world across splits, without and with warps, against pcf's in texels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
from filtering_sessions import session, technique

from wkernels.light_maps.layer_density import layer_densities
from wkernels.scene.lights import DirectionalLight, Light, PointLight
from wkernels.scene.model import Camera, Scene

SPLITS = {"fit": "focused", "splits": 3, "scheme": "log"}
R = 512


def long_edge(light: Light) -> Scene:
    """A caster over x > 0 high above the ground, whose shadow's edge runs away from the eye."""
    ground = small.mesh("ground", small.plane(80.0), casts=False)
    caster = small.mesh("half plane", small.plane(160.0, y=5.0, centre=(80.0, 0.0)), receives=False)
    eye = Camera(np.array([0.0, 3.0, -40.0]), np.array([0.0, 0.0, -34.0]), np.array([0.0, 1.0, 0.0]), 60.0, 0.5, 45.0)
    return small.scene([ground, caster], light, eye)


SUN = DirectionalLight(direction=np.array([0.0, -1.0, 0.0]))
WIDE = 3.0
H = np.linspace(-1.0, 1.0, 2001)
DISC = (np.arccos(H) - H * np.sqrt(1.0 - H * H)) / np.pi
"""The ramp of a disc of radius 1."""
EXPECTED = 0.5 * WIDE * 6.0 * float(np.trapezoid(DISC * (1.0 - DISC), H))


def softness(name: str, projection: dict[str, Any], light: Light = SUN, **params: Any) -> tuple[np.ndarray, ...]:
    """Depths of the picture's rows, the width of the shadow's edge there (of a disc's ramp), and which split is read."""
    frame = session(long_edge(light), size=(128, 128), projection=projection)
    result = frame.render(technique(name, resolution=R, **params))
    eye = frame.eye()
    world = result.world_position.astype(float)
    place = world - frame.geometry.origin_ws
    depth, width, split = [], [], []
    ends = [view.choice.far for view in frame.shown.views]  # type: ignore[index, union-attr]
    for row in range(128):
        near = np.abs(world[row, :, 0]) < 4.0  # the edge lies on x = 0
        lit, x = result.visibility[row, near], world[row, near, 0]
        if not near.any() or np.isnan(lit).any():  # the sky, and the caster seen from below
            continue
        assert lit.min() == 0.0 and lit.max() == 1.0 and len(x) > 20
        order = np.argsort(x)
        z = float((place[row, near][0] - eye.eye_ws) @ eye.forward_ws)
        # of a linear ramp from 0 to 1 the integral of v (1 - v) is a sixth of its width
        width.append(6.0 * float(np.trapezoid((lit * (1.0 - lit))[order], x[order])))
        depth.append(z)
        split.append(int(np.searchsorted(ends, z, side="right")))
    return np.array(depth), np.array(width), np.array(split)


def by_split(width: np.ndarray, split: np.ndarray) -> list[float]:
    return [float(np.median(width[split == i])) for i in np.unique(split)]


def texel_sizes(projection: dict[str, Any]) -> np.ndarray:
    frame = session(long_edge(SUN), size=(64, 64), projection=projection)
    frame.light_map(R)
    views, sample = frame.shown.views, frame.shown.light_ws  # type: ignore[misc]
    return 1.0 / layer_densities(views, sample, np.zeros(3))[:, 0]


@pytest.mark.parametrize("scale", ["layer", "receiver"])
def test_softness_is_the_same_in_all_splits(scale: str) -> None:
    _, width, split = softness("pcf_split_kernel", SPLITS, diameter=WIDE, scale=scale)
    found, texels = by_split(width, split), texel_sizes(SPLITS)
    assert len(found) == 3 and texels.max() < 0.5 * EXPECTED
    for one, texel in zip(found, texels, strict=True):
        assert abs(one - found[0]) <= texel, (found, texels)
    np.testing.assert_allclose(found, EXPECTED, rtol=0.1)


def test_without_it_softness_jumps_at_each_border() -> None:
    """Stingl 2011, Fig 3.22a: a kernel in texels is as much wider as the texels are."""
    _, width, split = softness("pcf", SPLITS, radius=4.0, taps=64)
    found, texels = by_split(width, split), texel_sizes(SPLITS)
    for i in (0, 1):
        assert found[i + 1] / found[i] > 1.5
        assert found[i + 1] / found[i] == pytest.approx(texels[i + 1] / texels[i], rel=0.15)


def test_a_warp_blows_the_layers_kernel_up_away_from_the_eye() -> None:
    """Equation 3.9 knows the split's extent alone; what is measured at the receiver stays what it is."""
    warped = {**SPLITS, "splits": 2, "warp": "lispsm_nopt"}
    spread = {}
    for scale in ("layer", "receiver"):
        depth, width, split = softness("pcf_split_kernel", warped, diameter=WIDE, scale=scale)
        far = split == 1
        first, last = width[far][np.argmin(depth[far])], width[far][np.argmax(depth[far])]
        spread[scale] = last / first
    assert spread["layer"] > 1.5 and spread["receiver"] == pytest.approx(1.0, abs=0.15), spread


def test_under_a_point_light_the_receiver_s_kernel_keeps_its_size() -> None:
    """Twice as far from the light texels are twice as long, and the layer's kernel with them."""
    light = PointLight(position=np.array([0.0, 60.0, 0.0]))
    _, width, split = softness("pcf_split_kernel", SPLITS, light, diameter=WIDE, scale="receiver")
    found = by_split(width, split)
    np.testing.assert_allclose(found, EXPECTED, rtol=0.15)


def test_densities_are_finite_differences_of_the_views() -> None:
    light = np.array([10.0, 60.0, -20.0, 1.0])
    for sample in (light, np.array([0.0, 1.0, 0.0, 0.0])):
        frame = session(long_edge(SUN), size=(64, 48), projection={**SPLITS, "warp": "lispsm_nopt"})
        frame.light_map(R, sample)
        views = frame.shown.views  # type: ignore[index]
        found = layer_densities(views, sample, np.zeros(3))
        for view, density in zip(views, found, strict=True):
            rows = view.ws_to_ss
            depth = float(np.linalg.norm(light[:3])) if sample[3] else 0.0
            planes = rows[:3]
            middle = np.linalg.solve(planes[:, :3], np.array([0.0, 0.0, depth]) - planes[:, 3])
            for axis, value, row in ((view.right_ws, density[0], 0), (view.up_ws, density[1], 1)):
                ends = np.stack([middle - 1e-4 * axis, middle + 1e-4 * axis])
                h = ends @ rows[:, :3].T + rows[:, 3]
                assert abs(np.diff(h[:, row] / h[:, 3])[0]) * 0.5 * R / 2e-4 == pytest.approx(value, rel=1e-5)

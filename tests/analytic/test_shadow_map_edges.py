"""Edges of `shadow_map` lie within one texel of the exact ones of `ray_cast_point_shadow` (A8, a box on a plane)."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from experiments import render_visibility
from experiments.scenes import load_scene
from experiments.scenes.analytic import a8_box
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import Geometry

A8 = Path(__file__).parents[2] / "configs" / "scenes" / "a8_box.yaml"
SIZE = {"width": 320, "height": 240}


def texel_steps(resolution: int) -> np.ndarray:
    """One texel along the map's two axes, followed along the light onto y = 0; shape (2, 3), scene units."""
    geometry = Geometry(load_scene(A8))
    receivers, casters = geometry.bounds(receivers=True), geometry.bounds(casters=True)
    towards = geometry.scene.lights[0].centre
    (view,) = scene_views(towards, receivers, casters, resolution)
    left, right, bottom, top = view.window
    steps = np.stack([view.right_ws * (right - left), view.up_ws * (top - bottom)]) / resolution
    return steps - steps[:, 1:2] * towards[:3] / towards[1]


@pytest.mark.parametrize("resolution", [512, 2048])
@pytest.mark.parametrize("bias", ["slope", "constant", "none", "back_face"])  # normal itself moves lookups by a texel
def test_edges_within_one_texel(resolution: int, bias: str) -> None:
    exact = render_visibility(A8, "ray_cast_point_shadow", **SIZE)
    mapped = render_visibility(A8, "shadow_map", {"resolution": resolution, "bias": bias}, **SIZE)
    seen = np.isfinite(exact.visibility)
    assert np.array_equal(seen, np.isfinite(mapped.visibility))
    differs = seen & (exact.visibility != mapped.visibility)
    assert differs.any(), "a map of this size cannot be exact: the test would not see a wrong one"
    position = exact.world_position[differs].astype(np.float64)
    value = exact.visibility[differs]
    step_u, step_v = texel_steps(resolution)
    offsets = np.linspace(-1.0, 1.0, 17)
    near_edge = np.zeros(len(position), dtype=bool)
    for a in offsets:
        for b in offsets:
            near_edge |= a8_box(position + a * step_u + b * step_v) != value
    # at the foot of the box the bias, of up to one texel's depth, opens a gap towards the inside of the box
    foot = (np.abs(position[:, 0]) <= 0.5 + np.abs(step_u[0]) + np.abs(step_v[0])) & (np.abs(position[:, 2]) <= 1.0)
    assert near_edge[~foot].all()
    assert foot.mean() < 0.2


def test_edges_converge_with_resolution() -> None:
    scene = yaml.safe_load(A8.read_text(encoding="utf-8"))
    scene["meshes"][1]["transform"]["rotate_deg"] = [0, 27, 0]  # edges along texels could lie right by luck
    large = {"width": 640, "height": 480}
    exact = render_visibility(scene, "ray_cast_point_shadow", **large).visibility
    seen = np.isfinite(exact)
    shares = []
    for resolution in (256, 4096):
        mapped = render_visibility(scene, "shadow_map", {"resolution": resolution}, **large).visibility
        shares.append(float(np.mean(exact[seen] != mapped[seen])))
    assert shares[0] > 8.0 * shares[1] > 0.0

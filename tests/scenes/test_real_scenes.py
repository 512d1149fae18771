"""The scenes of configs/scenes/real, where ``make scenes`` has been: what comes in, and what the eye sees of it."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from experiments.scenes import load_scene
from experiments.scenes.assets import fetched_folder
from wkernels.frame.session import Session
from wkernels.raster import Rasteriser
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Scene

SCENES = Path(__file__).parents[2] / "configs" / "scenes" / "real"
TRIANGLES = {
    "sponza": 66_450,
    "monastery": 124_789,
    "san_francisco": 268_041,
    "trees": 307_208,
    "thin_features": 87_836,
    "dragon": 202_522,
    "fox": 578,
    "engine": 121_498,
}
"""With the ground that a scene file adds."""
MESHES = {
    "san_francisco": 4735,
    "trees": 3,
    "thin_features": 6,
    "dragon": 2,
    "fox": 2,
    "engine": 114,
    "sponza": 1,
    "monastery": 1,
}
LEFT_OUT = {"monastery": ["201 faces of fewer than three corners."], "trees": ["6 lines."]}


def is_here(name: str) -> bool:
    text = (SCENES / f"{name}.yaml").read_text(encoding="utf-8")
    return all((fetched_folder() / file).is_file() for file in re.findall(r'"fetched:([^"]+)"', text))


FETCHED = [
    pytest.param(name, marks=[pytest.mark.fetched, pytest.mark.skipif(not is_here(name), reason="`make scenes` first")])
    for name in TRIANGLES
]


def test_every_scene_is_in_the_table() -> None:
    assert {file.stem for file in SCENES.glob("*.yaml")} == set(TRIANGLES)


@pytest.fixture(scope="module", params=FETCHED)
def scene(request: pytest.FixtureRequest) -> Scene:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        loaded = load_scene(SCENES / f"{request.param}.yaml")
    assert [str(warning.message).rpartition(": ")[2] for warning in told] == LEFT_OUT.get(request.param, [])
    return loaded


def test_all_triangles_come_in(scene: Scene) -> None:
    assert sum(len(mesh.faces) for mesh in scene.meshes) == TRIANGLES[scene.name]
    assert any(mesh.moving for mesh in scene.meshes) == (scene.name == "fox")
    assert len(scene.meshes) == MESHES[scene.name]
    assert scene.frames >= 18 and all(light.has_area for light in scene.lights)


def test_the_eye_sees_what_the_plain_rasteriser_draws(scene: Scene) -> None:
    """On frames of the path: a floor that reaches behind the eye is among it."""
    width, height = 240, 135
    for frame in (0, 8, 14):
        geometry = Geometry(scene, "cpu", 2)
        session = Session(geometry, width=width, height=height, threads=2, index=frame)
        got = session.gbuffer().triangle.numpy()
        depth, triangle = (wp.zeros((height, width), dtype=kind, device="cpu") for kind in (float, int))
        view = session.eye().to_device()
        Rasteriser("cpu", 2, "tiles").draw(geometry.points_ws, geometry.indices, view, depth, triangle)
        np.testing.assert_array_equal(got >= 0, triangle.numpy() >= 0)
        assert (got >= 0).mean() > 0.4
        # where two triangles are equally deep to rounding either may win: these scenes have many that are doubled
        seen = session.gbuffer().depth.numpy()
        apart = np.abs(seen - depth.numpy())[got >= 0] > 1e-3 * seen[got >= 0]
        assert apart.mean() < 1e-3

"""The two walkthrough scenes have the sizes and triangle counts that they are known by."""

from pathlib import Path

import numpy as np
import pytest

from experiments.scenes import load_scene

SCENES = Path(__file__).parents[2] / "configs" / "scenes"


@pytest.mark.parametrize(
    ("name", "size_xzy", "triangles"), [("paris", (850, 800, 330), 255_000), ("winter", (500, 500, 100), 380_000)]
)
def test_scene_has_its_size(name: str, size_xzy: tuple[float, float, float], triangles: int) -> None:
    scene = load_scene(SCENES / f"{name}.yaml")
    count = sum(len(mesh.faces) for mesh in scene.meshes)
    assert count == pytest.approx(triangles, rel=0.01)
    used = []
    for mesh in scene.meshes:
        pose = mesh.object_to_ws(0)
        used.append(mesh.vertices[np.unique(mesh.faces)] @ pose[:3, :3].T + pose[:3, 3])
    extent = np.ptp(np.concatenate(used), axis=0)
    np.testing.assert_allclose(extent[[0, 2, 1]], size_xzy, rtol=0.02)

"""A scene's triangles on the device, rebased."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes

from wkernels.scene.geometry import Geometry


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf])
def test_a_broken_vertex_does_not_move_the_scene(broken: float, device: str) -> None:
    ground = small_scenes.mesh("ground", small_scenes.plane(14.0))
    corners = np.array([[1.0, 2.0, 1.0], [2.0, 2.0, 1.0], [broken, 2.0, 3.0]])
    bad = small_scenes.mesh("bad", (corners, np.array([[0, 1, 2]], dtype=np.int32)))
    lamp = small_scenes.light("point")
    geometry = Geometry(small_scenes.scene([ground, bad], lamp), device)
    assert np.isfinite(geometry.origin_ws).all()
    points = geometry.points_ws.numpy()
    assert np.isfinite(points).all(axis=1).sum() == len(points) - 1
    assert not geometry.bounds(casters=True, receivers=True).empty

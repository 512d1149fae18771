"""How close casters come to a point."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small

from wkernels.casters.clearance import Clearance
from wkernels.scene.geometry import Geometry


def test_distance_is_that_of_the_nearest_triangle(device: str) -> None:
    """Against points sampled densely on the triangles."""
    lamp = small.light("point")
    geometry = Geometry(small.scene([small.mesh("boxes", small.random_boxes(3, seed=2))], lamp), device)
    corners = geometry.points_ws.numpy()[geometry.caster_indices.numpy()].reshape(-1, 3, 3).astype(float)
    share = np.array([(a, b) for a in np.linspace(0, 1, 61) for b in np.linspace(0, 1, 61) if a + b <= 1.0])
    points = (
        corners[:, :1]
        + share[:, :1] * (corners[:, 1:2] - corners[:, :1])
        + share[:, 1:] * (corners[:, 2:] - corners[:, :1])
    )
    clearance = Clearance()
    for place in np.random.default_rng(1).uniform(-2.0, 2.0, (20, 3)):
        near = np.linalg.norm(points - place, axis=-1).min()
        assert clearance.within(geometry, place, 10.0) == pytest.approx(near, abs=0.03)
        assert clearance.within(geometry, place, 0.5 * near) == 0.5 * near


def test_broken_triangles_are_not_close(device: str) -> None:
    corners = np.array([[1.0, 2.0, 1.0], [2.0, 2.0, 1.0], [np.nan, 2.0, 3.0]])
    bad = small.mesh("bad", (corners, np.array([[0, 1, 2]], dtype=np.int32)))
    geometry = Geometry(small.scene([bad], small.light("point")), device)
    assert Clearance().within(geometry, np.zeros(3), 5.0) == 5.0

"""Polygons are covered once, wherever they lie, whatever their shape."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.scenes.meshes.polygons import triangulate, triangulate_loops
from tests.scenes.mesh_cases import CASES, coverage, read, solid

DOOR = np.array([[-2, 0], [-0.5, 0], [-0.5, 2], [0.5, 2], [0.5, 0], [2, 0], [2, 3], [-2, 3]], float)
POINTS = np.random.default_rng(1).uniform((-2.2, -0.2), (2.2, 3.2), (400, 2))


def in_door(points: np.ndarray) -> np.ndarray:
    wall = (np.abs(points[:, 0]) < 2) & (points[:, 1] > 0) & (points[:, 1] < 3)
    return wall & ~((np.abs(points[:, 0]) < 0.5) & (points[:, 1] < 2))


def polygon(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.c_[outline, np.zeros(len(outline))]
    return vertices, triangulate(vertices, np.array([len(outline)]), np.arange(len(outline)))


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


@pytest.mark.parametrize("begin", range(8))
@pytest.mark.parametrize("order", [1, -1])
def test_a_concave_polygon_is_covered_once_from_any_corner(begin: int, order: int):
    mesh = polygon(np.roll(DOOR, begin, axis=0)[::order])
    np.testing.assert_array_equal(coverage(mesh, POINTS), in_door(POINTS))
    assert np.all(order * areas(*mesh)[:, 2] > 0.0)  # the way that the polygon turns
    assert len(mesh[1]) == 6


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_it_is_so_in_any_plane_at_any_scale(scale: float):
    turn = Rotation.from_euler("xyz", (40, 70, 20), degrees=True).as_matrix()
    vertices = scale * (np.c_[DOOR, np.zeros(8)] @ turn.T + 3.0)
    area = areas(vertices, triangulate(vertices, np.array([8]), np.arange(8))) @ turn[:, 2]
    assert np.all(area > 0.0) and area.sum() == pytest.approx(10.0 * scale**2)


def test_convex_polygons_are_fans_and_the_order_of_polygons_stays():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0.5, 1.5, 0], [0, 1, 0], [0.6, 0.3, 0]], float)
    counts, indices = np.array([3, 5, 2, 4, 4, 0]), [0, 1, 2, 0, 1, 2, 3, 4, 0, 1, 0, 1, 2, 5, 0, 1, 2, 4]
    faces = triangulate(vertices, counts, np.array(indices))
    expected = [[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 3, 4], None, None, [0, 1, 2], [0, 2, 4]]
    for face, right in zip(faces.tolist(), expected, strict=True):
        assert right is None or face == right
    assert areas(vertices, faces[4:6])[:, 2].sum() == pytest.approx(0.5 - 0.15)  # 0, 1, 2, 5 turns back at 5
    assert np.all(areas(vertices, faces[4:6])[:, 2] >= -1e-12)


def test_polygons_without_area_keep_their_triangles():
    line, point = np.array([[0, 0], [1, 0], [2, 0], [1, 0]], float), np.zeros((5, 2))
    assert len(polygon(line)[1]) == 2
    assert len(polygon(point)[1]) == 3


def test_vertices_that_are_not_finite_do_not_stop_it():
    outline = DOOR.copy()
    outline[3] = np.nan
    assert len(polygon(outline)[1]) == 6


def test_corners_on_straight_edges_stay_corners():
    outline = np.insert(DOOR, [1, 1, 6], [[-1.5, 0], [-1, 0], [2, 1]], axis=0)
    mesh = polygon(outline)
    np.testing.assert_array_equal(coverage(mesh, POINTS), in_door(POINTS))
    edges = {tuple(sorted(edge)) for face in mesh[1].tolist() for edge in zip(face, face[1:] + face[:1], strict=True)}
    assert all(tuple(sorted((i, (i + 1) % 11))) in edges for i in range(11))  # or neighbours would not share them


def test_holes():
    outer = np.array([[0, 0], [4, 0], [4, 4], [0, 4]], float)
    holes = [np.array([[1, 1], [2, 1], [2, 2], [1, 2]], float), np.array([[3, 3], [3, 3.5], [2.5, 3]], float)]
    vertices = np.c_[np.concatenate([outer, *holes]), np.zeros(11)]
    faces = triangulate_loops(vertices, [np.arange(4), np.arange(4, 8), np.arange(8, 11)])
    area = areas(vertices, faces)[:, 2]
    assert np.all(area > 0.0) and area.sum() == pytest.approx(16.0 - 1.0 - 0.125)


def test_a_hole_that_a_bridge_joins_to_the_outline():
    outline = np.array([[0, 0], [4, 0], [4, 4], [0, 4], [0, 0], [1, 1], [1, 2], [2, 2], [2, 1], [1, 1]], float)
    area = areas(*polygon(outline))[:, 2]
    assert np.abs(area).sum() == pytest.approx(15.0)


@pytest.mark.parametrize("name", ["door.obj", "door.ply", "door.usda"])
def test_files_with_a_concave_polygon(name: str):
    if name.endswith("usda"):
        pytest.importorskip("pxr")
    mesh = read(CASES / "polygons" / name)
    np.testing.assert_array_equal(coverage(mesh, POINTS), in_door(POINTS))
    np.testing.assert_array_equal(coverage(read(CASES / "polygons" / "truth.obj"), POINTS), in_door(POINTS))
    assert solid(mesh).area == pytest.approx(10.0)

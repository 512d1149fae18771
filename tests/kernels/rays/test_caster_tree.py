"""The casters' tree: every box holds what is below it, and moved vertices move the boxes."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from wkernels.rays.caster_tree import CasterTreeBuilder, spatial_order


def soup(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, (30.0, 5.0, 11.0), (count, 1, 3)) + rng.normal(0.0, 0.3, (count, 3, 3))
    return points.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def build(points: np.ndarray, faces: np.ndarray, device: str) -> tuple[CasterTreeBuilder, wp.array]:
    held = wp.array(points, dtype=wp.vec3, device=device)
    indices = wp.array(faces.ravel(), dtype=int, device=device)
    return CasterTreeBuilder(held, indices, len(faces), device, 2), held


def boxes_of(builder: CasterTreeBuilder) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corners of all children's boxes, (nodes, 8, 3)."""
    tree = builder.tree
    low = np.stack([a.numpy() for a in (tree.low_x, tree.low_y, tree.low_z)], axis=-1)
    return low, np.stack([a.numpy() for a in (tree.high_x, tree.high_y, tree.high_z)], axis=-1)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 64, 65, 513, 5000])
def test_every_box_is_that_of_the_triangles_below_it(count: int, device: str) -> None:
    points, faces = soup(count)
    builder, _ = build(points, faces, device)
    tree = builder.tree
    ordered = points[faces][spatial_order(points, faces)]
    begin, size = tree.level_begin.numpy(), tree.level_size.numpy()
    low, high = boxes_of(builder)
    assert size[tree.levels - 1] == 1 and size[0] == -(-count // 8)
    for level in range(1, tree.levels):
        below = 8**level  # triangles of a child
        for node in range(size[level]):
            for k in range(8):
                own = ordered[(8 * node + k) * below : (8 * node + k + 1) * below].reshape(-1, 3)
                if len(own):
                    np.testing.assert_array_equal(low[begin[level] + node, k], own.min(axis=0))
                    np.testing.assert_array_equal(high[begin[level] + node, k], own.max(axis=0))
                else:
                    assert (low[begin[level] + node, k] > high[begin[level] + node, k]).all()
    leaves = tree.triangle.numpy().transpose(0, 2, 1).reshape(-1, 3, 3)
    np.testing.assert_array_equal(leaves[:count], ordered)
    assert not leaves[count:].any()


def test_spatial_order_is_a_compact_permutation() -> None:
    points, faces = soup(4096)
    order = spatial_order(points, faces)
    np.testing.assert_array_equal(np.sort(order), np.arange(4096))
    middle = points[faces].mean(axis=1)
    spread = np.ptp(middle[order].reshape(-1, 64, 3), axis=1).prod(axis=1).mean()
    assert spread < 0.1 * np.ptp(middle.reshape(-1, 64, 3), axis=1).prod(axis=1).mean()


def test_moved_vertices_move_the_boxes(device: str) -> None:
    points, faces = soup(700)
    builder, held = build(points, faces, device)
    moved = points * np.float32(1.5) + np.float32(3.0)
    held.assign(moved)
    builder.refit()
    low, high = boxes_of(builder)
    root = int(builder.tree.level_begin.numpy()[builder.tree.levels - 1])
    np.testing.assert_array_equal(low[root].min(axis=0), moved.min(axis=0))
    np.testing.assert_array_equal(high[root].max(axis=0), moved.max(axis=0))


def test_triangles_that_are_not_finite_become_points(device: str) -> None:
    points, faces = soup(20)
    points[3] = np.nan
    points[9, 1] = np.inf
    builder, _ = build(points, faces, device)
    leaves = builder.tree.triangle.numpy()
    assert np.isfinite(leaves).all()
    assert (leaves.transpose(0, 2, 1).reshape(-1, 9)[:20] == 0.0).all(axis=1).sum() == 2


def test_no_triangles_at_all(device: str) -> None:
    builder, _ = build(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), device)
    assert builder.tree.levels == 0

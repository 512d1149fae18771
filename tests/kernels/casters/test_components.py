"""Boxes, orientations and lights inside of connected casters, against brute force; and which faces hide all."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
from caster_meshes import all_meshes, facing, torus, whole

from wkernels.casters.components import find_components, hiding_by_lit, holding
from wkernels.casters.edges import NO_COMPONENT, Adjacency, find_edges
from wkernels.casters.silhouettes import counted_turns

Mesh = tuple[np.ndarray, np.ndarray]


def joined(*shapes: Mesh) -> tuple[np.ndarray, Adjacency]:
    """Several meshes as one, float32 vertices, and its adjacency."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in shapes])
    points = np.concatenate([vertices for vertices, _ in shapes]).astype(np.float32)
    faces = np.concatenate([faces + start for (_, faces), start in zip(shapes, starts[:-1], strict=True)])
    return points, find_edges(points, faces.astype(np.int32))


@pytest.mark.parametrize("name", all_meshes())
def test_boxes_are_those_of_the_faces(name: str) -> None:
    points, adjacency = joined(all_meshes()[name])
    found = find_components(points, adjacency)
    assert len(found.low) == len(found.high) == len(found.outward) == len(adjacency.component_closed)
    for k in range(len(found.low)):
        corners = points[adjacency.faces[adjacency.component == k]].reshape(-1, 3)
        np.testing.assert_array_equal(found.low[k], corners.min(axis=0))
        np.testing.assert_array_equal(found.high[k], corners.max(axis=0))
    order, begin = adjacency.faces_by_component
    np.testing.assert_array_equal(np.sort(order), np.flatnonzero(adjacency.component != NO_COMPONENT))
    np.testing.assert_array_equal(adjacency.component[order], np.repeat(np.arange(len(begin) - 1), np.diff(begin)))


@pytest.mark.parametrize("name", whole())
@pytest.mark.parametrize("offset", [0.0, 3e3])
def test_a_body_inside_out_is_told(name: str, offset: float) -> None:
    vertices, faces = whole()[name]
    vertices = vertices + offset
    points, adjacency = joined((vertices, faces), (vertices + 9.0, faces[:, ::-1]))
    np.testing.assert_array_equal(find_components(points, adjacency).outward, [True, False])


def test_lights_inside() -> None:
    """Of a box, a box inside out round it, a torus whose hole its box holds, and an open box, which holds nothing."""
    small, large = (
        small_scenes.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        small_scenes.box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)),
    )
    ring = (torus()[0] + np.array([10.0, 0.0, 0.0]), torus()[1])
    points, adjacency = joined(small, (large[0], large[1][:, ::-1]), ring, (large[0] + 20.0, large[1][2:]))
    components = find_components(points, adjacency)
    for place, inside in (
        ((0.1, 0.2, 0.0), [True, True, False, False]),
        ((0.9, 0.2, 0.0), [False, True, False, False]),
        ((10.0, 0.0, 0.0), [False, False, False, False]),
        ((11.0, 0.02, 0.01), [False, False, True, False]),
        ((20.0, 20.0, 20.0), [False, False, False, False]),
    ):
        light = np.array((*place, 1.0))
        np.testing.assert_array_equal(holding(components, adjacency, points, light), inside, str(place))
        np.testing.assert_array_equal(holding(components, adjacency, points, light * (1, 1, 1, 0)), False)


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_counted_faces_hide_all_that_the_body_hides(name: str, flipped: bool) -> None:
    """From points inside and outside, with lights inside and outside: some face lies between exactly if a counted one does."""
    vertices, faces = whole()[name]
    points, adjacency = joined((vertices, faces[:, ::-1] if flipped else faces))
    components = find_components(points, adjacency)
    rng = np.random.default_rng(5)
    receivers = rng.uniform(-1.6, 1.6, (400, 3))
    corners = points.astype(float)[adjacency.faces]
    wrong_otherwise = 0
    for light in ((0.3, 4.0, 0.4), (1.0, 0.05, 0.02), (0.8, 0.1, 0.5)):
        light_ws = np.array((*light, 1.0))
        inside = holding(components, adjacency, points, light_ws)
        turned = facing(points, adjacency.faces, tuple(light_ws))
        by_lit = hiding_by_lit(components, inside)
        along = np.array(light) - receivers
        distance, _ = small_scenes.ray_hits(receivers, along, corners)
        between = (distance > 0.0) & (distance < 1.0)
        hidden = between.any(axis=1)
        assert hidden.any() and not hidden.all()
        np.testing.assert_array_equal(between[:, counted_turns(adjacency, turned, by_lit) != 0].any(axis=1), hidden)
        other = between[:, counted_turns(adjacency, turned, ~by_lit) != 0].any(axis=1)
        wrong_otherwise += int((other != hidden).sum())
    assert wrong_otherwise > 0

"""The connected components of casters as bodies: boxes, which way round they are, and whether a light is inside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wkernels.casters.edges import Adjacency


@dataclass(frozen=True, eq=False)
class Components:
    """What is known of each component of an adjacency, C of them, at one pose.

    Attributes:
        low, high: float64 (C, 3), corners of its box, rebased world.
        outward: bool (C,), whether it encloses a positive volume, which says something of closed ones: their
            counter-clockwise sides look outwards. Of a body inside out they look inwards.
    """

    low: np.ndarray
    high: np.ndarray
    outward: np.ndarray

    @cached_property
    def middle(self) -> np.ndarray:
        """float64 (C, 3), middles of the boxes."""
        return 0.5 * (self.low + self.high)

    @cached_property
    def half(self) -> np.ndarray:
        """float64 (C, 3), half their extents."""
        return 0.5 * (self.high - self.low)


def find_components(points_ws: np.ndarray, adjacency: Adjacency, outward: np.ndarray | None = None) -> Components:
    """Boxes and orientations of all components.

    Args:
        points_ws: float (V, 3), the vertices of the adjacency.
        adjacency: Of the casters.
        outward: Orientations that are known from another pose; motions keep them.
    """
    if len(adjacency.component_closed) == 0:
        return Components(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool))
    vertices, begin = adjacency.vertices_by_component
    places = points_ws[vertices]
    low = np.minimum.reduceat(places, begin[:-1]).astype(np.float64)
    high = np.maximum.reduceat(places, begin[:-1]).astype(np.float64)
    if outward is None:
        outward = _volumes(points_ws, adjacency, 0.5 * (low + high)) > 0.0
    return Components(low, high, outward)


def _volumes(points_ws: np.ndarray, adjacency: Adjacency, middle: np.ndarray) -> np.ndarray:
    """Six times the signed volume of each component, (C,).

    About each one's own ``middle`` (C, 3), as volumes about a point far away are small differences of large numbers.
    """
    faces, _ = adjacency.faces_by_component
    owner = adjacency.component[faces]
    a, b, c = np.moveaxis(points_ws[adjacency.faces[faces]] - middle[owner][:, None], 1, 0)
    return np.bincount(owner, np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=len(middle))


def holding(components: Components, adjacency: Adjacency, points_ws: np.ndarray, light_ws: np.ndarray) -> np.ndarray:
    """Which closed components have a light point inside, bool (C,); a direction lies in none.

    By the angle that all faces together fill as seen from the point (van Oosterom and Strackee 1983), asked of those
    components only whose boxes hold it.

    Args:
        components, adjacency: Of the casters.
        points_ws: float (V, 3).
        light_ws: Light point (4,).
    """
    out = np.zeros(len(components.low), bool)
    if light_ws[3] == 0.0:
        return out
    point = np.asarray(light_ws[:3], np.float64)
    within = ((components.low <= point) & (point <= components.high)).all(axis=1) & adjacency.component_closed
    faces, begin = adjacency.faces_by_component
    for k in np.flatnonzero(within):
        a, b, c = np.moveaxis(points_ws[adjacency.faces[faces[begin[k] : begin[k + 1]]]] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        det = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = [np.einsum("ij,ij->i", u, v) * w for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb))]
        angle = 2.0 * np.arctan2(det, la * lb * lc + sum(dots)).sum()
        out[k] = abs(angle) > 2.0 * np.pi
    return out


def hiding_by_lit(components: Components, inside: np.ndarray) -> np.ndarray:
    """Of which closed components the lit faces hide all that the whole body hides, and not the unlit ones, bool (C,).

    On the way from a point to the light, lit faces are passed as often as unlit ones, and once more for a point within
    the body, once less for a light within it. So where the light is outside, what no lit face hides no face hides;
    where it is inside, that holds for unlit faces; and for bodies inside out the other way round.

    Args:
        components: Of the casters.
        inside: bool (C,), ``holding``.
    """
    out: np.ndarray = components.outward != inside
    return out

"""Silhouette edges as penumbra wedges: their ends in light space, and the body in which each of them matters.

A point is in an edge's penumbra where the edge lies between it and the light: in the body swept by the light's mirror
images in the edge's points, which is the hull of both ends and of the directions in which they are seen from the
light's corners (Assarsson et al. 2003, section 4.1). Of a rectangle's four corners that is the tight wedge, whose ends
are pyramids; of the cube around its bounding sphere the wide one of their earlier work, whose farther end is moved
towards the light to the distance of the nearer one (section 3), so that front and back are planes.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import warp as wp

from wkernels.casters.silhouettes import Silhouettes
from wkernels.casters.wedges.light_shapes import FACING, SUN, HostShape
from wkernels.raster.binning import Binner, TileLists
from wkernels.scene.views import View
from wkernels.workspace.products import Product
from wkernels.workspace.workspace import Workspace

WedgeRule = Literal["tight", "sphere_bounded"]

TILE = 16
"""Pixels per side of the tiles that list wedges: a run of lanes lies within one."""
SIDES = 6
"""Sides of the pyramid around the cone through a sphere."""


@wp.struct
class WedgeEdges:
    """Edges for kernels, in the order of the tiles' lists."""

    ends: wp.array(dtype=wp.vec3)  # (2 n,), light space
    vertices: wp.array(dtype=wp.vec2i)  # (n,), the casters' vertices that they are
    weight: wp.array(dtype=float)  # (n,), how often each counts


@dataclass(frozen=True, eq=False)
class Wedges:
    """Penumbra wedges of some silhouette edges.

    Attributes:
        edges: Their edges.
        points_ws: vec4 (m,), homogeneous: corners of the bodies, one after the other.
        begin: int32 (n + 1,), where each body's corners begin.
        component: int32 (n,), to which caster each belongs, ascending.
        light: What they are the wedges of.
    """

    edges: WedgeEdges
    points_ws: wp.array
    begin: wp.array
    component: np.ndarray
    light: HostShape

    def of(self, chosen: slice) -> Wedges:
        """Some that follow each other."""
        first, last, _ = chosen.indices(len(self.component))
        if first == 0 and last == len(self.component):
            return self
        edges, corners = WedgeEdges(), corners_each(self)
        edges.ends = self.edges.ends[2 * first : 2 * last]
        edges.vertices, edges.weight = self.edges.vertices[first:last], self.edges.weight[first:last]
        points = self.points_ws[corners * first : corners * last]
        return Wedges(edges, points, self.begin[: last - first + 1], self.component[first:last], self.light)


def corners_each(wedges: Wedges) -> int:
    """How many corners each body has."""
    return len(wedges.points_ws) // max(1, len(wedges.component))


def bodies_of(ends_ws: np.ndarray, light: HostShape, rule: WedgeRule) -> np.ndarray:
    """Corners of the bodies of edges (n, 2, 3), homogeneous (n, k, 4): both ends, then ways away from the light."""
    if rule == "sphere_bounded" and light.kind != SUN:
        away = ends_ws - light.centre_ws
        far = np.linalg.norm(away, axis=2, keepdims=True)
        ends_ws = light.centre_ws + away * (far.min(axis=1, keepdims=True) / np.maximum(far, 1e-30))
    if light.kind == SUN:
        ways = np.broadcast_to(-light.corners_ws, (len(ends_ws), len(light.corners_ws), 3))
    elif light.kind == FACING or rule == "sphere_bounded":
        radius = float(np.linalg.norm(light.corners_ws - light.centre_ws, axis=1).max())
        radius = light.radius if light.kind == FACING else radius
        ways = np.concatenate([_cone(ends_ws[:, i] - light.centre_ws, radius) for i in range(2)], axis=1)
    else:
        ways = (ends_ws[:, :, None] - light.corners_ws).reshape(len(ends_ws), 2 * len(light.corners_ws), 3)
    # directions of any length are the same; of length 1 none is lost to rounding
    length = np.linalg.norm(ways, axis=2, keepdims=True)
    ways = np.where(length > 0.0, ways, 1.0) / np.where(length > 0.0, length, 1.0)
    whole = np.concatenate([ends_ws, np.ones((*ends_ws.shape[:2], 1))], axis=2)
    return np.concatenate([whole, np.concatenate([ways, np.zeros((*ways.shape[:2], 1))], axis=2)], axis=1)


def _cone(away: np.ndarray, radius: float) -> np.ndarray:
    """Pyramids around the cones in which a sphere is reflected at points (n, 3) from its centre: (n, SIDES, 3).

    A point in the sphere sees it in all directions.
    """
    far = np.linalg.norm(away, axis=1)
    axis = away / np.maximum(far, 1e-30)[:, None]
    helper = np.eye(3)[np.abs(axis).argmin(axis=1)]
    e_u = np.cross(helper, axis)
    e_u /= np.maximum(np.linalg.norm(e_u, axis=1, keepdims=True), 1e-30)
    e_v = np.cross(axis, e_u)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    outside = far > 1.001 * radius
    tangent = radius / np.sqrt(np.where(outside, far**2 - radius**2, 1.0)) / np.cos(np.pi / SIDES)
    ring = np.cos(angle)[:, None] * e_u[:, None] + np.sin(angle)[:, None] * e_v[:, None]
    ways = axis[:, None] + tangent[:, None, None] * ring
    everywhere = np.concatenate([np.eye(3), -np.eye(3)])
    return np.where(outside[:, None, None], ways, everywhere)


def make_wedges(
    points_ws: np.ndarray, silhouettes: Silhouettes, light: HostShape, rule: WedgeRule, device: str
) -> Wedges:
    """The wedges of all silhouette edges.

    Args:
        points_ws: The casters' vertices (V, 3), rebased world.
        silhouettes: From the light's centre.
        light: The light.
        rule: Around what a rectangle's wedges are: itself, or its bounding sphere.
        device: Where they are needed.
    """
    order = np.argsort(silhouettes.component, kind="stable")
    vertices = silhouettes.ends[order]
    ends = points_ws.astype(np.float64)[vertices]
    edges = WedgeEdges()
    in_light = light.in_light_space(ends.reshape(-1, 3)).astype(np.float32)
    edges.ends = wp.array(in_light.reshape(-1, 3), dtype=wp.vec3, device=device)
    edges.vertices = wp.array(
        np.ascontiguousarray(vertices, dtype=np.int32).reshape(-1, 2), dtype=wp.vec2i, device=device
    )
    edges.weight = wp.array(silhouettes.weight[order].astype(np.float32), dtype=float, device=device)
    bodies = bodies_of(ends, light, rule).astype(np.float32)
    begin = np.arange(len(bodies) + 1, dtype=np.int32) * bodies.shape[1]
    return Wedges(
        edges,
        wp.array(bodies.reshape(-1, 4), dtype=wp.vec4, device=device),
        wp.array(begin, dtype=int, device=device),
        silhouettes.component[order],
        light,
    )


def pull_wedges(
    work: Workspace,
    points_ws: wp.array,
    silhouettes: Silhouettes,
    light: HostShape,
    rule: WedgeRule,
    slot: Hashable = 0,
) -> Wedges:
    """``make_wedges``, built anew with the silhouettes or the light; one for each slot."""

    def build(old: Wedges | None) -> Wedges:
        return make_wedges(points_ws.numpy(), silhouettes, light, rule, work.device)

    inputs = (silhouettes, light.centre_ws.tobytes(), light.corners_ws.tobytes(), light.radius, rule)
    out: Wedges = work.product(Product.WEDGES, ("wedges", slot), inputs, build)
    return out


def bin_wedges(binner: Binner, wedges: Wedges, view: View, seen: wp.array | None) -> TileLists:
    """Which wedges come near each tile's pixels, ascending.

    Args:
        binner: Keeps the lists.
        wedges: The wedges.
        view: The eye's.
        seen: Depth (H, W) of what is seen: leaves out wedges that lie before or behind all of a tile.
    """
    return binner.bin(wedges.points_ws, wedges.begin, view, TILE, seen=seen)

"""What a frame keeps of its casters' edges: topology for good, silhouettes for as long as nothing moves."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Literal

import numpy as np

from wkernels.casters.components import Components, find_components, hiding_by_lit, holding
from wkernels.casters.edges import Adjacency, caster_edges
from wkernels.casters.extrusion import Volumes, sweep_volumes
from wkernels.casters.silhouettes import (
    Loops,
    Silhouettes,
    counted_turns,
    facing_of,
    find_loops,
    find_silhouettes,
)
from wkernels.scene.geometry import Geometry
from wkernels.workspace.products import Product
from wkernels.workspace.workspace import Workspace


def pull_edges(work: Workspace, geometry: Geometry) -> Adjacency:
    """``caster_edges``, built once; raises InputError where a caster is cut out by a texture."""
    geometry.require_whole("silhouettes and shadow volumes")
    out: Adjacency = work.product(Product.CASTER_EDGES, "caster edges", geometry, lambda old: caster_edges(geometry))
    return out


def pull_components(work: Workspace, geometry: Geometry) -> Components:
    """``find_components``, built anew when a vertex has moved."""
    adjacency = pull_edges(work, geometry)

    def build(old: Components | None) -> Components:
        return find_components(geometry.points_ws.numpy(), adjacency, old.outward if old else None)

    inputs = (adjacency, geometry.version)
    out: Components = work.product("caster components", "caster components", inputs, build)
    return out


def pull_silhouettes(
    work: Workspace,
    geometry: Geometry,
    light_ws: np.ndarray,
    closed: Literal["hiding", "lit", "unlit", "both"] = "hiding",
    slot: Hashable = 0,
) -> Silhouettes:
    """The casters' silhouettes from a light point, built anew when it or a vertex has moved.

    Args:
        work: Keeps them.
        geometry: The casters.
        light_ws: Light point (4,), float64, rebased world; w = 1, or 0 for a direction.
        closed: Which faces of closed components count, ``counted_turns``; ``hiding``: of each the side that hides all
            that it hides, wherever light and receivers are, which is the lit one unless the light is inside it.
        slot: Which of several light points this is; each has its own.
    """
    adjacency = pull_edges(work, geometry)

    def build(old: Silhouettes | None) -> Silhouettes:
        facing = facing_of(work, geometry.points_ws, geometry.caster_indices, light_ws)
        if closed != "hiding":
            return find_silhouettes(adjacency, counted_turns(adjacency, facing, closed))
        components = pull_components(work, geometry)
        inside = holding(components, adjacency, geometry.points_ws.numpy(), light_ws)
        return find_silhouettes(adjacency, counted_turns(adjacency, facing, hiding_by_lit(components, inside)))

    inputs = (adjacency, geometry.version, np.asarray(light_ws, np.float64).tobytes())
    out: Silhouettes = work.product(Product.SILHOUETTES, ("silhouettes", slot, closed), inputs, build)
    return out


def pull_loops(work: Workspace, silhouettes: Silhouettes, slot: Hashable = 0) -> Loops:
    """``find_loops``, one for each slot."""
    out: Loops = work.product("silhouette loops", ("loops", slot), silhouettes, lambda old: find_loops(silhouettes))
    return out


def pull_volumes(
    work: Workspace, geometry: Geometry, silhouettes: Silhouettes, light_ws: np.ndarray, slot: Hashable = 0
) -> Volumes:
    """``sweep_volumes``, one for each slot, built anew with the silhouettes."""

    def build(old: Volumes | None) -> Volumes:
        return sweep_volumes(work, geometry.points_ws, pull_edges(work, geometry), silhouettes, light_ws)

    out: Volumes = work.product(Product.VOLUMES, ("volumes", slot), silhouettes, build)
    return out

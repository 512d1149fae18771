"""Visibility of all samples of a light from the silhouette edges before it (Laine et al. 2005), and at most three rays.

Silhouette edges say by how much the depth complexity of samples differs. Those with the least are lit, all of them or
none, and all others are hidden: one ray to one of the former decides. A second ray to another of them, and one to a
sample with the most, must agree; where they do not, and where a receiver sees the light too flat or from too near for
its samples to be projected, every sample gets its ray. So do all receivers where many triangles reach into the light.

Samples are those of ``shaft_rays``, wherever they lie: the answer is that of rays but for samples on an edge within
rounding.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.edge_rays.clusters import EDGE_LANES, PARTS, TILE, Clusters, EdgeFloats, find_clusters, list_edges
from wkernels.edge_rays.light_plane import LightPlane, light_plane
from wkernels.edge_rays.potential import EdgeSet
from wkernels.edge_rays.samples import BY_RAYS, EdgeLists, trace_edges
from wkernels.raster.gbuffer import GBuffer
from wkernels.rays.caster_tree import CasterTree
from wkernels.rays.light_proofs import LightHull
from wkernels.rays.light_samples import LightSamples
from wkernels.rays.ray_casters import RayCasters
from wkernels.rays.shaft_rays import trace_shafts
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.lights import Light
from wkernels.workspace.workspace import Workspace

BLOCKS_AT_ONCE = 1 << 16  # of 1 KB


@wp.kernel
def keep_receivers(
    first: int, flags: wp.array2d(dtype=int), way: wp.array2d(dtype=int), flags_out: wp.array2d(dtype=int)
):
    """The flags of a G-buffer in which only receivers that need rays receive."""
    row, x = wp.tid()
    y = first + row
    flags_out[y, x] = wp.where(way[y, x] == BY_RAYS, flags[y, x], flags[y, x] & ~RECEIVES)


@wp.kernel
def take_rays(
    first: int, way: wp.array2d(dtype=int), traced: wp.array2d(dtype=float), visibility_out: wp.array2d(dtype=float)
):
    """Puts what rays have found where they were needed."""
    row, x = wp.tid()
    y = first + row
    if way[y, x] == BY_RAYS:
        visibility_out[y, x] = traced[y, x]


def trace_silhouettes(
    work: Workspace,
    gbuffer: GBuffer,
    known: EdgeSet,
    tree: CasterTree,
    casters: RayCasters,
    samples: LightSamples,
    light: Light,
    hull: LightHull,
    visibility_out: wp.array,
) -> int:
    """Visibility of every receiver; 1 where there is none.

    Args:
        work: Where to run, on the CPU.
        gbuffer: The receivers.
        known: Of casters and light, ``pull_edge_set``.
        tree: The casters for many rays.
        casters: The casters for single rays.
        samples: Points of the light.
        light: A light with an area, rebased world.
        hull: Its hull.
        visibility_out: float32 (H, W).

    Returns:
        How many receivers took a ray to every sample.
    """
    height, width = visibility_out.shape
    way = work.buffer("way to visibility", (height, width), wp.int32)
    if known.too_many:
        way.fill_(int(BY_RAYS))
    else:
        plane = light_plane(light, work.device)
        # in the kernel's order and precision, so that "all seen" is exactly 1
        total = float(np.add.accumulate(samples.batches.weight.numpy().ravel())[-1])
        lists, clusters, counts = _count_edges(work, gbuffer, known, plane)
        size = int(TILE)
        tiles_y = -(-height // size)
        blocks = -(-counts.reshape(tiles_y, -1) // int(EDGE_LANES))
        for first, last in _bands(blocks.sum(axis=1)):
            in_band = blocks[first:last].ravel()
            begin = np.zeros(blocks.size, np.int32)
            begin[first * blocks.shape[1] : last * blocks.shape[1]] = np.cumsum(in_band) - in_band
            lists.begin = wp.array(begin, dtype=int, device=work.device)
            needed = 1 << int(max(1, in_band.sum()) - 1).bit_length()
            lists.block = work.buffer("edge blocks", (needed, 16), EdgeFloats)
            tiles = (last - first) * lists.tiles_x
            inputs = [clusters, known.tree, known.edges, plane, first * lists.tiles_x, lists.begin, 1]
            work.launch(list_edges, tiles, inputs, [lists.count, lists.block])
            inputs = [gbuffer, first * size, lists, plane, hull, samples.batches, known.piercing_ws, casters, total]
            rows = min(last * size, height) - first * size
            work.launch(trace_edges, (rows, width), inputs, [visibility_out, way])
    needs_rays = (way.numpy() == int(BY_RAYS)) & ((gbuffer.flags.numpy() & int(RECEIVES)) != 0)
    by_rays = int(np.count_nonzero(needs_rays))
    if by_rays:
        some = GBuffer()
        for name in ("view", "depth", "position_ws", "normal_ws", "mesh", "triangle"):
            setattr(some, name, getattr(gbuffer, name))
        some.flags = work.buffer("receivers of rays", (height, width), wp.int32)
        traced = work.buffer("visibility by rays", (height, width), wp.float32)
        proof = work.buffer("proof of rays", (height, width), wp.int32)
        work.launch(keep_receivers, (height, width), [gbuffer.flags, way], [some.flags])
        work.launch(trace_shafts, (height, width), [some, tree, samples.batches, hull, 1], [traced, proof])
        work.launch(take_rays, (height, width), [way, traced], [visibility_out])
    return by_rays


def _count_edges(
    work: Workspace, gbuffer: GBuffer, known: EdgeSet, plane: LightPlane
) -> tuple[EdgeLists, Clusters, np.ndarray]:
    """Clusters of the receivers, and how many edges each lists."""
    height, width = gbuffer.flags.shape
    size, parts = int(TILE), int(PARTS)
    lists, clusters = EdgeLists(), Clusters()
    lists.tiles_x = -(-width // size)
    tiles = lists.tiles_x * -(-height // size)
    lists.part = work.buffer("part of tile", (height, width), wp.int32)
    clusters.low = work.buffer("low of clusters", (tiles, parts), wp.vec3)
    clusters.high = work.buffer("high of clusters", (tiles, parts), wp.vec3)
    lists.count = work.buffer("edges of clusters", (tiles * parts,), wp.int32)
    none = work.buffer("no blocks", (1, 16), EdgeFloats)
    begin = work.buffer("no begin", (1,), wp.int32)
    work.launch(find_clusters, tiles, [gbuffer, lists.tiles_x], [lists.part, clusters])
    work.launch(list_edges, tiles, [clusters, known.tree, known.edges, plane, 0, begin, 0], [lists.count, none])
    return lists, clusters, lists.count.numpy()


def _bands(blocks: np.ndarray) -> list[tuple[int, int]]:
    """Runs of tile rows, each of at most ``BLOCKS_AT_ONCE`` blocks or of one row, of the blocks (rows,) of each."""
    out, first, held = [], 0, 0
    for row, count in enumerate(blocks):
        if row > first and held + count > BLOCKS_AT_ONCE:
            out.append((first, row))
            first, held = row, 0
        held += int(count)
    out.append((first, len(blocks)))
    return out

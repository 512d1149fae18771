"""The two halves of a light's wedges apart, for pictures: what is added, what is taken away, and by how many wedges."""

from __future__ import annotations

import warp as wp

from wkernels.casters.wedges.bodies import WedgeEdges
from wkernels.casters.wedges.coverage import beyond
from wkernels.casters.wedges.light_shapes import LightShape, see_light
from wkernels.casters.wedges.near_lists import NearLists
from wkernels.casters.wedges.passes import Prepared
from wkernels.casters.wedges.shading import edge_on_light
from wkernels.raster.binning import tile_at
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import RECEIVES


@wp.kernel
def part_halves(
    first: int,
    gbuffer: GBuffer,
    light: LightShape,
    edges: WedgeEdges,
    near: NearLists,
    added_out: wp.array2d(dtype=float),
    taken_out: wp.array2d(dtype=float),
    inside_out: wp.array2d(dtype=int),
    listed_out: wp.array2d(dtype=int),
):
    """Sums of shares by their sign, wedges that a receiver lies in, and those that its tile lists."""
    row, x = wp.tid()
    y = first + row
    added = float(0.0)
    taken = float(0.0)
    inside = int(0)
    tile = tile_at(near.lists, y, x)
    receives = (gbuffer.flags[y, x] & RECEIVES) != 0
    if receives:
        sight = see_light(light, gbuffer.position_ws[y, x])
        for i in range(near.lists.begin[tile], near.end[tile]):
            e = near.lists.shape[i]
            edge = edge_on_light(light, sight, edges, e)
            if edge.visible != 0:
                share = sight.turn * edges.weight[e] * beyond(light.shape, edge.ends)
                added += wp.max(share, 0.0)
                taken += wp.max(-share, 0.0)
                inside += 1
    added_out[y, x] = added
    taken_out[y, x] = taken
    inside_out[y, x] = inside
    listed_out[y, x] = wp.where(receives, near.end[tile] - near.lists.begin[tile], 0)


def see_halves(prepared: Prepared) -> tuple[wp.array, wp.array, wp.array, wp.array]:
    """``part_halves`` of a light: added and taken, float32 (H, W), wedges around and listed, int32 (H, W)."""
    work, gbuffer = prepared.stage.work, prepared.stage.gbuffer
    shape = gbuffer.depth.shape
    dtypes = (wp.float32, wp.float32, wp.int32, wp.int32)
    out = tuple(wp.empty(shape, dtype=dtype, device=work.device) for dtype in dtypes)
    inputs = [gbuffer, prepared.light, prepared.wedges.edges, prepared.lists(prepared.wedges)]
    work.launch(part_halves, shape, inputs, list(out))
    return out

"""Many views at once without lanes: the vertices of all of them in one launch, and on CUDA the triangles too.

*Cloned* and *instanced* are those of ``split_culling``. The CPU's tiles are then drawn view by view.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from wkernels.raster.blocks import BlockViews, needs
from wkernels.raster.clipping import CLIP_TRIANGLES, CLIP_VERTICES, clip_homogeneous, clip_triangles
from wkernels.raster.lane_culling import MESH_LANES
from wkernels.raster.scratch import Scratch
from wkernels.raster.stripes import BACKGROUND_KEY, STRIPES, draw_rows, draw_stripe, split_key
from wkernels.raster.tiles import draw_tiles
from wkernels.raster.triangles import (
    ScreenTriangles,
    needs_clipping,
    to_homogeneous_pixels,
)
from wkernels.scene.views import View

KEY_PIXELS = 2**26
"""Pixels of all views that CUDA draws at once, 8 bytes each."""


@wp.func
def project_vertex(point_ws: wp.vec3, view: View, mask: int, bit: int):
    """``project_vertices`` of one vertex; as if to be clipped where the view does not need it."""
    screen = wp.vec4(0.0, 0.0, 0.0, -1.0)
    if needs(mask, bit):
        h = to_homogeneous_pixels(view, point_ws)
        if not needs_clipping(h, view.near):
            over_w = 1.0 / h[3]
            screen = wp.vec4(h[0] * over_w, h[1] * over_w, h[2] * over_w, over_w)
    return screen


@wp.kernel
def project_vertices_cloned(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    views: wp.array(dtype=View),
    view_0: int,
    count: int,
    run_mask: wp.array(dtype=int),
    screen_out: wp.array(dtype=wp.vec4),  # (count V,)
):
    """A vertex in each of ``count`` views from ``view_0`` on."""
    v = first + wp.tid()
    for i in range(count):
        mask = run_mask[v / MESH_LANES]
        screen_out[i * points_ws.shape[0] + v] = project_vertex(points_ws[v], views[view_0 + i], mask, view_0 + i)


@wp.kernel
def project_vertices_instanced(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    views: wp.array(dtype=View),
    view_0: int,
    run_mask: wp.array(dtype=int),
    screen_out: wp.array(dtype=wp.vec4),
):
    """A vertex in one view."""
    row, i = wp.tid()
    v = first + row
    mask = run_mask[v / MESH_LANES]
    screen_out[i * points_ws.shape[0] + v] = project_vertex(points_ws[v], views[view_0 + i], mask, view_0 + i)


@wp.kernel
def flag_splits(
    first: int,
    screen: wp.array(dtype=wp.vec4),
    vertices: int,
    indices: wp.array(dtype=int),
    view_0: int,
    block_mask: wp.array(dtype=int),
    clipped_out: wp.array2d(dtype=wp.uint8),  # (views, T)
):
    """``flag_clipped`` of a triangle in a view that needs it."""
    row, i = wp.tid()
    t = first + row
    flag = wp.uint8(0)
    if needs(block_mask[t / MESH_LANES], view_0 + i):
        for k in range(3):
            if screen[i * vertices + indices[3 * t + k]][3] < 0.0:
                flag = wp.uint8(1)
    clipped_out[i, t] = flag


@wp.func
def in_view(triangles: ScreenTriangles, i: int, vertices: int, far: float):
    """The mesh's triangles, without pieces of clipped ones, as the ``i``-th view has them."""
    own = ScreenTriangles()
    own.screen = triangles.screen
    own.first_vertex = i * vertices
    own.indices = triangles.indices
    own.count = triangles.count
    own.width = triangles.width
    own.height = triangles.height
    own.far = far
    own.cull = triangles.cull
    return own


@wp.kernel
def draw_stripe_cloned(
    first: int,
    triangles: ScreenTriangles,
    vertices: int,
    far: wp.array(dtype=float),
    view_0: int,
    block_mask: wp.array(dtype=int),
    stripes: int,
    key_out: wp.array2d(dtype=wp.uint64),  # (views H, W)
):
    """CUDA: ``draw_rows`` of one triangle in each view that needs it."""
    row, stripe = wp.tid()
    t = first + row
    for i in range(far.shape[0]):
        if needs(block_mask[t / MESH_LANES], view_0 + i):
            draw_rows(in_view(triangles, i, vertices, far[i]), t, stripe, stripes, i * triangles.height, key_out)


@wp.kernel
def draw_stripe_instanced(
    first: int,
    triangles: ScreenTriangles,
    vertices: int,
    far: wp.array(dtype=float),
    view_0: int,
    block_mask: wp.array(dtype=int),
    stripes: int,
    key_out: wp.array2d(dtype=wp.uint64),
):
    """CUDA: ``draw_rows`` of one triangle in one view."""
    row, i, stripe = wp.tid()
    t = first + row
    if needs(block_mask[t / MESH_LANES], view_0 + i):
        draw_rows(in_view(triangles, i, vertices, far[i]), t, stripe, stripes, i * triangles.height, key_out)


def clip_flagged(
    scratch: Scratch, points_ws: wp.array, view: View, clipped: np.ndarray, triangles: ScreenTriangles
) -> int:
    """Clips the triangles with these numbers and adds their pieces.

    Returns:
        How many triangles there are then.
    """
    slots = len(clipped)
    triangles.clip_screen = scratch.array("clip screen", (slots * CLIP_VERTICES,), wp.vec4)
    triangles.clip_corners = scratch.array("clip corners", (slots * CLIP_TRIANGLES,), wp.vec3i)
    triangles.clip_triangle = scratch.array("clip triangle", (slots * CLIP_TRIANGLES,), int)
    if slots:
        which = wp.array(clipped.astype(np.int32), dtype=int, device=scratch.device)
        outputs = [triangles.clip_screen, triangles.clip_corners, triangles.clip_triangle]
        clip = clip_homogeneous if points_ws.dtype is wp.vec4 else clip_triangles
        scratch.launch(clip, slots, [points_ws, triangles.indices, which, view], outputs)
    return triangles.count + slots * int(CLIP_TRIANGLES)


def draw_splits_plainly(
    scratch: Scratch,
    points_ws: wp.array,
    indices: wp.array,
    views: Sequence[View],
    seen: BlockViews,
    drawing: str,
    cull: int,
    targets: Callable[[int], tuple[wp.array, wp.array | None]],
    drawn: Callable[[int], None],
    stripes: bool | None = None,
) -> None:
    """``LaneRasteriser.draw_splits`` without lanes; ``stripes``: whether as on CUDA (one thread only on the CPU)."""
    on_stripes = stripes if stripes is not None else not wp.get_device(scratch.device).is_cpu
    vertices, count = len(points_ws), len(indices) // 3
    width, height = views[0].width, views[0].height
    together = 1 if drawing == "passes" else min(len(views), max(1, KEY_PIXELS // (width * height)))
    device_views = wp.array(list(views), dtype=View, device=scratch.device)
    for first in range(0, len(views), together):
        part = views[first : first + together]
        out = ScreenTriangles()
        out.screen = scratch.array("split screen", (len(part) * vertices,), wp.vec4)
        out.indices, out.count, out.width, out.height, out.cull = indices, count, width, height, cull
        inputs = [points_ws, device_views, first]
        if drawing == "cloned":
            scratch.launch(project_vertices_cloned, vertices, [*inputs, len(part), seen.run], [out.screen])
        else:
            scratch.launch(project_vertices_instanced, (vertices, len(part)), [*inputs, seen.run], [out.screen])
        flags = scratch.array("split flags", (len(part), count), wp.uint8)
        inputs = [out.screen, vertices, indices, first, seen.block]
        scratch.launch(flag_splits, (count, len(part)), inputs, [flags])
        if on_stripes:
            key = scratch.array("split key", (len(part) * height, width), wp.uint64)
            key.fill_(BACKGROUND_KEY)
            far = wp.array([view.far for view in part], dtype=float, device=scratch.device)
            inputs = [out, vertices, far, first, seen.block, STRIPES]
            if drawing == "cloned":
                scratch.launch(draw_stripe_cloned, (count, STRIPES), inputs, [key])
            else:
                scratch.launch(draw_stripe_instanced, (count, len(part), STRIPES), inputs, [key])
        flagged = flags.numpy()
        for i, view in enumerate(part):
            depth_out, triangle_out = targets(first + i)
            with_triangles = int(triangle_out is not None)
            triangle_out = scratch.array("no triangles", (1, 1), int) if triangle_out is None else triangle_out
            out.first_vertex, out.far = i * vertices, view.far
            total = clip_flagged(scratch, points_ws, view, np.flatnonzero(flagged[i]), out)
            if on_stripes:
                scratch.launch(draw_stripe, (total - count, STRIPES), [out, count, i * height, STRIPES], [key])
                own = key[i * height : (i + 1) * height]
                scratch.launch(split_key, own.shape, [own, with_triangles], [depth_out, triangle_out])
            else:
                draw_tiles(scratch, out, total, with_triangles, depth_out, triangle_out)
            drawn(first + i)

"""Triangle rasteriser: nearest linear depth and triangle per pixel.

On the CPU it is tile binned: vertices are projected once, triangles are counted and listed per 32 x 32 tile by chunks that
own their lists (no atomics), and each tile is drawn by one thread, in triangle order: the same bits for any number of
threads. On CUDA every (triangle, row stripe) is a thread and depth and triangle meet in one 64-bit atomic minimum. Both use
the same coverage and depth functions and agree bit for bit in which triangle wins a tie (the first).

Coverage is exact: vertices are snapped to 1/256 pixel, edge functions are 64-bit integers, and the top-left rule gives a
pixel centre on a shared edge to exactly one triangle. Depth is interpolated with barycentric weights from those integers,
which are all positive, so it keeps its relative precision whatever near and far are. Triangles that cross the near plane or
leave the guard band are clipped first (Sutherland-Hodgman in homogeneous coordinates).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from wkernels.launch import launch
from wkernels.views import View

TILE = wp.constant(32)
CHUNKS = 32
SUBPIXELS = wp.constant(256)
HALF_PIXEL = wp.constant(128)
PIXEL_STEP = wp.constant(wp.int64(256))
GUARD_PIXELS = wp.constant(16384.0)  # snapped coordinates stay below 2^23, edge functions below 2^49
CLIP_PLANES = wp.constant(5)
CLIP_VERTICES = wp.constant(3 + CLIP_PLANES)  # each plane adds at most one vertex to a convex polygon
CLIP_TRIANGLES = wp.constant(1 + CLIP_PLANES)
CUDA_STRIPES = 16

CULL_NONE, CULL_BACK, CULL_FRONT = 0, 1, 2
NO_TRIANGLE = wp.constant(-1)

_Polygon = wp.types.matrix(shape=(3 + CLIP_PLANES, 4), dtype=float)
_BACKGROUND_KEY = wp.constant(wp.uint64(0x7F800000FFFFFFFF))  # +inf depth, triangle -1


@wp.func
def to_homogeneous_pixels(view: View, position_ws: wp.vec3):
    """(x w, y w, linear depth, w) with x and y in pixels, row 0 at the top."""
    clip = view.ws_to_ss * wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
    return wp.vec4(
        0.5 * (clip[0] + clip[3]) * float(view.width), 0.5 * (clip[3] - clip[1]) * float(view.height), clip[2], clip[3]
    )


@wp.func
def inside_distance(plane: int, h: wp.vec4, near: float):
    """Signed distance (any positive scale) of a homogeneous pixel position to a clip plane: near, then the guard band."""
    distance = h[2] - near
    if plane == 1:
        distance = h[0] + GUARD_PIXELS * h[3]
    if plane == 2:
        distance = GUARD_PIXELS * h[3] - h[0]
    if plane == 3:
        distance = h[1] + GUARD_PIXELS * h[3]
    if plane == 4:
        distance = GUARD_PIXELS * h[3] - h[1]
    return distance


@wp.func
def needs_clipping(h: wp.vec4, near: float):
    """Whether a vertex lies outside the near plane or the guard band, or is not finite."""
    inside = h[2] >= near and h[3] > 0.0 and wp.abs(h[0]) <= GUARD_PIXELS * h[3] and wp.abs(h[1]) <= GUARD_PIXELS * h[3]
    return not inside


@wp.kernel
def project_vertices(first: int, points_ws: wp.array(dtype=wp.vec3), view: View, screen_out: wp.array(dtype=wp.vec4)):
    """Screen vertex (x, y in pixels, linear depth / w, 1 / w); the last is -1 where the vertex needs clipping."""
    i = first + wp.tid()
    h = to_homogeneous_pixels(view, points_ws[i])
    if needs_clipping(h, view.near):
        screen_out[i] = wp.vec4(0.0, 0.0, 0.0, -1.0)
    else:
        over_w = 1.0 / h[3]
        screen_out[i] = wp.vec4(h[0] * over_w, h[1] * over_w, h[2] * over_w, over_w)


@wp.kernel
def flag_clipped(
    first: int, screen: wp.array(dtype=wp.vec4), indices: wp.array(dtype=int), clipped_out: wp.array(dtype=wp.uint8)
):
    """1 where a triangle has vertices on both sides of the near plane or the guard band."""
    t = first + wp.tid()
    a = screen[indices[3 * t]][3]
    b = screen[indices[3 * t + 1]][3]
    c = screen[indices[3 * t + 2]][3]
    flag = wp.uint8(0)
    if a < 0.0 or b < 0.0 or c < 0.0:
        flag = wp.uint8(1)
    clipped_out[t] = flag


@wp.func
def is_finite_position(p: wp.vec3):
    """Whether all coordinates are finite (a NaN compares false)."""
    return wp.abs(p[0]) + wp.abs(p[1]) + wp.abs(p[2]) < 3.0e38


@wp.kernel
def clip_triangles(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    clipped: wp.array(dtype=int),
    view: View,
    screen_out: wp.array(dtype=wp.vec4),
    corners_out: wp.array(dtype=wp.vec3i),
    triangle_out: wp.array(dtype=int),
):
    """Clips one flagged triangle into a fan; slots it does not need become triangles without area."""
    k = first + wp.tid()
    t = clipped[k]
    polygon = _Polygon()
    kept = _Polygon()
    count = int(0)
    if (
        is_finite_position(points_ws[indices[3 * t]])
        and is_finite_position(points_ws[indices[3 * t + 1]])
        and is_finite_position(points_ws[indices[3 * t + 2]])
    ):
        count = 3
    for i in range(count):
        polygon[i] = to_homogeneous_pixels(view, points_ws[indices[3 * t + i]])
    for plane in range(CLIP_PLANES):
        n = int(0)
        for i in range(count):
            a = polygon[i]
            b = polygon[(i + 1) % count]
            da = inside_distance(plane, a, view.near)
            db = inside_distance(plane, b, view.near)
            if da >= 0.0:
                kept[n] = a
                n += 1
                if db < 0.0:
                    kept[n] = a + (b - a) * (da / (da - db))
                    n += 1
            elif db >= 0.0:  # always from the inside vertex, so that both triangles of an edge find the same point
                kept[n] = b + (a - b) * (db / (db - da))
                n += 1
        for i in range(n):
            polygon[i] = kept[i]
        count = n
    base = k * CLIP_VERTICES
    screen_out[base] = wp.vec4()
    for i in range(count):
        over_w = 1.0 / polygon[i][3]
        screen_out[base + i] = wp.vec4(polygon[i][0] * over_w, polygon[i][1] * over_w, polygon[i][2] * over_w, over_w)
    for i in range(CLIP_TRIANGLES):
        corners = wp.vec3i(base, base, base)
        if i + 2 < count:
            corners = wp.vec3i(base, base + i + 1, base + i + 2)
        corners_out[k * CLIP_TRIANGLES + i] = corners
        triangle_out[k * CLIP_TRIANGLES + i] = t


@wp.struct
class ScreenTriangles:
    """Projected triangles: those of the mesh, then the fans of the clipped ones."""

    screen: wp.array(dtype=wp.vec4)  # x, y in pixels, linear depth / w, 1 / w (-1: was clipped)
    indices: wp.array(dtype=int)
    count: int
    clip_screen: wp.array(dtype=wp.vec4)
    clip_corners: wp.array(dtype=wp.vec3i)
    clip_triangle: wp.array(dtype=int)
    width: int
    height: int
    far: float
    cull: int


@wp.struct
class Setup:
    """One triangle ready to be tested against pixels, wound so that its inside is where all edge functions are positive."""

    a: wp.vec4
    b: wp.vec4
    c: wp.vec4
    ax: wp.int64
    ay: wp.int64
    bx: wp.int64
    by: wp.int64
    cx: wp.int64
    cy: wp.int64
    over_area: float
    x0: int  # pixels whose centres the bounding box holds, clamped to the screen; x1 < x0 where there are none
    y0: int
    x1: int
    y1: int


@wp.func
def snap(pixels: float):
    """Screen coordinate in 1/256 pixel."""
    return wp.int64(wp.floor(pixels * float(SUBPIXELS) + 0.5))


@wp.func
def set_up(triangles: ScreenTriangles, t: int):
    """Fetches, orients, snaps and bounds triangle ``t``; an empty box where it is culled or has no area."""
    s = Setup()
    s.x0 = 0
    s.x1 = -1
    s.y0 = 0
    s.y1 = -1
    a = wp.vec4()
    b = wp.vec4()
    c = wp.vec4()
    if t < triangles.count:
        a = triangles.screen[triangles.indices[3 * t]]
        b = triangles.screen[triangles.indices[3 * t + 1]]
        c = triangles.screen[triangles.indices[3 * t + 2]]
    else:
        corners = triangles.clip_corners[t - triangles.count]
        a = triangles.clip_screen[corners[0]]
        b = triangles.clip_screen[corners[1]]
        c = triangles.clip_screen[corners[2]]
    if a[3] < 0.0 or b[3] < 0.0 or c[3] < 0.0:
        return s
    low_x = wp.max(wp.min(wp.min(a[0], b[0]), c[0]), -1.0)
    high_x = wp.min(wp.max(wp.max(a[0], b[0]), c[0]), float(triangles.width) + 1.0)
    low_y = wp.max(wp.min(wp.min(a[1], b[1]), c[1]), -1.0)
    high_y = wp.min(wp.max(wp.max(a[1], b[1]), c[1]), float(triangles.height) + 1.0)
    # snapping moves a vertex by up to 1/512 pixel, so the box is taken a little wider than the float coordinates say
    x0 = wp.max(int(wp.ceil(low_x - 0.502)), 0)
    x1 = wp.min(int(wp.floor(high_x - 0.498)), triangles.width - 1)
    y0 = wp.max(int(wp.ceil(low_y - 0.502)), 0)
    y1 = wp.min(int(wp.floor(high_y - 0.498)), triangles.height - 1)
    if x1 < x0 or y1 < y0:
        return s
    s.a = a
    s.b = b
    s.c = c
    s.ax = snap(a[0])
    s.ay = snap(a[1])
    s.bx = snap(b[0])
    s.by = snap(b[1])
    s.cx = snap(c[0])
    s.cy = snap(c[1])
    area = (s.bx - s.ax) * (s.cy - s.ay) - (s.by - s.ay) * (s.cx - s.ax)
    # rows run downwards, so a triangle that is counter-clockwise seen from the view has negative area here
    front = area < wp.int64(0)
    if area == wp.int64(0) or (front and triangles.cull == 2) or (not front and triangles.cull == 1):
        return s
    if front:
        s.b = c
        s.c = b
        other_x = s.bx
        other_y = s.by
        s.bx = s.cx
        s.by = s.cy
        s.cx = other_x
        s.cy = other_y
        area = -area
    s.over_area = 1.0 / float(area)
    s.x0 = x0
    s.x1 = x1
    s.y0 = y0
    s.y1 = y1
    return s


@wp.func
def edge(ax: wp.int64, ay: wp.int64, bx: wp.int64, by: wp.int64, x: wp.int64, y: wp.int64):
    """Twice the signed area of (a, b, point), in squared subpixels; positive to the inside of edge a -> b."""
    return (bx - ax) * (y - ay) - (by - ay) * (x - ax)


@wp.func
def top_left_bias(ax: wp.int64, ay: wp.int64, bx: wp.int64, by: wp.int64):
    """0 for a top or left edge, which owns the pixel centres on it, else -1."""
    bias = wp.int64(-1)
    if by < ay or (by == ay and bx > ax):
        bias = wp.int64(0)
    return bias


@wp.func
def triangle_id(triangles: ScreenTriangles, t: int):
    """Index in the mesh of a triangle or of the one that a clipped piece was cut from."""
    result = t
    if t >= triangles.count:
        result = triangles.clip_triangle[t - triangles.count]
    return result


@wp.func
def interpolate_depth(s: Setup, e_a: wp.int64, e_b: wp.int64, e_c: wp.int64):
    """Linear depth from the edge functions opposite a, b, c, all >= 0: perspective correct, affine for orthographic views."""
    l_a = float(e_a)
    l_b = float(e_b)
    l_c = float(e_c)
    return (l_a * s.a[2] + l_b * s.b[2] + l_c * s.c[2]) / (l_a * s.a[3] + l_b * s.b[3] + l_c * s.c[3])


@wp.kernel
def count_tiles(
    first: int,
    triangles: ScreenTriangles,
    total: int,
    chunks: int,
    tiles_x: int,
    tiles: int,
    box_out: wp.array(dtype=wp.vec4ub),
    counts_out: wp.array2d(dtype=int),  # (tiles, chunks)
):
    """Tile bounds of every triangle of one chunk, and how many triangles of the chunk each tile gets."""
    chunk = first + wp.tid()
    for tile in range(tiles):
        counts_out[tile, chunk] = 0
    begin = int(wp.int64(total) * wp.int64(chunk) / wp.int64(chunks))
    end = int(wp.int64(total) * wp.int64(chunk + 1) / wp.int64(chunks))
    for t in range(begin, end):
        s = set_up(triangles, t)
        box = wp.vec4ub(wp.uint8(1), wp.uint8(0), wp.uint8(0), wp.uint8(0))
        if s.x1 >= s.x0:
            box = wp.vec4ub(
                wp.uint8(s.x0 / TILE), wp.uint8(s.y0 / TILE), wp.uint8(s.x1 / TILE), wp.uint8(s.y1 / TILE)
            )
            for y in range(s.y0 / TILE, s.y1 / TILE + 1):
                for x in range(s.x0 / TILE, s.x1 / TILE + 1):
                    counts_out[y * tiles_x + x, chunk] += 1
        box_out[t] = box


@wp.kernel
def list_tiles(
    first: int,
    box: wp.array(dtype=wp.vec4ub),
    total: int,
    chunks: int,
    tiles_x: int,
    next_slot: wp.array2d(dtype=int),  # (tiles, chunks), advanced
    list_out: wp.array(dtype=int),
):
    """Writes the triangles of one chunk into the tiles' lists, each in triangle order."""
    chunk = first + wp.tid()
    begin = int(wp.int64(total) * wp.int64(chunk) / wp.int64(chunks))
    end = int(wp.int64(total) * wp.int64(chunk + 1) / wp.int64(chunks))
    for t in range(begin, end):
        b = box[t]
        for y in range(int(b[1]), int(b[3]) + 1):
            for x in range(int(b[0]), int(b[2]) + 1):
                tile = y * tiles_x + x
                slot = next_slot[tile, chunk]
                next_slot[tile, chunk] = slot + 1
                list_out[slot] = t


@wp.kernel
def draw_tile(
    first: int,
    triangles: ScreenTriangles,
    tiles_x: int,
    tile_begin: wp.array(dtype=int),
    tile_list: wp.array(dtype=int),
    with_triangles: int,
    depth_out: wp.array2d(dtype=float),
    triangle_out: wp.array2d(dtype=int),
):
    """Clears one tile and draws its triangles, keeping the nearest depth; ties go to the lower triangle index."""
    tile = first + wp.tid()
    left = (tile % tiles_x) * TILE
    top = (tile / tiles_x) * TILE
    right = wp.min(left + TILE, triangles.width) - 1
    bottom = wp.min(top + TILE, triangles.height) - 1
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            depth_out[y, x] = wp.inf
    if with_triangles != 0:
        for y in range(top, bottom + 1):
            for x in range(left, right + 1):
                triangle_out[y, x] = NO_TRIANGLE
    for k in range(tile_begin[tile], tile_begin[tile + 1]):
        s = set_up(triangles, tile_list[k])
        x0 = wp.max(s.x0, left)
        x1 = wp.min(s.x1, right)
        y0 = wp.max(s.y0, top)
        y1 = wp.min(s.y1, bottom)
        px = wp.int64(x0 * SUBPIXELS + HALF_PIXEL)
        py = wp.int64(y0 * SUBPIXELS + HALF_PIXEL)
        bias_a = top_left_bias(s.bx, s.by, s.cx, s.cy)
        bias_b = top_left_bias(s.cx, s.cy, s.ax, s.ay)
        bias_c = top_left_bias(s.ax, s.ay, s.bx, s.by)
        row_a = edge(s.bx, s.by, s.cx, s.cy, px, py) + bias_a
        row_b = edge(s.cx, s.cy, s.ax, s.ay, px, py) + bias_b
        row_c = edge(s.ax, s.ay, s.bx, s.by, px, py) + bias_c
        dx_a = (s.by - s.cy) * PIXEL_STEP
        dx_b = (s.cy - s.ay) * PIXEL_STEP
        dx_c = (s.ay - s.by) * PIXEL_STEP
        dy_a = (s.cx - s.bx) * PIXEL_STEP
        dy_b = (s.ax - s.cx) * PIXEL_STEP
        dy_c = (s.bx - s.ax) * PIXEL_STEP
        for y in range(y0, y1 + 1):
            e_a = row_a
            e_b = row_b
            e_c = row_c
            for x in range(x0, x1 + 1):
                if (e_a | e_b | e_c) >= wp.int64(0):
                    depth = interpolate_depth(s, e_a - bias_a, e_b - bias_b, e_c - bias_c)
                    old = depth_out[y, x]
                    if depth <= old and depth <= triangles.far:
                        if with_triangles != 0:
                            t = triangle_id(triangles, tile_list[k])
                            if depth < old or t < triangle_out[y, x]:
                                triangle_out[y, x] = t
                        depth_out[y, x] = depth
                e_a += dx_a
                e_b += dx_b
                e_c += dx_c
            row_a += dy_a
            row_b += dy_b
            row_c += dy_c


@wp.kernel
def draw_stripe(first: int, triangles: ScreenTriangles, stripes: int, key_out: wp.array2d(dtype=wp.uint64)):
    """CUDA: every ``stripes``-th row of one triangle into the 64-bit (depth, triangle) minimum."""
    i, stripe = wp.tid()
    t = first + i
    s = set_up(triangles, t)
    bias_a = top_left_bias(s.bx, s.by, s.cx, s.cy)
    bias_b = top_left_bias(s.cx, s.cy, s.ax, s.ay)
    bias_c = top_left_bias(s.ax, s.ay, s.bx, s.by)
    low = wp.uint64(triangle_id(triangles, t))
    for y in range(s.y0 + stripe, s.y1 + 1, stripes):
        py = wp.int64(y * SUBPIXELS + HALF_PIXEL)
        px = wp.int64(s.x0 * SUBPIXELS + HALF_PIXEL)
        e_a = edge(s.bx, s.by, s.cx, s.cy, px, py) + bias_a
        e_b = edge(s.cx, s.cy, s.ax, s.ay, px, py) + bias_b
        e_c = edge(s.ax, s.ay, s.bx, s.by, px, py) + bias_c
        for x in range(s.x0, s.x1 + 1):
            if (e_a | e_b | e_c) >= wp.int64(0):
                depth = interpolate_depth(s, e_a - bias_a, e_b - bias_b, e_c - bias_c)
                if depth <= triangles.far:
                    high = wp.uint64(wp.cast(depth, wp.uint32))  # order of positive floats = order of their bits
                    wp.atomic_min(key_out, y, x, (high << wp.uint64(32)) | low)
            e_a += (s.by - s.cy) * PIXEL_STEP
            e_b += (s.cy - s.ay) * PIXEL_STEP
            e_c += (s.ay - s.by) * PIXEL_STEP


@wp.kernel
def split_key(
    first: int,
    key: wp.array2d(dtype=wp.uint64),
    with_triangles: int,
    depth_out: wp.array2d(dtype=float),
    triangle_out: wp.array2d(dtype=int),
):
    """Depth and triangle of the winning key."""
    row, x = wp.tid()
    y = first + row
    depth_out[y, x] = wp.cast(wp.uint32(key[y, x] >> wp.uint64(32)), float)
    if with_triangles != 0:
        triangle_out[y, x] = int(wp.uint32(key[y, x] & wp.uint64(0xFFFFFFFF)))


@dataclass
class Rasteriser:
    """Draws triangles into depth maps; keeps its scratch memory between calls.

    Attributes:
        device: Warp device.
        threads: CPU threads; None for all.
    """

    device: str = "cpu"
    threads: int | None = None
    _scratch: dict[str, wp.array] = field(default_factory=dict, repr=False)

    def draw(
        self,
        points_ws: wp.array,
        indices: wp.array,
        view: View,
        depth_out: wp.array,
        triangle_out: wp.array | None = None,
        cull: int = CULL_NONE,
    ) -> None:
        """Clears the targets and draws all triangles.

        Args:
            points_ws: vec3, shape (V,).
            indices: int32, shape (3 T,).
            view: Target size and projection; 1 to 8192 pixels per side.
            depth_out: float32 (H, W): linear depth of the nearest surface, +inf where there is none.
            triangle_out: int32 (H, W): its triangle, -1 where there is none.
            cull: CULL_NONE, CULL_BACK or CULL_FRONT, as seen from the view (counter-clockwise is front).
        """
        triangles, total = self._project(points_ws, indices, view, cull)
        with_triangles = int(triangle_out is not None)
        if triangle_out is None:
            triangle_out = self._array("no_triangles", (1, 1), int)
        if not wp.get_device(self.device).is_cpu:
            key = self._array("key", (view.height, view.width), wp.uint64)
            key.fill_(_BACKGROUND_KEY)
            self._launch(draw_stripe, (total, CUDA_STRIPES), [triangles, CUDA_STRIPES], [key])
            self._launch(split_key, key.shape, [key, with_triangles], [depth_out, triangle_out])
            return
        tiles_x, tiles_y = -(-view.width // TILE), -(-view.height // TILE)
        tiles = tiles_x * tiles_y
        box = self._array("box", (total,), wp.vec4ub)
        counts = self._array("counts", (tiles, CHUNKS), int)
        self._launch(count_tiles, CHUNKS, [triangles, total, CHUNKS, tiles_x, tiles], [box, counts], tile=1)
        ends = np.cumsum(counts.numpy().ravel(), dtype=np.int64)
        starts = np.concatenate([[0], ends])
        begin = self._array("begin", (tiles + 1,), int)
        begin.numpy()[:] = starts[::CHUNKS]
        counts.numpy().ravel()[:] = starts[:-1]
        listed = self._array("list", (int(starts[-1]),), int)
        self._launch(list_tiles, CHUNKS, [box, total, CHUNKS, tiles_x, counts], [listed], tile=1)
        inputs = [triangles, tiles_x, begin, listed, with_triangles]
        self._launch(draw_tile, tiles, inputs, [depth_out, triangle_out])

    def _project(self, points_ws: wp.array, indices: wp.array, view: View, cull: int) -> tuple[ScreenTriangles, int]:
        count = len(indices) // 3
        out = ScreenTriangles()
        out.screen = self._array("screen", (len(points_ws),), wp.vec4)
        out.indices, out.count = indices, count
        out.width, out.height, out.far, out.cull = view.width, view.height, view.far, cull
        self._launch(project_vertices, len(points_ws), [points_ws, view], [out.screen])
        flags = self._array("flags", (count,), wp.uint8)
        self._launch(flag_clipped, count, [out.screen, indices], [flags])
        clipped = np.flatnonzero(flags.numpy()[:count]).astype(np.int32)  # scratch holds at least one
        slots = len(clipped)
        out.clip_screen = self._array("clip_screen", (slots * CLIP_VERTICES,), wp.vec4)
        out.clip_corners = self._array("clip_corners", (slots * CLIP_TRIANGLES,), wp.vec3i)
        out.clip_triangle = self._array("clip_triangle", (slots * CLIP_TRIANGLES,), int)
        if slots:
            which = wp.array(clipped, dtype=int, device=self.device)
            self._launch(
                clip_triangles,
                slots,
                [points_ws, indices, which, view],
                [out.clip_screen, out.clip_corners, out.clip_triangle],
            )
        return out, count + slots * CLIP_TRIANGLES

    def _array(self, name: str, shape: tuple[int, ...], dtype: type) -> wp.array:
        """Scratch of at least this size, reused; exact shape where it has two axes."""
        held = self._scratch.get(name)
        fits = held is not None and (held.shape == shape if len(shape) > 1 else held.shape[0] >= shape[0])
        if not fits:
            room = shape if len(shape) > 1 else (max(1, shape[0] + shape[0] // 4),)
            held = self._scratch[name] = wp.empty(room, dtype=dtype, device=self.device)
        assert held is not None
        return held if len(shape) > 1 or held.shape == shape else held[: max(1, shape[0])]

    def _launch(self, kernel: wp.Kernel, dim: int | tuple[int, ...], inputs: list, outputs: list, tile: int | None = None) -> None:
        launch(kernel, dim, inputs, outputs, device=self.device, threads=self.threads, tile=tile)

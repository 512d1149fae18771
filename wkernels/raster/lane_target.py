"""What the lane rasteriser draws into: keys of depth, 8 pixels of a row at a time, and what becomes of them."""

from __future__ import annotations

import warp as wp

from wkernels.raster.triangles import NO_TRIANGLE

PIECE = wp.constant(8)  # pixels drawn in one step
FAR_KEY = wp.constant(1.0e30)
PEELED = wp.constant(4.0e30)  # times 1/2: beyond any key
HUGE = wp.constant(1.0e38)
LEAST_FACTOR = wp.constant(1.0e-30)  # beyond a warped view's horizon, where nothing is drawn

Piece = wp.types.vector(length=PIECE, dtype=wp.float32)
IntPiece = wp.types.vector(length=PIECE, dtype=wp.int32)


@wp.struct
class Target:
    """The images that are drawn into, at least a piece wide. They hold keys and, as floats, triangles until the end."""

    key: wp.array(dtype=float)  # flat, ``pitch`` from row to row
    key_piece: wp.array(dtype=Piece)  # the same memory, a piece from every float on
    triangle: wp.array(dtype=float)
    triangle_piece: wp.array(dtype=Piece)
    triangle_out: wp.array(dtype=int)  # the same memory as integers
    triangle_out_piece: wp.array(dtype=IntPiece)
    with_triangles: int
    width: int
    height: int
    pitch: int
    peels: int  # 1: keys are kept in ``nearer`` too; 2: and only what lies farther than those there is drawn
    nearer: wp.array(dtype=float)  # the keys of what was peeled off before, of the same pitch
    nearer_piece: wp.array(dtype=Piece)


@wp.struct
class DepthKey:
    """What the keys of a view are and how depths follow from them."""

    perspective: int  # 1: key -1/w, depth = factor / -key; 0: key depth/w, depth = key / factor
    warped: int  # whether the factor is not 1
    constant: float  # factor = constant + per_column * column + per_row * row
    per_column: float
    per_row: float


@wp.func
def span_of_rows(target: Target, top: int, bottom: int):
    """How many spans of pixels rows are cleared and finished as, and how long each is: rows side by side are one."""
    rows = bottom - top + 1
    return wp.where(target.pitch == target.width, wp.vec2i(1, rows * target.width), wp.vec2i(rows, target.width))


@wp.func
def clear_rows(target: Target, key: DepthKey, top: int, bottom: int):
    """Rows in which nothing is drawn yet."""
    clear = Piece(wp.where(key.perspective == 1, 0.0, FAR_KEY))
    nothing = Piece(-1.0)
    span = span_of_rows(target, top, bottom)
    for row in range(span[0]):
        begin = (top + row) * target.pitch
        end = begin + span[1]
        last_piece = end - PIECE  # a row is at least a piece wide; clearing some pixels twice does no harm
        for at in range(begin, end, PIECE):
            target.key_piece[wp.min(at, last_piece)] = clear
        if target.with_triangles != 0:
            for at in range(begin, end, PIECE):
                target.triangle_piece[wp.min(at, last_piece)] = nothing


@wp.func
def keep_piece(target: Target, at: int, key: Piece, triangle: Piece):
    """Keeps the nearer of a piece's keys and the target's, and its triangle; the first stays where they are equal."""
    old = target.key_piece[at]
    if target.with_triangles != 0:
        nearer = wp.min(wp.max((old - key) * HUGE, Piece(0.0)), Piece(1.0))
        held = target.triangle_piece[at]
        target.triangle_piece[at] = held + wp.cw_mul(nearer, triangle - held)
    target.key_piece[at] = wp.min(old, key)


@wp.func
def draw_piece(target: Target, at: int, key: Piece, triangle: Piece):
    """``keep_piece`` of what lies farther than what was peeled off before, if anything was."""
    if target.peels == 2:
        farther = wp.min(wp.max((key - target.nearer_piece[at]) * HUGE, Piece(0.0)), Piece(1.0))
        keep_piece(target, at, wp.max(key, (Piece(0.5) - farther) * PEELED), triangle)
    else:
        keep_piece(target, at, key, triangle)


@wp.func
def unwarp(key: DepthKey, target: Target, top: int, bottom: int, steps: Piece):
    """Rewrites a band's keys as those that the view would have without a warp: of depth itself."""
    width = target.width
    least = Piece(LEAST_FACTOR)
    for y in range(top, bottom + 1):
        row = key.constant + key.per_row * float(y)
        whole = width / PIECE * PIECE
        for x in range(0, whole, PIECE):
            factor = wp.max(steps * key.per_column + Piece(row + key.per_column * float(x)), least)
            held = target.key_piece[y * target.pitch + x]
            target.key_piece[y * target.pitch + x] = wp.cw_div(held, factor)
        for x in range(whole, width):
            factor_x = wp.max(row + key.per_column * float(x), LEAST_FACTOR)
            target.key[y * target.pitch + x] = target.key[y * target.pitch + x] / factor_x


@wp.func
def keep_keys(target: Target, top: int, bottom: int):
    """Keys of rows into ``nearer``, for what is peeled off next."""
    span = span_of_rows(target, top, bottom)
    for row in range(span[0]):
        begin = (top + row) * target.pitch
        end = begin + span[1]
        for at in range(begin, end, PIECE):
            piece = wp.min(at, end - PIECE)
            target.nearer_piece[piece] = target.key_piece[piece]


@wp.func
def finish_rows(target: Target, key: DepthKey, top: int, bottom: int, far: float, steps: Piece):
    """Keys become depths, floats numbers; what lies beyond the far plane, and the background, overflows to infinity."""
    if target.peels != 0:
        keep_keys(target, top, bottom)
    if key.warped != 0:
        unwarp(key, target, top, bottom, steps)
    perspective = key.perspective
    one = Piece(1.0)
    zero = Piece(0.0)
    nothing = Piece(-1.0)
    limit = Piece(far)
    span = span_of_rows(target, top, bottom)
    for row in range(span[0]):
        begin = (top + row) * target.pitch
        end = begin + span[1]
        whole = (end - begin) / PIECE * PIECE
        for at in range(begin, begin + whole, PIECE):
            depth = target.key_piece[at]
            if perspective == 1:
                depth = wp.cw_div(one, zero - depth)  # 0 - 0 is +0, whose reciprocal is +inf
            beyond = wp.max(depth - limit, zero) * HUGE
            target.key_piece[at] = depth + beyond * HUGE
            if target.with_triangles != 0:
                held = target.triangle_piece[at]
                target.triangle_out_piece[at] = IntPiece(held + wp.cw_mul(wp.min(beyond, one), nothing - held))
        for at in range(begin + whole, end):
            last = float(target.key[at])
            if perspective == 1:
                last = 1.0 / (0.0 - last)
            target.key[at] = wp.where(last <= far, last, wp.inf)
            if target.with_triangles != 0:
                target.triangle_out[at] = wp.where(last <= far, int(target.triangle[at]), NO_TRIANGLE)

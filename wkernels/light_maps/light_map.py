"""Light depth maps and the questions that techniques ask of them.

A map has one or more square layers (six for an omnidirectional point light), each with linear depth from the light in
scene units and a world-to-light matrix of the same form as a view's (``views.py``). Positions in a map are in texels,
row 0 at the top, texel centres at half-integers.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.light_maps.storage import MapLayout, layers_on_host

BIAS_NONE, BIAS_CONSTANT, BIAS_SLOPE, BIAS_NORMAL = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)
BY_MARGIN, BY_DEPTH, FIRST_INSIDE = wp.constant(0), wp.constant(1), wp.constant(2)
FILTER_TEXELS = wp.constant(4.0)  # a finer layer is taken only this far inside its border, where filters have room
ROUNDING = wp.constant(2.0e-6)  # relative: what float32 loses between the map's depth and the receiver's
BORDER = wp.constant(1.0e-3)  # texels: taps beyond the map move so far inside it, enough for float32 at 8192 texels


@wp.struct
class LightMap:
    """A light depth map on the device."""

    depth: wp.array(dtype=float)  # all layers, linear; +inf: empty; negative: the caster moves (tagged maps only)
    layer_begin: wp.array(dtype=int)  # (layers,) a texel is depth[layer_begin[layer] + row * pitch + column]
    pitch: int
    ws_to_ls: wp.array(dtype=wp.mat44)  # (layers,) rows x, y, linear depth, w
    right_ws: wp.array(dtype=wp.vec3)  # (layers,) map axes, unit
    up_ws: wp.array(dtype=wp.vec3)
    layers: int
    resolution: int
    light_ws: wp.vec4  # the light sample: a point (w = 1) or the direction towards the light (w = 0)
    near: float  # linear depth of the near plane
    selection: int  # which layer a receiver reads: BY_MARGIN, BY_DEPTH or FIRST_INSIDE
    eye_row: wp.vec4  # eye depth of a position p is dot(eye_row, (p, 1)); for BY_DEPTH
    split_far: wp.array(dtype=float)  # (layers,) eye depth at which a layer's split ends; for BY_DEPTH


@wp.struct
class Bias:
    """How a comparison is kept from shadowing its own surface; see ``locate_receiver``."""

    kind: int  # BIAS_NONE, BIAS_CONSTANT, BIAS_SLOPE or BIAS_NORMAL
    constant: float  # scene units along the light's depth axis (BIAS_NORMAL: along the receiver's normal)
    slope: float  # multiples of the least bias that one texel needs on the receiver's plane


@wp.struct
class Receiver:
    """A receiver point in a map, with the plane through it."""

    layer: int  # -1 where no layer covers the point
    visible: float  # visibility that needs no comparison, where the layer is -1
    x: float  # texels
    y: float
    depth: float  # linear, scene units, bias included
    plane_depth: wp.vec3  # depth of the receiver plane at a texel offset o, before bias:
    plane_scale: wp.vec3  #   dot(plane_depth, (o.x, o.y, 1)) / dot(plane_scale, (o.x, o.y, 1))
    bias: float


def layout_of(light_map: LightMap) -> MapLayout:
    """Where the layers of a map lie; its ``texels`` are what the map takes of memory."""
    begin = tuple(int(b) for b in light_map.layer_begin.numpy())
    return MapLayout(begin, light_map.pitch, light_map.depth.size, light_map.resolution)


def depths_on_host(light_map: LightMap) -> np.ndarray:
    """The map's depths, float32 (layers, R, R); a copy."""
    return layers_on_host(light_map.depth, layout_of(light_map))


@wp.func
def to_texel(light_map: LightMap, layer: int, column: int, row: int):
    """Where in the map's memory a texel lies; column and row are inside the layer."""
    return light_map.layer_begin[layer] + row * light_map.pitch + column


@wp.func
def to_split(light_map: LightMap, position_ws: wp.vec3):
    """The first layer that holds a position and, BY_DEPTH, whose split has not ended before it; or -1.

    A position that no layer holds with room for a filter reads the last one that holds it at all.
    """
    position = wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
    by_depth = light_map.selection == BY_DEPTH
    eye_depth = wp.dot(light_map.eye_row, position)
    room = 2.0 * FILTER_TEXELS / float(light_map.resolution)
    best = int(-1)
    reserve = int(-1)
    for layer in range(light_map.layers):
        h = light_map.ws_to_ls[layer] * position
        if best < 0 and h[3] > 0.0:
            inside = 1.0 - wp.max(wp.abs(h[0]), wp.abs(h[1])) / h[3]
            if inside >= 0.0:
                reserve = layer
                if by_depth:
                    if eye_depth < light_map.split_far[layer]:
                        best = layer
                elif inside >= room:
                    best = layer
    return wp.where(best >= 0, best, reserve)


@wp.func
def to_layer(light_map: LightMap, position_ws: wp.vec3):
    """The layer that a position is looked up in, or -1: ``light_map.selection`` of those that hold it."""
    best = int(-1)
    margin = float(0.0)
    if light_map.selection != BY_MARGIN:
        return to_split(light_map, position_ws)
    for layer in range(light_map.layers):
        h = light_map.ws_to_ls[layer] * wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
        if h[3] > 0.0:
            inside = 1.0 - wp.max(wp.abs(h[0]), wp.abs(h[1])) / h[3]
            if inside >= margin:
                margin = inside
                best = layer
    return best


@wp.func
def locate(light_map: LightMap, position_ws: wp.vec3):
    """(x, y in texels, linear depth, layer) of a world position; layer -1 where no layer covers it."""
    layer = to_layer(light_map, position_ws)
    result = wp.vec4(0.0, 0.0, 0.0, -1.0)
    if layer >= 0:
        h = light_map.ws_to_ls[layer] * wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
        size = float(light_map.resolution)
        result = wp.vec4((0.5 + 0.5 * h[0] / h[3]) * size, (0.5 - 0.5 * h[1] / h[3]) * size, h[2], float(layer))
    return result


@wp.func
def texels_per_length(light_map: LightMap, layer: int, position_ws: wp.vec3):
    """How many texels a unit length across the map axes covers at a position, (along x, along y)."""
    m = light_map.ws_to_ls[layer]
    h = m * wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
    right = light_map.right_ws[layer]
    up = light_map.up_ws[layer]
    row_x = wp.vec3(m[0, 0], m[0, 1], m[0, 2])
    row_y = wp.vec3(m[1, 0], m[1, 1], m[1, 2])
    row_w = wp.vec3(m[3, 0], m[3, 1], m[3, 2])
    half = 0.5 * float(light_map.resolution) / h[3]
    return wp.vec2(
        half * wp.abs(wp.dot(row_x, right) - wp.dot(row_w, right) * h[0] / h[3]),
        half * wp.abs(wp.dot(row_y, up) - wp.dot(row_w, up) * h[1] / h[3]),
    )


@wp.func
def plane_of_receiver(light_map: LightMap, layer: int, position_ws: wp.vec3, normal_ws: wp.vec3):
    """The receiver's plane as depth over texel offsets: rows (depth / w) and (1 / w) as affine functions of the offset.

    On a plane p + s e1 + t e2 the light-space (x, y, w) are linear in (s, t, 1), so 1/w and depth/w are affine in
    screen position under *any* projection, warped ones included. A plane seen edge-on from the light yields a constant
    depth.
    """
    helper = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal_ws[0]) > 0.6:
        helper = wp.vec3(0.0, 1.0, 0.0)
    e1 = wp.normalize(wp.cross(helper, normal_ws))
    e2 = wp.cross(normal_ws, e1)
    m = light_map.ws_to_ls[layer]
    h = m * wp.vec4(position_ws[0], position_ws[1], position_ws[2], 1.0)
    h1 = m * wp.vec4(e1[0], e1[1], e1[2], 0.0)
    h2 = m * wp.vec4(e2[0], e2[1], e2[2], 0.0)
    x = h[0] / h[3]
    y = h[1] / h[3]
    # screen position relative to the receiver's own, so that the solve is centred and keeps its precision
    d1 = wp.vec2(h1[0] - x * h1[3], h1[1] - y * h1[3])
    d2 = wp.vec2(h2[0] - x * h2[3], h2[1] - y * h2[3])
    det = d1[0] * d2[1] - d1[1] * d2[0]
    size = wp.length(d1) * wp.length(d2)
    depth_row = wp.vec3(0.0, 0.0, h[2])
    scale_row = wp.vec3(0.0, 0.0, 1.0)
    if wp.abs(det) > 1.0e-5 * size:
        # With S = s/w and T = t/w the ndc offset is S d1 + T d2, so S and T are linear in the offset o [texels, rows
        # down]
        step = 2.0 / (float(light_map.resolution) * det)
        s_o = wp.vec2(d2[1], d2[0]) * step
        t_o = wp.vec2(-d1[1], -d1[0]) * step
        scale = -(s_o * h1[3] + t_o * h2[3])  # w0 / w - 1
        rise = (s_o * h1[2] + t_o * h2[2]) * h[3] + scale * h[2]  # w0 depth / w - depth0
        scale_row = wp.vec3(scale[0], scale[1], 1.0)
        depth_row = wp.vec3(rise[0], rise[1], h[2])
    return depth_row, scale_row


@wp.func
def locate_receiver(light_map: LightMap, bias: Bias, position_ws: wp.vec3, normal_ws: wp.vec3):
    """Finds a receiver point in a map and prepares its comparisons.

    Bias (Schwaerzler 2009, section 2.3.1; Stingl 2011, section 2.2.1). One texel on a plane spans a depth of half its
    size times the plane's slope to either side, so ``slope`` subtracts ``bias.slope`` times (|dz/dx| + |dz/dy|) / 2
    [per texel]; ``constant`` subtracts ``bias.constant`` texel footprints; ``normal`` moves the point that many
    footprints along its normal. Taps off the point are compared with the receiver's plane where the bias knows it
    (``slope``), else with the point's depth.
    """
    result = Receiver()
    here = locate(light_map, position_ws)
    result.layer = int(here[3])
    result.visible = 1.0  # outside the map is lit
    if result.layer < 0:
        return result
    density = texels_per_length(light_map, result.layer, position_ws)
    footprint = 1.0 / wp.max(wp.min(density[0], density[1]), 1.0e-30)
    if bias.kind == BIAS_NORMAL:
        moved = locate(light_map, position_ws + normal_ws * (bias.constant * footprint))
        if int(moved[3]) == result.layer:
            here = moved
    result.x = here[0]
    result.y = here[1]
    result.depth = here[2]
    result.plane_depth = wp.vec3(0.0, 0.0, here[2])
    result.plane_scale = wp.vec3(0.0, 0.0, 1.0)
    if bias.kind != BIAS_NONE:
        result.bias = ROUNDING * here[2]
    if bias.kind == BIAS_CONSTANT:
        result.bias += bias.constant * footprint
    if bias.kind == BIAS_SLOPE:
        depth_row, scale_row = plane_of_receiver(light_map, result.layer, position_ws, normal_ws)
        result.plane_depth = depth_row
        result.plane_scale = scale_row
        slope_x = depth_row[0] - here[2] * scale_row[0]
        slope_y = depth_row[1] - here[2] * scale_row[1]
        result.bias += bias.slope * 0.5 * (wp.abs(slope_x) + wp.abs(slope_y))
    result.depth -= result.bias
    return result


@wp.func
def stored_depth(light_map: LightMap, layer: int, column: int, row: int):
    """Depth in a texel, +inf outside the map; the sign tag of moving casters is kept."""
    result = float(wp.inf)
    if column >= 0 and row >= 0 and column < light_map.resolution and row < light_map.resolution:
        result = light_map.depth[to_texel(light_map, layer, column, row)]
    return result


@wp.func
def receiver_depth_at(receiver: Receiver, dx: float, dy: float):
    """Biased depth of the receiver's plane at an offset [texels]; +inf where the plane has no point there."""
    scale = receiver.plane_scale[0] * dx + receiver.plane_scale[1] * dy + 1.0
    result = float(wp.inf)
    if scale > 0.0:
        rise = receiver.plane_depth[0] * dx + receiver.plane_depth[1] * dy + receiver.plane_depth[2]
        result = rise / scale - receiver.bias
    return result


@wp.func
def compare_texel(light_map: LightMap, receiver: Receiver, column: int, row: int):
    """1 where the receiver is lit as seen by one texel, 0 where the texel's caster is nearer to the light."""
    depth = receiver_depth_at(receiver, float(column) + 0.5 - receiver.x, float(row) + 0.5 - receiver.y)
    return wp.where(depth <= wp.abs(stored_depth(light_map, receiver.layer, column, row)), 1.0, 0.0)


@wp.func
def compare_nearest(light_map: LightMap, receiver: Receiver):
    """The hard shadow test: the point's own depth against the texel it falls into."""
    stored = stored_depth(light_map, receiver.layer, int(wp.floor(receiver.x)), int(wp.floor(receiver.y)))
    return wp.where(receiver.depth <= wp.abs(stored), 1.0, 0.0)


@wp.func
def compare_bilinear(light_map: LightMap, receiver: Receiver, dx: float, dy: float):
    """Bilinear mean of the four comparisons around the receiver moved by (dx, dy) texels: one hardware PCF tap."""
    x = receiver.x + dx - 0.5
    y = receiver.y + dy - 0.5
    column = int(wp.floor(x))
    row = int(wp.floor(y))
    fx = x - float(column)
    fy = y - float(row)
    upper = wp.lerp(
        compare_texel(light_map, receiver, column, row), compare_texel(light_map, receiver, column + 1, row), fx
    )
    lower = wp.lerp(
        compare_texel(light_map, receiver, column, row + 1), compare_texel(light_map, receiver, column + 1, row + 1), fx
    )
    return wp.lerp(upper, lower, fy)

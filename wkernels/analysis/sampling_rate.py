"""How finely a light depth map samples what the eye sees, pixel by pixel: err_accurate and sampling frequency.

Both come from one matrix, J, the derivative of the position in the map [texels] by that on the screen [pixels] along
the receiver's plane. err_accurate (Stingl 2011, equation 2.2; Lloyd 2007) is the length of a texel over that of a pixel
in one direction on the surface, above 1 where the map is too coarse; its largest value over all directions is one over
J's least singular value. The sampling frequency (Stingl 2011, section 5.7 and listing A.3) counts texels per pixel,
below 1 where the map is too coarse: the area ratio |det J| and the lengths of J's rows, for the map's x and y. (Figure
5.6 there calls it "screen pixel to texel ratio", which is the inverse of what the listing computes.)

The kernel works in float64: under a strong warp a texel's size is a difference of nearly equal numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.spatial import ConvexHull, QhullError

from wkernels.frame.session import Session
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import LightMap, to_layer
from wkernels.projections.clipping import ConvexBody, clip_polyhedron, frustum_planes
from wkernels.projections.focusing import seen_body
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.views import HostView

LEAST_COSINE = wp.constant(1.0e-6)
"""Between a surface and the plane of a beam: float32 normals cannot tell smaller ones from 0. Keeps errors finite."""


@dataclass(frozen=True, eq=False)
class SamplingRate:
    """What ``sampling_rate`` measures; arrays of shape (H, W), floats NaN where no layer of the map holds the surface.

    Attributes:
        m: Largest err_accurate over all directions on the surface, texel over pixel, float32, above 0 and finite.
        m_x, m_z: err_accurate across view and light, and along the view across the light, of a surface that faces the
            light: perspective aliasing alone, as ``light_views.perspective_aliasing`` has it on the view vector.
        det: Texels per pixel by area, |det J|.
        x, y: Texels per pixel along the map's axes: rows of J.
        layer: Layer of the map, int32; -1 where none holds the surface.
        texel: Number of the texel that the surface falls into, counted through rows and layers, int32; -1 where no
            technique looks: nothing receives, no layer, or the surface itself hides the light.
    """

    m: np.ndarray
    m_x: np.ndarray
    m_z: np.ndarray
    det: np.ndarray
    x: np.ndarray
    y: np.ndarray
    layer: np.ndarray
    texel: np.ndarray

    @property
    def is_read(self) -> np.ndarray:
        """Where a technique looks into the map, bool (H, W)."""
        return self.texel >= 0


@wp.func
def widened(v: wp.vec3):
    """In float64."""
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def row_of(m: wp.mat44, i: int):
    """The first three columns of a row."""
    return wp.vec3d(wp.float64(m[i, 0]), wp.float64(m[i, 1]), wp.float64(m[i, 2]))


@wp.func
def cross_2d(a: wp.vec2d, b: wp.vec2d):
    """Signed area that two vectors span."""
    return a[0] * b[1] - a[1] * b[0]


@wp.kernel
def measure_sampling(
    first: int,
    gbuffer: GBuffer,
    light_map: LightMap,
    error_out: wp.array2d(dtype=wp.vec3),
    frequency_out: wp.array2d(dtype=wp.vec3),
    layer_out: wp.array2d(dtype=int),
    texel_out: wp.array2d(dtype=int),
):
    """(m, m_x, m_z), (det, x, y), layer and texel of every pixel; see ``SamplingRate``."""
    row, column = wp.tid()
    i = first + row
    error_out[i, column] = wp.vec3(wp.nan)
    frequency_out[i, column] = wp.vec3(wp.nan)
    layer_out[i, column] = -1
    texel_out[i, column] = -1
    if gbuffer.mesh[i, column] < 0:
        return
    position_ws = gbuffer.position_ws[i, column]
    layer = to_layer(light_map, position_ws)
    if layer < 0:
        return
    layer_out[i, column] = layer

    # the map's gradient: rows of G are the derivatives of texel positions, right and up, by world position
    rows = light_map.ws_to_ls[layer]
    p = widened(position_ws)
    row_w = row_of(rows, 3)
    w = wp.dot(row_w, p) + wp.float64(rows[3, 3])
    at_x = (wp.dot(row_of(rows, 0), p) + wp.float64(rows[0, 3])) / w
    at_y = (wp.dot(row_of(rows, 1), p) + wp.float64(rows[1, 3])) / w
    half = wp.float64(0.5) * wp.float64(light_map.resolution) / w
    grad_x = half * (row_of(rows, 0) - at_x * row_w)
    grad_y = half * (row_of(rows, 1) - at_y * row_w)

    # the surface point of a pixel's ray moves by d_x - along (n . d_x) / (n . along) per pixel
    view = gbuffer.view
    x = wp.float64(column) + wp.float64(0.5)
    y = wp.float64(i) + wp.float64(0.5)
    z = wp.float64(gbuffer.depth[i, column])
    n = widened(gbuffer.normal_ws[i, column])
    along = widened(view.along_ws) + x * widened(view.along_dx_ws) + y * widened(view.along_dy_ws)
    d_x = widened(view.base_dx_ws) + z * widened(view.along_dx_ws)
    d_y = widened(view.base_dy_ws) + z * widened(view.along_dy_ws)
    least = wp.float64(LEAST_COSINE)
    facing = wp.dot(n, along)
    facing = wp.where(facing < wp.float64(0.0), -wp.float64(1.0), wp.float64(1.0)) * wp.max(
        wp.abs(facing), least * wp.length(along)
    )
    moves_x = d_x - along * (wp.dot(n, d_x) / facing)
    moves_y = d_y - along * (wp.dot(n, d_y) / facing)
    j_x = wp.vec2d(wp.dot(grad_x, moves_x), wp.dot(grad_x, moves_y))
    j_y = wp.vec2d(wp.dot(grad_y, moves_x), wp.dot(grad_y, moves_y))

    # det J without the difference of nearly equal products that it is on surfaces edge-on to eye or light: ``beam``
    # spans the null space of G, so that it runs along the light's beam, and det J is n . beam / n . along
    g_along = wp.vec2d(wp.dot(grad_x, along), wp.dot(grad_y, along))
    g_x = wp.vec2d(wp.dot(grad_x, d_x), wp.dot(grad_y, d_x))
    g_y = wp.vec2d(wp.dot(grad_x, d_y), wp.dot(grad_y, d_y))
    beam = along * cross_2d(g_x, g_y) + d_y * cross_2d(g_along, g_x) + d_x * cross_2d(g_y, g_along)
    det = wp.max(wp.abs(wp.dot(n, beam)), least * wp.length(beam)) / wp.abs(facing)
    squares = wp.max(wp.dot(j_x, j_x) + wp.dot(j_y, j_y), wp.float64(2.0) * det)
    root = wp.sqrt((squares - wp.float64(2.0) * det) * (squares + wp.float64(2.0) * det))
    largest = wp.sqrt(wp.float64(0.5) * (squares + root))  # singular value

    # the same for a surface that faces the light, along the two axes of perspective aliasing
    forward = row_of(view.ws_to_ss, 2)
    light = widened(to_light(light_map.light_ws, position_ws))
    light = light / wp.max(wp.length(light), wp.float64(1.0e-30))
    ahead = forward - wp.dot(light, forward) * light
    if wp.length(ahead) > wp.float64(1.0e-6):
        ahead = wp.normalize(ahead)
    else:
        ahead = -wp.normalize(d_y)
    across = wp.cross(light, ahead)
    pixel = wp.length(d_y)
    along_x = wp.length(wp.vec2d(wp.dot(grad_x, across), wp.dot(grad_y, across)))
    along_z = wp.length(wp.vec2d(wp.dot(grad_x, ahead), wp.dot(grad_y, ahead)))

    error_out[i, column] = wp.vec3(
        float(largest / det), float(wp.float64(1.0) / (along_x * pixel)), float(wp.float64(1.0) / (along_z * pixel))
    )
    frequency_out[i, column] = wp.vec3(float(det), float(wp.length(j_x)), float(wp.length(j_y)))
    receives = (gbuffer.flags[i, column] & RECEIVES) != 0
    if receives and not is_back_lit(gbuffer, i, column, to_light(light_map.light_ws, position_ws)):
        size = light_map.resolution
        to_texels = wp.float64(0.5) * wp.float64(size)
        texel_x = wp.clamp(int(wp.floor((wp.float64(1.0) + at_x) * to_texels)), 0, size - 1)
        texel_y = wp.clamp(int(wp.floor((wp.float64(1.0) - at_y) * to_texels)), 0, size - 1)
        texel_out[i, column] = (layer * size + texel_y) * size + texel_x


def sampling_rate(session: Session, light_map: LightMap, gbuffer: GBuffer) -> SamplingRate:
    """Measures a map at every pixel of a G-buffer, whatever projection it was drawn with.

    Args:
        session: Lends its device, threads and memory.
        light_map: The map; its depths are not looked at.
        gbuffer: What the eye sees.
    """
    shape = gbuffer.depth.shape
    error = session.buffer("sampling error", shape, wp.vec3)
    frequency = session.buffer("sampling frequency", shape, wp.vec3)
    layer = session.buffer("sampling layer", shape, wp.int32)
    texel = session.buffer("sampling texel", shape, wp.int32)
    session.launch(measure_sampling, shape, [gbuffer, light_map], [error, frequency, layer, texel])
    m, m_x, m_z = (np.ascontiguousarray(part) for part in np.moveaxis(error.numpy(), 2, 0))
    det, x, y = (np.ascontiguousarray(part) for part in np.moveaxis(frequency.numpy(), 2, 0))
    return SamplingRate(m, m_x, m_z, det, x, y, layer.numpy().copy(), texel.numpy().copy())


def unread_share(rate: SamplingRate, light_map: LightMap) -> float:
    """Share of all texels of a map that no pixel falls into, 0 to 1. It grows with the map and falls with the image."""
    read = np.zeros(light_map.layers * light_map.resolution**2, dtype=bool)
    read[rate.texel[rate.is_read]] = True
    return 1.0 - float(np.count_nonzero(read)) / len(read)


def wasted_shares(views: Sequence[HostView], body: ConvexBody) -> list[float]:
    """Share of each layer's area that lies outside of what it is there for (Stingl 2011, section 7.5), 0 to 1.

    Args:
        views: One per layer.
        body: What the eye can see of the receivers, H (``focusing.seen_body``). Everything that may cast a shadow into
            it, B, has the same extent in a map. Layers that are chosen by depth are there for their split's part.
    """
    shares, begin = [], -np.inf
    for view in views:
        planes = [frustum_planes(view.ws_to_ss, view.near, view.far)]
        choice = getattr(view, "choice", None)
        if choice is not None and choice.rule == "depth":
            row, offset = np.array(choice.eye_row), np.array([0.0, 0.0, 0.0, 1.0])
            if np.isfinite(begin):
                planes.append((row - begin * offset)[None])
            if np.isfinite(choice.far):
                planes.append((choice.far * offset - row)[None])
            begin = choice.far
        held = clip_polyhedron(body, np.concatenate(planes))
        shares.append(1.0 - min(_mapped_area(view, held) / 4.0, 1.0))
    return shares


def _mapped_area(view: HostView, body: ConvexBody) -> float:
    """Area of a body's outline in a view; 4 is the whole view."""
    if body.is_empty:
        return 0.0
    h = body.vertices @ view.ws_to_ss[:, :3].T + view.ws_to_ss[:, 3]
    try:
        return float(ConvexHull(h[:, :2] / h[:, 3:]).volume)
    except QhullError:  # a line
        return 0.0


@dataclass(frozen=True, eq=False)
class MapUse:
    """How the map that a frame's technique read suits that frame.

    Attributes:
        rate: Per pixel of the frame.
        waste: Mean over layers of ``wasted_shares``.
        unread: ``unread_share``.
    """

    rate: SamplingRate
    waste: float
    unread: float


def map_use(session: Session) -> MapUse | None:
    """Measures the map of the frame that ``session`` rendered last; None if it read none. Is not part of the frame."""
    read = session.shown
    if not isinstance(read, HostMap):
        return None
    rate = sampling_rate(session, read.map, session.gbuffer())
    receivers = session.geometry.bounds(receivers=True)
    waste = 1.0
    if not receivers.empty:
        eye = session.near_plane.used or session.eye()
        waste = float(np.mean(wasted_shares(read.views, seen_body(receivers, eye))))
    return MapUse(rate, waste, unread_share(rate, read.map))

"""Small maps of the casters that move, one for each of several points of a light, drawn at once in every frame.

A map of its own costs what its launches cost, however little it shows. Here the moving triangles are copied, once for
each point of the light, each copy projected into its own square of one image, and that image is drawn in one go. A
view that looks from a light's point at the box round the movers holds all of them and every point that they may hide.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.projections.light_views import scene_views
from wkernels.raster import Rasteriser
from wkernels.scene.cutouts import cut_triangles
from wkernels.scene.geometry import Bounds
from wkernels.scene.lights import orthonormal_frame
from wkernels.scene.views import HostView, View
from wkernels.temporal.map_pool.drawing import PoolPainter, store_layers
from wkernels.temporal.map_pool.pool import CONSTANTS, MapPool, allocate_pool, layer_constants

MAX_SIDE = 8192  # of an image
CLOSEST = 0.05  # a light nearer to the box than this share of its farthest corner's depth has no one view of it
MARGIN = 2.0  # texels round the movers


def box_axes(light_ws: np.ndarray, corners: np.ndarray) -> np.ndarray | None:
    """Right, up and forward, rows of (3, 3), of a view from a point of a light at the middle of a box; None within it.

    Args:
        light_ws: (4,), rebased world, a point or a direction. corners: (N, 3).
    """
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    forward = middle - light_ws[:3] if light_ws[3] != 0.0 else -light_ws[:3]
    length = float(np.linalg.norm(forward))
    if length == 0.0:
        return None
    right, up = orthonormal_frame(-forward / length)
    return np.stack([right, up, forward / length])


def box_view(light_ws: np.ndarray, corners: np.ndarray, axes: np.ndarray | None, resolution: int) -> HostView | None:
    """The view of a box from a point of a light, with ``MARGIN`` texels round it; None where no one view holds it.

    Args:
        light_ws: (4,), rebased world, a point or a direction. corners: (N, 3).
        axes: As of ``box_axes``, of this or, for points, of any other point of the light. resolution: Texels per side.
    """
    if axes is None:
        return None
    right, up, forward = axes
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    is_point = light_ws[3] != 0.0
    offsets = corners - (light_ws[:3] if is_point else middle)
    x, y, depth = offsets @ right, offsets @ up, offsets @ forward
    low, high = float(depth.min()), float(depth.max())
    eye = light_ws[:3]
    if is_point:
        if low <= CLOSEST * high:
            return None
        x, y = x / depth, y / depth
    else:
        span = max(high - low, 1e-6)
        eye, low, high = middle + (low - 0.01 * span) * forward, 0.0, 1.02 * span
    half = 0.5 * np.array([np.ptp(x), np.ptp(y)])
    half = np.maximum(half, 1e-6 + 1e-3 * half.max()) * resolution / max(resolution - 2.0 * MARGIN, 0.5 * resolution)
    window = (x.min() + x.max()) / 2.0 + np.array([-1.0, 1.0]) * half[0]
    across = (y.min() + y.max()) / 2.0 + np.array([-1.0, 1.0]) * half[1]
    sides = (*window, *across)
    return HostView(eye, right, up, forward, sides, low, high, resolution, resolution, perspective=is_point)


@wp.kernel
def copy_into_squares(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    constants: wp.array2d(dtype=float),
    nearest: wp.array(dtype=float),
    columns: int,
    resolution: int,
    points_out: wp.array(dtype=wp.vec3),
):
    """Vertices of each copy: x and y in pixels of the image, and a key of depth that is affine on the screen.

    Args:
        first: Tile offset. points_ws: (V,). constants: Of the pool's layers, one a copy. nearest: (copies,) least
            depth of the box, for the key 1 - z0 / z of a perspective view; 0 for parallel ones, whose key is the depth.
        columns: Squares in a row of the image. resolution: Pixels along a square. points_out: (copies V,).
    """
    i, copy = wp.tid()
    v = first + i
    p = points_ws[v]
    c = constants
    x = c[copy, 0] * p[0] + c[copy, 1] * p[1] + c[copy, 2] * p[2] + c[copy, 3]
    y = c[copy, 4] * p[0] + c[copy, 5] * p[1] + c[copy, 6] * p[2] + c[copy, 7]
    z = c[copy, 8] * p[0] + c[copy, 9] * p[1] + c[copy, 10] * p[2] + c[copy, 11]
    w = c[copy, 12] * p[0] + c[copy, 13] * p[1] + c[copy, 14] * p[2] + c[copy, 15]
    size = float(resolution)
    key = z
    if nearest[copy] > 0.0:
        key = 1.0 - nearest[copy] / z
    left = float((copy % columns) * resolution)
    top = float((copy // columns) * resolution)
    points_out[copy * points_ws.shape[0] + v] = wp.vec3(
        left + (0.5 + 0.5 * x / w) * size, top + (0.5 - 0.5 * y / w) * size, key
    )


class MoverMaps:
    """A pool of maps of the movers.

    Args:
        frame: The session. maps: How many at most. resolution: Texels per side of each.
    """

    def __init__(self, frame: Session, maps: int, resolution: int) -> None:
        self.device, self.threads, self.resolution = frame.device, frame.threads, resolution
        self.resting = frame.geometry.resting  # with it the movers change
        self.casters = frame.geometry.caster_buffers(moving=True)
        self.points, self.indices, cutouts = self.casters
        self._cut = bool(cut_triangles(self.indices, cutouts).any())
        self.pool = allocate_pool(maps, 1, resolution, frame.device)
        self._rasteriser = Rasteriser(frame.device, frame.threads)
        self._columns = max(1, min(int(np.ceil(maps**0.5)), MAX_SIDE // resolution))
        self._copied: tuple[int, wp.array, wp.array, wp.array] | None = None

    def draw(self, points_of_light: np.ndarray, box: Bounds, cull: int) -> MapPool:
        """Draws a map for each point of the light, (N, 4); ``box`` holds the movers. Returns the pool."""
        count = len(points_of_light)
        rows = -(-count // self._columns)
        corners = box.corners
        axes = box_axes(points_of_light[0], corners)
        views = []
        for light in points_of_light:
            own = axes if light[3] != 0.0 else box_axes(light, corners)
            views.append(box_view(light, corners, own, self.resolution))
        held = [view for view in views if view is not None]
        if len(held) < count or rows * self.resolution > MAX_SIDE or self._cut:  # copies have no texture coordinates
            return self._draw_apart(points_of_light, box, cull)
        if self.pool.slots != 1:
            self.pool = allocate_pool(len(self.pool.layers), 1, self.resolution, self.device)
        constants = np.stack([layer_constants(view) for view in held])
        wp.copy(self.pool.constants, wp.array(constants, dtype=float, device="cpu"), count=count * CONSTANTS)
        wp.copy(
            self.pool.light_ws, wp.array(points_of_light.astype(np.float32), dtype=wp.vec4, device="cpu"), count=count
        )
        self.pool.layers.fill_(1)
        points, indices, image = self._copies(count, rows)
        near = np.array([view.near if view.perspective else 0.0 for view in held], dtype=np.float32)
        nearest = wp.array(near, dtype=float, device=self.device)
        inputs = [self.points, self.pool.constants, nearest, self._columns, self.resolution]
        grid = (len(self.points), count)
        launch(copy_into_squares, grid, inputs, [points], device=self.device, threads=self.threads)
        shown = _image_view(image.shape[1], image.shape[0], max(view.far for view in held))
        self._rasteriser.draw(points, indices, shown, image, None, cull)
        store_layers(image, self._columns, nearest, 0, self.pool, self.threads)
        return self.pool

    def _draw_apart(self, points_of_light: np.ndarray, box: Bounds, cull: int) -> MapPool:
        """One map after the other, with as many layers as it takes: a light is close to the movers, or some are cut."""
        views = [scene_views(light, box, box, self.resolution) for light in points_of_light]
        layers = max(len(own) for own in views)
        if self.pool.slots < layers:
            self.pool = allocate_pool(len(self.pool.layers), layers, self.resolution, self.device)
        painter = PoolPainter(self.casters, self.resolution, self.device, self.threads, culls=False)
        for i, own in enumerate(views):
            painter.draw(self.pool, i, own, points_of_light[i], 1.0, cull)
        return self.pool

    def _copies(self, count: int, rows: int) -> tuple[wp.array, wp.array, wp.array]:
        """Memory for so many copies: their vertices, their indices and the image."""
        if self._copied is None or self._copied[0] != count:
            one = self.indices.numpy()
            every = (one[None, :] + len(self.points) * np.arange(count, dtype=np.int32)[:, None]).ravel()
            indices = wp.array(every, dtype=wp.int32, device=self.device)
            points = wp.empty(count * len(self.points), dtype=wp.vec3, device=self.device)
            shape = (rows * self.resolution, self._columns * self.resolution)
            self._copied = count, points, indices, wp.empty(shape, dtype=float, device=self.device)
        return self._copied[1:]


def _image_view(width: int, height: int, far: float) -> View:
    """The view whose world is the image: x right and y down in pixels, z is a key of depth, up to ``far`` or 1."""
    out = View()
    rows = np.diag([2.0 / width, -2.0 / height, 1.0, 1.0])
    rows[:2, 3] = -1.0, 1.0
    out.ws_to_ss = wp.mat44(*rows.astype(np.float32).ravel())
    out.near, out.far, out.width, out.height = -1.0, max(far, 1.0), width, height
    return out

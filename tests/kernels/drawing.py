"""What the rasteriser's tests share: drawing to images, integer coverage in NumPy, rays in float64."""

from __future__ import annotations

import numpy as np
import small_scenes
import warp as wp

from wkernels.projections.light_views import scene_views
from wkernels.raster import CULL_NONE, Rasteriser
from wkernels.scene.geometry import Bounds
from wkernels.scene.views import HostView, View

SUB = 256  # positions within a pixel that vertices snap to


def flat_view(width: int, height: int, far: float = 100.0) -> HostView:
    """World (x, y, -depth) = pixel (x, -y): an orthographic view in which a vertex's pixel position is read off."""
    eye, right, up, forward = np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, -1.0])
    return HostView(eye, right, up, forward, (0.0, width, -height, 0.0), 0.0, far, width, height, perspective=False)


def from_pixels(x: np.ndarray, y: np.ndarray, depth: np.ndarray | float) -> np.ndarray:
    """World positions for ``flat_view``."""
    return np.stack([x, -np.asarray(y), -np.broadcast_to(depth, np.shape(x))], axis=-1).astype(float)


def draw(
    points: np.ndarray,
    faces: np.ndarray,
    view: HostView | View,
    device: str,
    *,
    cull: int = CULL_NONE,
    threads: int | None = 2,
    rasteriser: Rasteriser | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and triangle images (H, W)."""
    rasteriser = rasteriser or Rasteriser(device, threads)
    depth = wp.empty((view.height, view.width), dtype=float, device=device)
    triangle = wp.empty((view.height, view.width), dtype=int, device=device)
    rasteriser.draw(
        wp.array(points.astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device),
        view.to_device() if isinstance(view, HostView) else view,
        depth,
        triangle,
        cull,
    )
    return depth.numpy(), triangle.numpy()


def pixel_owner_counts(points: np.ndarray, faces: np.ndarray, view: HostView, device: str) -> np.ndarray:
    """How many triangles, each drawn alone, cover a pixel."""
    counts = np.zeros((view.height, view.width), int)
    rasteriser = Rasteriser(device, 1)
    for face in faces:
        counts += np.isfinite(draw(points, face[None], view, device, rasteriser=rasteriser)[0])
    return counts


def twin_coverage(subpixel: np.ndarray, width: int, height: int) -> np.ndarray:
    """Whether a triangle covers each pixel centre: integers, and a centre moved by an infinitesimal right and less down.

    That move is the top-left rule: it carries a centre on a left or top edge into the triangle and one on a right or
    bottom edge out of it.
    """
    a, b, c = (np.array(v, dtype=object) for v in subpixel.tolist())
    if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0:
        b, c = c, b
    px = (np.arange(width, dtype=np.int64) * SUB + SUB // 2)[None, :]
    py = (np.arange(height, dtype=np.int64) * SUB + SUB // 2)[:, None]
    inside = np.ones((height, width), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        dx, dy = int(q[0] - p[0]), int(q[1] - p[1])
        side = dx * (py - int(p[1])) - dy * (px - int(p[0]))
        first_move, second_move = -dy, dx
        inside &= (side > 0) | ((side == 0) & ((first_move > 0) | ((first_move == 0) & (second_move > 0))))
    return inside


def twin_draw(points: np.ndarray, faces: np.ndarray, view: HostView) -> tuple[np.ndarray, np.ndarray]:
    """What ``draw`` makes of vertices on the 1/256-pixel grid of a ``flat_view``: depth (float64) and triangle."""
    depth = np.full((view.height, view.width), np.inf)
    owner = np.full((view.height, view.width), -1)
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    for t, face in enumerate(faces):
        corners = points[face] * np.array([1.0, -1.0, -1.0])
        subpixel = np.rint(corners[:, :2] * SUB).astype(np.int64)
        (ax, ay), (bx, by), (cx, cy) = subpixel.tolist()
        if (bx - ax) * (cy - ay) == (by - ay) * (cx - ax):
            continue
        weights = np.linalg.solve(
            np.vstack([corners[:, :2].T, np.ones(3)]), np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        )
        here = (corners[:, 2] @ weights).reshape(x.shape)
        nearer = twin_coverage(subpixel, view.width, view.height) & (here < depth) & (here <= view.far)
        depth[nearer], owner[nearer] = here[nearer], t
    return depth, owner


def grid(
    rng: np.random.Generator, columns: int, rows: int, low: float, high: float, jitter: float
) -> small_scenes.Triangles:
    """A jittered grid in pixels (x, y), larger than the screen, with diagonals in both directions."""
    x, y = np.meshgrid(np.linspace(low, high, columns + 1), np.linspace(low, high, rows + 1))
    step = np.array([(high - low) / columns, (high - low) / rows])
    points = np.stack([x.ravel(), y.ravel()], axis=1) + jitter * step * rng.uniform(-0.5, 0.5, (x.size, 2))
    faces = small_scenes.grid_faces(columns, rows).reshape(2, -1, 3)
    corner, right, below, opposite = faces[0][:, 0], faces[0][:, 2], faces[0][:, 1], faces[1][:, 2]
    turned = rng.random(len(corner)) < 0.5
    first = np.where(turned[:, None], np.stack([corner, below, opposite], 1), np.stack([corner, below, right], 1))
    second = np.where(turned[:, None], np.stack([corner, opposite, right], 1), np.stack([right, below, opposite], 1))
    return points, np.concatenate([first, second])


def pixel_rays(view: HostView, dx: float = 0.0, dy: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (scaled to linear depth) of the rays of all pixel centres, moved by (dx, dy) pixels."""
    left, right, bottom, top = view.window
    x, y = np.meshgrid(np.arange(view.width) + 0.5 + dx, np.arange(view.height) + 0.5 + dy)
    across = (left + (right - left) * x.ravel() / view.width)[:, None] * view.right_ws
    across = across + (top + (bottom - top) * y.ravel() / view.height)[:, None] * view.up_ws
    if view.perspective:
        return np.broadcast_to(view.eye_ws, across.shape), across + view.forward_ws
    return view.eye_ws + across, np.broadcast_to(view.forward_ws, across.shape)


def nearest_hits(
    view: HostView, corners: np.ndarray, dx: float = 0.0, dy: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the nearest hit within [near, far], +inf where there is none, and its triangle; (H, W)."""
    t, _ = small_scenes.ray_hits(*pixel_rays(view, dx, dy), corners)
    t = np.where((t >= view.near) & (t <= view.far), t, np.inf)
    owner = np.where(np.isfinite(t).any(axis=1), t.argmin(axis=1), -1)
    return t.min(axis=1).reshape(view.height, view.width), owner.reshape(view.height, view.width)


def assert_depth_equals_rays(
    points: np.ndarray, faces: np.ndarray, view: HostView, device: str, min_hit: float = 0.2
) -> None:
    """Where rays moved by a little more than the snapping agree on the triangle, so must the rasteriser, to that little."""
    points = points.astype(np.float32).astype(float)
    corners = points[faces]
    want_depth, want_owner = nearest_hits(view, corners)
    lowest, highest, sure = want_depth.copy(), want_depth.copy(), np.ones(want_depth.shape, bool)
    step = 2.0 / SUB
    for dx, dy in ((-step, -step), (step, -step), (-step, step), (step, step)):
        depth, owner = nearest_hits(view, corners, dx, dy)
        sure &= owner == want_owner
        lowest, highest = np.minimum(lowest, depth), np.maximum(highest, depth)
    depth, owner = draw(points, faces, view, device)
    assert sure.mean() > 0.6
    assert (want_owner[sure] >= 0).mean() >= min_hit
    np.testing.assert_array_equal(owner[sure], want_owner[sure])
    hit = sure & (want_owner >= 0)
    slack = 1e-5 * want_depth[hit]
    assert (depth[hit] >= lowest[hit] - slack).all() and (depth[hit] <= highest[hit] + slack).all()


# ---- inputs -----------------------------------------------------------------------------------------------------------


FORWARD, RIGHT, UP = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def view_of(perspective: bool, width: int, height: int, near: float = 0.5, far: float = 60.0) -> HostView:
    half = 1.0 if perspective else 12.0
    tall = half * height / width
    return HostView(np.zeros(3), RIGHT, UP, FORWARD, (-half, half, -tall, tall), near, far, width, height, perspective)


def triangle_soup(rng: np.random.Generator, count: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of about ``size`` all around the eye, many across the near plane or far outside of the view."""
    middle = rng.uniform((-20, -20, -70), (20, 20, 5), (count, 1, 3))
    return (middle + rng.normal(0.0, size, (count, 3, 3))).reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def on_device(points: np.ndarray, faces: np.ndarray, device: str) -> tuple[wp.array, wp.array]:
    return (
        wp.array(points.astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device),
    )


def scene_box() -> Bounds:
    out = Bounds()
    out.add(np.array([(-4.0, -4.0, -4.0), (4.0, 4.0, 4.0)]))
    return out


def cube_faces(resolution: int) -> list[HostView]:
    """Six faces from a point inside of the scene."""
    box = scene_box()
    views = scene_views(np.array([0.3, 0.2, 0.1, 1.0]), box, box, resolution)
    assert len(views) == 6
    return views


def sun_samples(count: int, resolution: int) -> list[HostView]:
    """One orthographic view per sample of a wide sun."""
    rng = np.random.default_rng(count)
    box = scene_box()
    towards = np.array([0.2, 1.0, 0.3]) + rng.uniform(-0.2, 0.2, (count, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return [scene_views(np.append(way, 0.0), box, box, resolution)[0] for way in towards]

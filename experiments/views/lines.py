"""Lines in space, drawn over a picture that has depth: what lies behind a surface is dashed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wkernels.scene.views import HostView

SLACK = 0.004  # of the depth: a line on a surface is not hidden by it
DASH, GAP = 6.0, 5.0  # pixels of hidden lines
HALO = 0.55  # opacity of the light rim that keeps lines readable on dark ground
_REACH = 3  # pixels to either side of a line that its width may touch


def project(view: HostView, points: np.ndarray) -> np.ndarray:
    """Homogeneous (x, y, linear depth, w) of points (n, 3), rebased world."""
    rows = view.ws_to_ss
    out: np.ndarray = np.asarray(points, float) @ rows[:, :3].T + rows[:, 3]
    return out


def to_pixels(view: HostView, h: np.ndarray) -> np.ndarray:
    """Pixel positions (n, 2), column and row from the top left corner, of homogeneous ones with w > 0."""
    ndc = h[:, :2] / h[:, 3:]
    return np.column_stack([(0.5 + 0.5 * ndc[:, 0]) * view.width, (0.5 - 0.5 * ndc[:, 1]) * view.height])


def clip_segment(h_a: np.ndarray, h_b: np.ndarray, least_w: float) -> tuple[np.ndarray, np.ndarray] | None:
    """The part of a homogeneous segment with w >= ``least_w`` inside the picture; None where there is none."""
    low, high = 0.0, 1.0
    for plane in ((0, 0, 0, 1.0, -least_w), (1, 0, 0, 1, 0), (-1, 0, 0, 1, 0), (0, 1, 0, 1, 0), (0, -1, 0, 1, 0)):
        normal = np.array(plane[:4])
        d_a, d_b = float(normal @ h_a) + plane[4], float(normal @ h_b) + plane[4]
        if d_a < 0.0 and d_b < 0.0:
            return None
        if d_a < 0.0:
            low = max(low, d_a / (d_a - d_b))
        elif d_b < 0.0:
            high = min(high, d_a / (d_a - d_b))
    if low > high:
        return None
    return h_a + low * (h_b - h_a), h_a + high * (h_b - h_a)


def draw_lines(
    image: np.ndarray,
    view: HostView,
    segments: np.ndarray,
    color: Sequence[float],
    *,
    depth: np.ndarray | None = None,
    width: float = 1.5,
    hidden: float = 0.5,
    halo: bool = True,
) -> None:
    """Draws segments into a picture.

    Args:
        image: float (H, W, 3), display colours in [0, 1]; changed in place.
        view: What the picture looks through, of its size; warped light views too.
        segments: (n, 2, 3), rebased world.
        color: RGB in [0, 1].
        depth: Linear depth of the surfaces (H, W), +inf where there is none; None draws everything in front.
        width: Pixels, up to about 4.
        hidden: Opacity of what lies behind a surface, in dashes; 0 leaves it out.
        halo: Whether the visible part gets a light rim.
    """
    for a, b in np.asarray(segments, float).reshape(-1, 2, 3):
        h_a, h_b = project(view, np.stack([a, b]))
        least = 1e-4 * max(abs(float(h_a[3])), abs(float(h_b[3])), 1e-12)
        clipped = clip_segment(h_a, h_b, least)
        if clipped is not None:
            _draw_one(image, view, *clipped, np.asarray(color, float), depth, width, hidden, halo)


def _draw_one(
    image: np.ndarray,
    view: HostView,
    h_a: np.ndarray,
    h_b: np.ndarray,
    color: np.ndarray,
    depth: np.ndarray | None,
    width: float,
    hidden: float,
    halo: bool,
) -> None:
    height, columns = image.shape[:2]
    (x_a, y_a), (x_b, y_b) = to_pixels(view, np.stack([h_a, h_b]))
    way = np.array([x_b - x_a, y_b - y_a])
    length = float(np.linalg.norm(way))
    if length < 1e-6:
        return
    steep = abs(way[1]) > abs(way[0])
    start, end = sorted((y_a, y_b) if steep else (x_a, x_b))
    limit = height if steep else columns
    major = np.arange(max(int(np.floor(start)) - _REACH, 0), min(int(np.ceil(end)) + _REACH, limit))
    if not len(major):
        return
    # the line's place across its major axis at each pixel, and the pixels next to it
    base, slope = (x_a, way[0] / way[1]) if steep else (y_a, way[1] / way[0])
    across = base + (major + 0.5 - (y_a if steep else x_a)) * slope
    minor = np.floor(across)[:, None].astype(int) + np.arange(-_REACH, _REACH + 1)
    rows, cols = (np.broadcast_to(major[:, None], minor.shape), minor)
    rows, cols = (rows, cols) if steep else (cols, rows)
    inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < columns)
    rows, cols = rows[inside], cols[inside]
    offset = np.column_stack([cols + 0.5 - x_a, rows + 0.5 - y_a])
    along = np.clip(offset @ way / length**2, 0.0, 1.0)
    distance = np.linalg.norm(offset - along[:, None] * way, axis=1)
    alpha = np.clip(0.5 * width + 0.5 - distance, 0.0, 1.0)
    rim = np.clip(0.5 * width + 1.5 - distance, 0.0, 1.0) * HALO * halo
    if depth is not None:
        # what is linear in the world is linear in (1 / w) on the screen
        t = along * h_a[3] / (along * h_a[3] + (1.0 - along) * h_b[3])
        own = h_a[2] + t * (h_b[2] - h_a[2])
        covered = own > depth[rows, cols] + SLACK * np.abs(own)
        dashes = (along * length) % (DASH + GAP) < DASH
        alpha = np.where(covered, alpha * hidden * dashes, alpha)
        rim = np.where(covered, 0.0, rim)
    for weight, ink in ((rim, np.ones(3)), (alpha, color)):
        weight = weight[:, None]
        image[rows, cols] = image[rows, cols] * (1.0 - weight) + ink * weight

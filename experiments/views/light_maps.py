"""Pictures of the light's maps: the scene as they see it, their depth, and what their texels are spent on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp
from scipy.spatial import ConvexHull, QhullError

from experiments.results.images import shaded_view
from experiments.views.bodies import edges
from experiments.views.lines import draw_lines, project
from experiments.views.sheet import Bar, Chips, Panel, Sheet
from experiments.views.space import VIEW_VECTOR
from experiments.views.subject import Subject
from experiments.views.surfaces import FRUSTUM, READ, UNREAD, WASTED, split_color, tinted
from experiments.views.texels import map_positions
from wkernels.frame.shading import AMBIENT, SKY
from wkernels.raster import Rasteriser
from wkernels.scene.views import HostView

SIZES = {1: 520, 2: 440, 3: 360}
SMALL = 300  # pixels a side of a panel where there are four layers or more
EMPTY = (0.17, 0.22, 0.34)  # where nothing casts
_WHITE, _BLACK = 0.96, 0.10  # greys of the nearest and the farthest depth


def panel_size(layers: int) -> int:
    """Pixels per side of each layer's panel."""
    return SIZES.get(layers, SMALL)


def light_views(subject: Subject) -> Sheet:
    """The shaded scene through each map's view, with the eye's frustum in it (Stingl 2011, figure 5.5)."""
    size = panel_size(len(subject.views))
    panels = []
    for i, view in enumerate(subject.views):
        small = replace(view, width=size, height=size)
        image, depth = _seen_from_light(subject, small)
        frusta = subject.frusta
        own = i if len(frusta) == len(subject.views) else 0
        for j, body in enumerate(frusta):
            color, width = (FRUSTUM, 1.9) if j == own else ((0.35, 0.37, 0.42), 0.9)
            draw_lines(image, small, edges(body), color, depth=depth, width=width, hidden=0.65, halo=j == own)
        ray = np.array([[subject.eye.eye_ws, subject.eye.eye_ws + subject.depths[1] * subject.eye.forward_ws]])
        draw_lines(image, small, ray, VIEW_VECTOR, depth=depth, width=2.0, hidden=0.8)
        panels.append(Panel(_framed(image, i), _layer_title(subject, i)))
    legend = [Chips([(FRUSTUM, "the layer's part of the view frustum"), (VIEW_VECTOR, "view vector")])]
    up = "; the view direction runs up" if subject.follows_eye else ""
    return Sheet(panels, legend, [f"Every panel is the whole of a map{up}. Dashed: hidden."])


def depth_map(subject: Subject) -> Sheet:
    """Linear depth as grey, one scale for all layers."""
    size = panel_size(len(subject.views))
    depth = subject.map_depth
    known = depth[np.isfinite(depth)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    images = [_grey(_sampled(layer, size), low, high) for layer in depth]
    panels = [Panel(_framed(image, i), _layer_title(subject, i)) for i, image in enumerate(images)]
    shares = [f"{i}: {100.0 * float(np.isinf(layer).mean()):.1f} %" for i, layer in enumerate(depth)]
    ticks = [(at, f"{low + at * (high - low):.4g}") for at in (0.0, 0.25, 0.5, 0.75, 1.0)]
    bar = Bar(
        "linear depth from the light [scene units]",
        lambda at: np.repeat((_WHITE + at * (_BLACK - _WHITE))[:, None], 3, axis=1),
        ticks,
    )
    return Sheet(panels, [bar, Chips([(EMPTY, "nothing casts")])], [f"Empty texels: {', '.join(shares)}."])


def shadow_area_waste(subject: Subject) -> Sheet:
    """The maps' texels by what they are good for (Stingl 2011, section 7.5)."""
    size = panel_size(len(subject.views))
    depth = subject.map_depth
    known = depth[np.isfinite(depth)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    read = texels_read(subject)
    panels, shares = [], []
    for i in range(len(subject.views)):
        inside = texels_inside(subject, i) | read[i]
        image = 0.35 + 0.65 * _grey(_sampled(depth[i], size), low, high)  # pale, so that the colours are seen
        classes = ((~inside, WASTED), (inside & ~read[i], UNREAD), (read[i], READ))  # what is read is drawn last
        for mask, color in classes:
            image = tinted(image, np.array(color), np.where(_any_of(mask, size), 0.7, 0.0))
        shares.append([float(mask.mean()) for mask, _ in classes])
        lost, spare, used = (100.0 * share for share in shares[-1])
        title = f"{_layer_title(subject, i)}: {used:.0f} / {spare:.0f} / {lost:.0f} %"
        panels.append(Panel(_framed(image, i), title))
    lost, spare, used = (100.0 * float(np.mean([share[k] for share in shares])) for k in range(3))
    legend = Chips(
        [
            (READ, f"read by a pixel of the eye: {used:.1f} %"),
            (UNREAD, f"in B, not read: {spare:.1f} %"),
            (WASTED, f"outside B, wasted: {lost:.1f} %"),
        ]
    )
    notes = [
        "Above each map: the same three shares of its texels. Read is the texel that a receiver falls into; filters "
        "read its neighbours too."
    ]
    return Sheet(panels, [legend], notes)


def texels_read(subject: Subject) -> np.ndarray:
    """Texels that a receiver seen by the eye falls into, bool (layers, R, R)."""
    shot = subject.shot("eye")
    out = np.zeros((len(subject.views), subject.resolution, subject.resolution), bool)
    reads = (shot.layer >= 0) & ~subject.is_back_lit(shot)
    place = np.clip(map_positions(subject, shot)[reads].astype(int), 0, subject.resolution - 1)
    out[shot.layer[reads], place[:, 1], place[:, 0]] = True
    return out


def texels_inside(subject: Subject, layer: int) -> np.ndarray:
    """Texels whose centre's light ray meets the body B of a layer, bool (R, R).

    B is H with all light rays to it, so that both have one outline in the map: the hull of H's corners.
    """
    size = subject.resolution
    body, view = subject.parts[layer], subject.views[layer]
    if body.is_empty:
        return np.zeros((size, size), bool)
    h = project(view, body.vertices)
    h = h[h[:, 3] > 1e-9 * np.abs(h[:, 3]).max()]
    try:
        equations = ConvexHull(h[:, :2] / h[:, 3:]).equations
    except (QhullError, ValueError):  # seen edge-on, or next to nothing of it
        return np.zeros((size, size), bool)
    centre = (np.arange(size) + 0.5) / size
    x, y = 2.0 * centre - 1.0, 1.0 - 2.0 * centre
    inside = np.ones((size, size), bool)
    for a, b, c in equations:
        inside &= a * x[None, :] + b * y[:, None] + c <= 1e-9
    return inside


def _seen_from_light(subject: Subject, view: HostView) -> tuple[np.ndarray, np.ndarray]:
    """The scene through a light's view, display colours (H, W, 3), and its linear depth.

    All that the light sees is lit, so that there is nothing to be compared.
    """
    engine, geometry = subject.engine, subject.geometry
    depth = wp.empty((view.height, view.width), dtype=float, device=engine.device)
    triangle = wp.empty((view.height, view.width), dtype=int, device=engine.device)
    rasteriser = Rasteriser(engine.device, engine.threads)
    points, cutouts = geometry.points_ws, geometry.cutouts
    rasteriser.draw(points, geometry.indices, view.to_device(), depth, triangle, cutouts=cutouts)
    ids, far = triangle.numpy(), depth.numpy().astype(float)
    seen = ids >= 0
    normals = geometry.triangle_normal_ws.numpy().astype(float)[ids[seen]]
    diffuse = geometry.mesh_diffuse.numpy().astype(float)[geometry.triangle_mesh.numpy()[ids[seen]]]
    facing = np.abs(np.einsum("ni,ni->n", normals, subject.to_light(_unprojected(view, far)[seen])))
    color = np.broadcast_to(np.array(list(SKY)), (*ids.shape, 3)).copy()
    color[seen] = diffuse * (AMBIENT + (1.0 - AMBIENT) * facing)[:, None]
    return shaded_view(color) / 255.0, np.where(seen, far, np.inf)


def _unprojected(view: HostView, depth: np.ndarray) -> np.ndarray:
    """Positions (H, W, 3) of pixels with linear depth; zero where there is none."""
    rows = view.ws_to_ss
    x = 2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0
    y = 1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height
    known = np.isfinite(depth)
    at_y, at_x = np.nonzero(known)
    equations = np.stack(
        [
            rows[0] - x[at_x][:, None] * rows[3],
            rows[1] - y[at_y][:, None] * rows[3],
            np.broadcast_to(rows[2], (len(at_x), 4)),
        ],
        axis=1,
    )
    right = -equations[:, :, 3].copy()
    right[:, 2] += depth[known]
    out = np.zeros((*depth.shape, 3))
    if len(at_x):
        out[known] = np.linalg.solve(equations[:, :, :3], right[..., None])[..., 0]
    return out


def _sampled(image: np.ndarray, size: int) -> np.ndarray:
    """Every so-many-th texel, (size, size)."""
    pick = ((np.arange(size) + 0.5) * image.shape[0] / size).astype(int)
    return image[pick][:, pick]


def _any_of(mask: np.ndarray, size: int) -> np.ndarray:
    """Whether any texel of a pixel is set, so that single ones stay visible, (size, size)."""
    if mask.shape[0] <= size:
        return _sampled(mask, size)
    bounds = (np.arange(size) * mask.shape[0] / size).astype(int)
    out: np.ndarray = np.logical_or.reduceat(np.logical_or.reduceat(mask, bounds, axis=0), bounds, axis=1)
    return out


def _grey(depth: np.ndarray, low: float, high: float) -> np.ndarray:
    span = max(high - low, 1e-30)
    value = _WHITE + (_BLACK - _WHITE) * (np.where(np.isfinite(depth), depth, low) - low) / span
    out = np.repeat(value[..., None], 3, axis=-1)
    out[~np.isfinite(depth)] = EMPTY
    return out


def _framed(image: np.ndarray, layer: int) -> np.ndarray:
    """An image within a rim of the layer's colour."""
    out = np.empty((image.shape[0] + 6, image.shape[1] + 6, 3))
    out[:] = split_color(layer)
    out[3:-3, 3:-3] = image
    return out


def _layer_title(subject: Subject, layer: int) -> str:
    near, far = subject.ranges[layer]
    if len(subject.views) == 1:
        return "the only map"
    return f"split {layer}: {near:.4g} to {far:.4g}" if subject.is_split else f"layer {layer}"

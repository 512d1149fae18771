"""A snowy valley: 500 x 500 x 100 m, about 380 000 triangles (after stingl2011).

Hilly terrain (a height field), conifers whose foliage is closed cones and small needle triangles, log cabins in a
clearing and a fence. Units are metres.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.ndimage import map_coordinates

from experiments.scenes.generators._shapes import beams, boxes, cones, lofts, merge, turned
from experiments.scenes.primitives import Triangles, grid
from wkernels.scene.model import Mesh

_SIZE = 500.0
_HEIGHT = 100.0
_CLEARINGS = np.array([[-20.0, 60.0, 58.0], [70.0, -40.0, 36.0], [-90.0, -60.0, 30.0]])  # x, z, radius
# A trail from the southern edge through the clearings to the north-western slope, (x, z); no trees stand on it.
_TRAIL = np.array(
    [[-14.0, 240.0], [-14.0, 172.0], [4.0, 122.0], [18.0, 74.0], [22.0, 10.0], [-35.0, -62.0], [-112.0, -128.0]]
)
_TRAIL_HALF_WIDTH = 7.0
_LAYERS = 5  # cones of foliage per tree
_SIDES = 9
_CONIFER_TRIANGLES = 6 + 8 + _LAYERS * (2 * _SIDES - 2)


def generate(
    *,
    seed: Annotated[int, Field(ge=0)] = 1,
    triangles: Annotated[int, Field(ge=100_000, le=2_000_000)] = 380_000,
    needles: Annotated[int, Field(ge=0, le=200)] = 48,
    cabins: Annotated[int, Field(ge=1, le=24)] = 9,
) -> list[Mesh]:
    """Builds the valley.

    Args:
        seed: Of everything random: hills, trees, cabins.
        triangles: Target of the total, met by the number of trees and the last tree's needles.
        needles: Needle triangles per tree, in the mean.
        cabins: Number of log cabins.
    """
    rng = np.random.default_rng(seed)
    cells = int(np.clip(round(150 * np.sqrt(triangles / 380_000)), 60, 260))
    relief = _relief(rng, cells)
    cabin_xz, cabin_heading = _cabin_sites(rng, cabins)
    spare = triangles - 2 * cells * cells - 20_000 * cabins // 9
    count = int(spare / (_CONIFER_TRIANGLES + 0.5 * 2 * (_SIDES - 1) * _LAYERS * 0.5 + needles))
    tree_xz = _tree_sites(rng, count, cabin_xz)
    height = rng.uniform(7.0, 17.0, len(tree_xz)) * rng.uniform(0.75, 1.0, len(tree_xz))
    # The hills are as high as they may be for the highest tree top to be at 100 m exactly.
    at_trees = _sample(relief, tree_xz)
    amplitude = float(np.min((_HEIGHT - height) / np.maximum(at_trees, 1e-6)))
    amplitude = min(amplitude, _HEIGHT / float(relief.max()))
    relief = relief * amplitude
    ground_y = _sample(relief, tree_xz)
    terrain = _terrain(relief)
    trunks, foliage, snow = _conifers(rng, tree_xz, ground_y, height)
    wood = _cabin_parts(relief, cabin_xz, cabin_heading)
    parts = {
        "terrain": (terrain, (0.86, 0.88, 0.92)),
        "trunks": (trunks, (0.24, 0.17, 0.11)),
        "foliage": (foliage, (0.10, 0.21, 0.12)),
        "snow_on_trees": (snow, (0.88, 0.90, 0.93)),
        "fence": (_fence(relief), (0.32, 0.23, 0.15)),
        **wood,
    }
    left = triangles - sum(len(part[1]) for part, _ in parts.values())
    parts["needles"] = (_needles(rng, tree_xz, ground_y, height, max(0, left)), (0.13, 0.26, 0.13))
    for vertices, _ in (part for part, _ in parts.values()):
        vertices[:, 1] = np.maximum(vertices[:, 1], 0.0)  # what is sunk into the lowest ground would end below it
    return [Mesh(name, *part, diffuse=colour) for name, (part, colour) in parts.items() if len(part[1])]


def _relief(rng: np.random.Generator, cells: int) -> np.ndarray:
    """Heights at (cells + 1)^2 corners, rows along x, lowest 0: hills around a valley, flattened where cabins stand."""
    n = cells + 1
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, n), np.linspace(-1.0, 1.0, n))
    height = np.zeros((n, n))
    for octave, strength in ((3, 0.42), (6, 0.2), (12, 0.09), (25, 0.028)):
        coarse = rng.uniform(-1.0, 1.0, (octave + 3, octave + 3))
        rows, columns = (z + 1.0) * 0.5 * octave + 1.0, (x + 1.0) * 0.5 * octave + 1.0
        height += strength * map_coordinates(coarse, [rows, columns], order=3, mode="nearest")
    valley = np.abs(x + 0.25 * np.sin(2.2 * z)) ** 1.5
    height = 0.55 * height + 0.95 * valley + 0.18 * z * z
    height -= height.min()
    for cx, cz, radius in _CLEARINGS:
        distance = np.hypot(x * 0.5 * _SIZE - cx, z * 0.5 * _SIZE - cz)
        weight = np.exp(-((distance / radius) ** 4))
        level = float(np.sum(weight * height) / np.sum(weight))
        height += weight * 0.85 * (level - height)
    return np.asarray(height - height.min())


def _sample(relief: np.ndarray, xz: np.ndarray) -> np.ndarray:
    cells = len(relief) - 1
    at = (xz / _SIZE + 0.5) * cells
    return np.asarray(map_coordinates(relief, [at[:, 1], at[:, 0]], order=1, mode="nearest"))


def _terrain(relief: np.ndarray) -> Triangles:
    vertices, faces = grid((_SIZE, _SIZE), len(relief) - 1)
    vertices[:, 1] = relief.ravel()
    return vertices, faces


def _cabin_sites(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (count, 2) on rings in the clearings, and headings that look at their middles."""
    share = np.arange(count) % len(_CLEARINGS)
    clearing = _CLEARINGS[share]
    turn = 2.4 * (np.arange(count) // len(_CLEARINGS)) + 1.3 * share + rng.uniform(-0.2, 0.2, count)
    radius = 0.55 * clearing[:, 2] * rng.uniform(0.85, 1.1, count)
    out = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    return clearing[:, :2] + out * radius[:, None], turn + np.pi + rng.uniform(-0.5, 0.5, count)


def _tree_sites(rng: np.random.Generator, count: int, cabin_xz: np.ndarray) -> np.ndarray:
    """Positions (count, 2): denser in groves, none in the middle of clearings, at cabins or on the border."""
    found = np.zeros((0, 2))
    groves = rng.uniform(-235.0, 235.0, (60, 2))
    while len(found) < count:
        xz = rng.uniform(-244.0, 244.0, (4 * count, 2))
        near_grove = np.min(np.linalg.norm(xz[:, None] - groves, axis=2), axis=1)
        to_clearing = np.min(np.linalg.norm(xz[:, None] - _CLEARINGS[:, :2], axis=2) / _CLEARINGS[:, 2], axis=1)
        to_cabin = np.min(np.linalg.norm(xz[:, None] - cabin_xz, axis=2), axis=1)
        chance = (0.25 + 0.75 * np.exp(-((near_grove / 32.0) ** 2))) * np.clip(1.6 * (to_clearing - 0.62), 0.03, 1.0)
        keep = (rng.uniform(size=len(xz)) < chance) & (to_cabin > 8.5) & (_to_trail(xz) > _TRAIL_HALF_WIDTH)
        found = np.concatenate([found, xz[keep]])
    return found[:count]


def _to_trail(xz: np.ndarray) -> np.ndarray:
    """Distance of points (n, 2) to the trail."""
    start, step = _TRAIL[:-1], np.diff(_TRAIL, axis=0)
    along = np.sum((xz[:, None] - start) * step, axis=2) / np.sum(step * step, axis=1)
    foot = start + np.clip(along, 0.0, 1.0)[..., None] * step
    return np.min(np.linalg.norm(xz[:, None] - foot, axis=2), axis=1)


def _conifers(
    rng: np.random.Generator, xz: np.ndarray, ground: np.ndarray, height: np.ndarray
) -> tuple[Triangles, Triangles, Triangles]:
    """Trunks, cones of foliage and, on half of them, a cap of snow."""
    n = len(xz)
    angle = 2.0 * np.pi * np.arange(3) / 3
    rims = _rims(xz, ground - 0.4, np.stack([np.sin(angle), np.cos(angle)], axis=1) * 0.026 * height[:, None, None])
    upper = _rims(
        xz, ground + 0.5 * height, np.stack([np.sin(angle), np.cos(angle)], axis=1) * 0.014 * height[:, None, None]
    )
    trunks = lofts(np.stack([rims, upper], axis=1))
    foliage, snow = [], []
    for layer in range(_LAYERS):
        rim, apex = _layer(rng, xz, ground, height, layer)
        foliage.append(cones(rim, apex))
        capped = rng.uniform(size=n) < 0.5
        # Snow lies on the cone down to near its rim, a little wider; the next layer hides its upper half.
        middle = apex[:, None] + (rim - apex[:, None]) * rng.uniform(0.7, 0.9, (n, 1, 1)) * np.array([1.06, 0.94, 1.06])
        snow.append(cones(middle[capped], apex[capped] + np.array([0.0, 0.08, 0.0])))
    return trunks, merge(foliage), merge(snow)


def _rims(xz: np.ndarray, y: np.ndarray, section: np.ndarray) -> np.ndarray:
    """Rings (n, m, 3) around points (n, 2) from offsets (n, m, 2)."""
    ring = np.empty((*section.shape[:2], 3))
    ring[..., 0], ring[..., 2] = xz[:, :1] + section[..., 0], xz[:, 1:] + section[..., 1]
    ring[..., 1] = y[:, None]
    return ring


def _layer(
    rng: np.random.Generator, xz: np.ndarray, ground: np.ndarray, height: np.ndarray, layer: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rims (n, sides, 3), drooping and ragged, and apexes (n, 3) of one layer of foliage."""
    n = len(xz)
    share = layer / (_LAYERS - 1.0)
    bottom, top = 0.14 + 0.58 * share, 0.42 + 0.58 * share
    radius = height * (0.235 - 0.15 * share)
    angle = 2.0 * np.pi * (np.arange(_SIDES) / _SIDES + rng.uniform(size=(n, 1)))
    reach = radius[:, None] * rng.uniform(0.78, 1.12, (n, _SIDES))
    rim = _rims(xz, ground + bottom * height, np.stack([np.sin(angle), np.cos(angle)], axis=2) * reach[..., None])
    rim[..., 1] -= rng.uniform(0.0, 0.05, (n, _SIDES)) * height[:, None]
    apex = np.stack([xz[:, 0], ground + top * height, xz[:, 1]], axis=1)
    return rim, apex


def _needles(rng: np.random.Generator, xz: np.ndarray, ground: np.ndarray, height: np.ndarray, count: int) -> Triangles:
    """``count`` small triangles that stick out of the foliage at random."""
    tree = np.arange(count) % len(xz)
    share = rng.uniform(0.0, 1.0, count)
    radius = height[tree] * (0.25 * (1.0 - share) + 0.015)
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    out = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    reach = radius * rng.uniform(0.55, 0.9, count)
    y = ground[tree] + height[tree] * (0.12 + 0.8 * share)
    base = np.stack([xz[tree, 0] + out[:, 0] * reach, y, xz[tree, 1] + out[:, 1] * reach], axis=1)
    length = height[tree] * rng.uniform(0.04, 0.09, count)
    along = np.stack([out[:, 0], rng.uniform(-0.55, -0.1, count), out[:, 1]], axis=1) * length[:, None]
    side = np.stack([out[:, 1], np.zeros(count), -out[:, 0]], axis=1) * (0.32 * length)[:, None]
    vertices = np.stack([base - side, base + side, base + along], axis=1)
    return vertices.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def _cabin_parts(
    relief: np.ndarray, xz: np.ndarray, heading: np.ndarray
) -> dict[str, tuple[Triangles, tuple[float, float, float]]]:
    """Log walls, snowy roofs, chimneys, doors and windows of cabins (k, 2); all closed."""
    k = len(xz)
    ground = _sample(relief, xz) - 0.3
    long, deep, wall = 8.0, 6.0, 3.0

    def points(x: float | np.ndarray, y: float, z: float | np.ndarray) -> np.ndarray:
        local = np.broadcast_to(np.stack(np.broadcast_arrays(x, z), axis=-1).astype(np.float64), (k, 2))
        at = turned(local, heading) + xz
        return np.stack([at[:, 0], ground + y, at[:, 1]], axis=1)

    def box(x: float, y: float, z: float, size: tuple[float, float, float]) -> Triangles:
        return boxes(points(x, y, z), np.array([size]), heading)

    rows = np.arange(11)
    logs: list[Triangles] = [box(0.0, 0.5 * wall, 0.0, (long - 0.5, wall, deep - 0.5))]
    for row in rows:
        y, shift = 0.15 + row * 0.29, 0.145
        logs += [
            beams(points(-0.5 * long - 0.35, y, s), points(0.5 * long + 0.35, y, s), 0.3)
            for s in (-0.5 * deep, 0.5 * deep)
        ]
        logs += [
            beams(points(s, y + shift, -0.5 * deep - 0.35), points(s, y + shift, 0.5 * deep + 0.35), 0.3)
            for s in (-0.5 * long, 0.5 * long)
        ]
    top, ridge, over = wall + 0.2, wall + 3.0, 0.9
    gable = [
        np.stack(
            [points(x, wall - 0.1, -0.5 * deep), points(x, ridge - 0.2, 0.0), points(x, wall - 0.1, 0.5 * deep)], axis=1
        )
        for x in (-0.5 * long, 0.5 * long)
    ]
    logs.append(lofts(np.stack(gable, axis=1)))
    roofs: list[Triangles] = []
    boards: list[Triangles] = []
    for side in (-1.0, 1.0):
        eave_z, eave_y = side * (0.5 * deep + over), top - over * (ridge - top) / (0.5 * deep)
        for part, low, high in ((boards, -0.12, 0.05), (roofs, 0.05, 0.5)):
            ends = []
            for x in (-0.5 * long - over, 0.5 * long + over):
                section = [points(x, eave_y + low, eave_z), points(x, ridge + low, 0.0)]
                section += [points(x, ridge + high, 0.0), points(x, eave_y + high, eave_z)]
                ends.append(np.stack(section if side > 0 else section[::-1], axis=1))
            part.append(lofts(np.stack(ends, axis=1)))
    front = 0.5 * deep + 0.16
    dark = [box(0.0, 1.1, front, (1.1, 2.2, 0.12))]
    dark += [box(x, 1.75, z, (1.2, 1.0, 0.12)) for x in (-2.4, 2.4) for z in (-front, front)]
    stones = [box(2.2, 3.6, -1.4, (0.9, 5.6, 0.9))]
    porch = [box(0.0, 0.3, 0.5 * deep + 0.9, (3.2, 0.3, 1.6))]
    return {
        "cabins": (merge(logs + porch), (0.40, 0.26, 0.15)),
        "roof_boards": (merge(boards), (0.28, 0.19, 0.12)),
        "roof_snow": (merge(roofs), (0.88, 0.90, 0.93)),
        "doors_and_windows": (merge(dark), (0.14, 0.11, 0.10)),
        "chimneys": (merge(stones), (0.42, 0.40, 0.39)),
    }


def _fence(relief: np.ndarray) -> Triangles:
    """Posts and two rails around most of the first clearing."""
    cx, cz, radius = _CLEARINGS[0]
    turn = np.linspace(0.4, 5.6, 74)
    xz = np.array([cx, cz]) + 0.8 * radius * np.stack([np.sin(turn), np.cos(turn)], axis=1)
    foot = np.stack([xz[:, 0], _sample(relief, xz), xz[:, 1]], axis=1)
    up = np.array([0.0, 1.0, 0.0])
    posts = beams(foot - 0.4 * up, foot + 1.35 * up, 0.18)
    rails = [beams(foot[:-1] + y * up, foot[1:] + y * up, 0.11) for y in (0.6, 1.1)]
    return merge([posts, *rails])

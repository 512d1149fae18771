"""The courtyard blocks of ``paris``: mansard houses with chimneys, dormers, balconies, sills and window panes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from experiments.scenes.generators._shapes import CORNERS, boxes, copies, lofts, turned
from experiments.scenes.primitives import Triangles

PARK = 78.0  # half width of the park along x, which has no blocks
WALLS = ((0.78, 0.72, 0.60), (0.72, 0.64, 0.52), (0.83, 0.79, 0.71))
_DEPTH = 13.0  # of a house
_STREET = 14.0
_FLOOR = 3.3


@dataclass(frozen=True, eq=False)
class Houses:
    """All houses, n of them; the facade looks along ``heading``, towards the street."""

    centre: np.ndarray  # (n, 2) x, z
    width: np.ndarray  # (n,) along the street
    heading: np.ndarray  # (n,) rad about +Y, 0 = +z
    eaves: np.ndarray  # (n,) height
    floors: np.ndarray  # (n,) int
    kind: np.ndarray  # (n,) int, index of the wall colour

    def place(self, which: np.ndarray, along: np.ndarray, y: np.ndarray, out: np.ndarray | float) -> np.ndarray:
        """World points (..., 3) of house ``which`` (...), ``along`` its facade and ``out`` of it to the street."""
        which, along, y, out = np.broadcast_arrays(which, along, y, out)
        xz = self.centre[which] + turned(np.stack([along, out], axis=-1), self.heading[which])
        return np.stack([xz[..., 0], y, xz[..., 1]], axis=-1)


def blocks() -> np.ndarray:
    """Courtyard blocks, (b, 4): x0, x1, z0, z1."""
    out: list[tuple[float, float, float, float]] = []

    def fill(x: tuple[float, float], z: tuple[float, float], columns: int, rows: int) -> None:
        xs, zs = np.linspace(*x, columns + 1), np.linspace(*z, rows + 1)
        half = 0.5 * _STREET
        out.extend(
            (xs[i] + half, xs[i + 1] - half, zs[j] + half, zs[j + 1] - half)
            for i in range(columns)
            for j in range(rows)
        )

    fill((-423.0, -PARK), (-200.0, 398.0), 4, 7)
    fill((PARK, 423.0), (-200.0, 398.0), 4, 7)
    fill((-423.0, 423.0), (-398.0, -314.0), 10, 1)
    return np.array(out)


def build_houses(rng: np.random.Generator, width: float) -> Houses:
    rows: list[np.ndarray] = []
    for x0, x1, z0, z1 in blocks():
        height = rng.uniform(4.6, 6.4)
        # The rows along x take the corners. Each: start, direction along the facade, length, heading.
        sides = (
            (x0, z1 - 0.5 * _DEPTH, 1.0, 0.0, x1 - x0, 0.0),
            (x1, z0 + 0.5 * _DEPTH, -1.0, 0.0, x1 - x0, np.pi),
            (x1 - 0.5 * _DEPTH, z1 - _DEPTH, 0.0, -1.0, z1 - z0 - 2.0 * _DEPTH, 0.5 * np.pi),
            (x0 + 0.5 * _DEPTH, z0 + _DEPTH, 0.0, 1.0, z1 - z0 - 2.0 * _DEPTH, -0.5 * np.pi),
        )
        for x, z, dx, dz, length, heading in sides:
            count = max(2, round(length / width))
            cuts = np.linspace(0.0, length, count + 1)
            cuts[1:-1] += rng.uniform(-0.18, 0.18, count - 1) * length / count
            middle = 0.5 * (cuts[1:] + cuts[:-1])
            floors = np.round(height + rng.uniform(-0.9, 0.9, count))
            rows.append(
                np.stack(
                    [x + dx * middle, z + dz * middle, np.diff(cuts) - 0.04, np.full(count, heading), floors], axis=1
                )
            )
    table = np.concatenate(rows)
    floors = table[:, 4].astype(int)
    eaves = 1.0 + _FLOOR * floors + rng.uniform(-0.35, 0.35, len(table))
    kind = rng.integers(0, len(WALLS), len(table))
    return Houses(table[:, :2], table[:, 2], table[:, 3], eaves, floors, kind)


def bodies(houses: Houses) -> dict[str, Triangles]:
    """Walls with a cornice, by colour, and mansard roofs."""
    n = len(houses.width)

    def ring(y: np.ndarray, more_along: float, more_out: float) -> np.ndarray:
        along = CORNERS[:, 0] * (0.5 * houses.width[:, None] + more_along)
        return houses.place(np.arange(n)[:, None], along, y[:, None], CORNERS[:, 1] * (0.5 * _DEPTH + more_out))

    top = houses.eaves
    walls = np.stack(
        [ring(0.0 * top, 0, 0), ring(top - 0.6, 0, 0), ring(top - 0.3, 0, 0.55), ring(top, 0, 0.55)], axis=1
    )
    roofs = np.stack([ring(top, 0, 0.1), ring(top + 3.1, 0, -1.2), ring(top + 4.7, 0, -4.6)], axis=1)
    by_colour = {f"houses_{i}": lofts(walls[houses.kind == i]) for i in range(len(WALLS))}
    return {**by_colour, "roofs": lofts(roofs)}


def details(
    rng: np.random.Generator, houses: Houses, budget: int
) -> dict[str, tuple[Triangles, tuple[float, float, float]]]:
    """Window panes, chimneys, dormers, balconies and sills that use up ``budget`` triangles."""
    bays = np.maximum(2, (houses.width / 3.1).astype(int))
    panes = _each(rng, bays * houses.floors)
    pane_count = min(len(panes[0]), budget // 2)
    left = (budget - 2 * pane_count) // 12
    counts = {"chimneys": 4 + 0 * bays, "dormers": bays, "balconies": houses.floors - 2, "sills": bays * houses.floors}
    usual = {"chimneys": 2 + 0 * bays, "dormers": (bays + 1) // 2, "balconies": 1 + 0 * bays, "sills": 0 * bays}
    items = {name: _each(rng, count, usual[name]) for name, count in counts.items()}
    # Every house first gets what is usual; what is left of the budget is spent kind by kind.
    spent = dict.fromkeys(items, 0)
    for limits in ({name: int(count.sum()) for name, count in usual.items()}, {n: len(i[0]) for n, i in items.items()}):
        for name, limit in limits.items():
            more = min(limit - spent[name], left)
            spent[name] += more
            left -= more
    shapes = {"chimneys": _chimneys, "dormers": _dormers, "balconies": _balconies, "sills": _sills}
    colours = {
        "chimneys": (0.52, 0.30, 0.22),
        "dormers": (0.66, 0.62, 0.56),
        "balconies": (0.17, 0.17, 0.18),
        "sills": (0.70, 0.67, 0.60),
    }
    out = {}
    for name, shape in shapes.items():
        which, slot = (array[: spent[name]] for array in items[name])
        out[name] = shape(rng, houses, bays, which, slot), colours[name]
    which, slot = (array[:pane_count] for array in panes)
    out["windows"] = _panes(houses, bays, which, slot), (0.12, 0.14, 0.17)
    return out


def _each(rng: np.random.Generator, count: np.ndarray, first: np.ndarray | int = 0) -> tuple[np.ndarray, np.ndarray]:
    """House and slot of ``count`` (n,) items per house in random order, slots below ``first`` before the others."""
    which = np.repeat(np.arange(len(count)), count)
    slot = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    late = slot >= np.broadcast_to(first, len(count))[which]
    order = np.lexsort((rng.permutation(len(which)), late))
    return which[order], slot[order]


def _chimneys(
    rng: np.random.Generator, houses: Houses, bays: np.ndarray, which: np.ndarray, slot: np.ndarray
) -> Triangles:
    n = len(which)
    size = np.stack([np.full(n, 0.8), rng.uniform(5.4, 7.0, n), rng.uniform(1.4, 3.0, n)], axis=1)
    side = np.where(slot % 2 == 0, -0.5, 0.5) * (houses.width[which] - 0.9)
    reach = np.where(slot < 2, 1.5, 3.6)
    centre = houses.place(which, side, houses.eaves[which] + 0.5 * size[:, 1] - 0.2, rng.uniform(-reach, reach))
    return boxes(centre, size, houses.heading[which])


def _dormers(
    rng: np.random.Generator, houses: Houses, bays: np.ndarray, which: np.ndarray, slot: np.ndarray
) -> Triangles:
    # Every other bay first, so that few dormers are spread evenly over the facade.
    half = (bays[which] + 1) // 2
    bay = np.where(slot < half, 2 * slot, 2 * (slot - half) + 1)
    centre = houses.place(which, _along(houses, bays, which, bay), houses.eaves[which] + 1.35, 0.5 * _DEPTH - 1.2)
    return boxes(centre, np.array([[1.35, 2.3, 2.0]]), houses.heading[which])


def _balconies(
    rng: np.random.Generator, houses: Houses, bays: np.ndarray, which: np.ndarray, slot: np.ndarray
) -> Triangles:
    size = np.stack([houses.width[which] - 1.2, np.full(len(which), 1.0), np.full(len(which), 0.7)], axis=1)
    centre = houses.place(which, np.zeros(len(which)), 1.2 + _FLOOR * (slot + 2), 0.5 * _DEPTH + 0.33)
    return boxes(centre, size, houses.heading[which])


def _sills(
    rng: np.random.Generator, houses: Houses, bays: np.ndarray, which: np.ndarray, slot: np.ndarray
) -> Triangles:
    storey, bay = np.divmod(slot, bays[which])
    centre = houses.place(which, _along(houses, bays, which, bay), 1.3 + _FLOOR * storey, 0.5 * _DEPTH + 0.1)
    return boxes(centre, np.array([[1.6, 0.14, 0.3]]), houses.heading[which])


def _panes(houses: Houses, bays: np.ndarray, which: np.ndarray, slot: np.ndarray) -> Triangles:
    storey, bay = np.divmod(slot, bays[which])
    along = _along(houses, bays, which, bay)
    low = np.where(storey == 0, 0.4, 1.4 + _FLOOR * storey)
    high = low + np.where(storey == 0, 3.0, 2.05)
    half = np.where(storey == 0, 1.1, 0.62)
    out = 0.5 * _DEPTH + 0.03
    corners = [houses.place(which, along + s * half, y, out) for s, y in ((-1, low), (1, low), (1, high), (-1, high))]
    return copies(np.array([[0, 1, 2], [0, 2, 3]]), np.stack(corners, axis=1))


def _along(houses: Houses, bays: np.ndarray, which: np.ndarray, bay: np.ndarray) -> np.ndarray:
    """Where along the facade the middle of a bay is."""
    return ((bay + 0.5) / bays[which] - 0.5) * houses.width[which]

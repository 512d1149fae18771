"""For each texel of a map a short list of depths with a count each: what was seen there, and how often.

Points fall into texels from anywhere, a whole map of them at a time; those that agree in depth are one entry, whose
count grows (the layers of Agrawala, Ramamoorthi, Heirich and Moll 2000). Points are sorted by texel first, so that
each list is written by one thread, in the order of the points, and results do not depend on the number of threads.
"""

from __future__ import annotations

import warp as wp

from wkernels.device.launch import launch

NOT_FOUND = wp.constant(-1)


@wp.struct
class DepthLists:
    """Lists on the device, of at most ``depth.shape[1]`` entries each, in the order of depth."""

    depth: wp.array2d(dtype=float)  # (texels, capacity), behind the last entry +inf
    count: wp.array2d(dtype=int)  # (texels, capacity)
    lost: wp.array(dtype=int)  # (texels,) the sum of the counts that found no room


def allocate_lists(texels: int, capacity: int, device: str) -> DepthLists:
    """Empty lists of at most ``capacity`` entries, at least 1, for so many texels."""
    out = DepthLists()
    out.depth = wp.full((texels, capacity), float("inf"), dtype=float, device=device)
    out.count = wp.zeros((texels, capacity), dtype=int, device=device)
    out.lost = wp.zeros(texels, dtype=int, device=device)
    return out


@wp.func
def find_entry(lists: DepthLists, texel: int, depth: float, tolerance: float):
    """The entry nearest to a depth, the first of two as near, if it is no farther than ``tolerance``; or NOT_FOUND."""
    best = NOT_FOUND
    least = tolerance
    for i in range(lists.depth.shape[1]):
        away = wp.abs(lists.depth[texel, i] - depth)
        if away < least or (away == least and best == NOT_FOUND):
            best = i
            least = away
    return best


@wp.func
def add_entry(lists: DepthLists, texel: int, depth: float, tolerance: float, amount: int):
    """Adds to the count of the entry that ``find_entry`` finds, or makes a new one; only by the texel's own thread.

    A full list keeps the entries that are nearest; the count of the one that goes is lost.
    """
    entry = find_entry(lists, texel, depth, tolerance)
    if entry != NOT_FOUND:
        lists.count[texel, entry] += amount
        return
    last = lists.depth.shape[1] - 1
    if depth >= lists.depth[texel, last]:
        lists.lost[texel] += amount
        return
    lists.lost[texel] += lists.count[texel, last]
    at = last
    while at > 0 and lists.depth[texel, wp.max(at - 1, 0)] > depth:
        lists.depth[texel, at] = lists.depth[texel, at - 1]
        lists.count[texel, at] = lists.count[texel, at - 1]
        at -= 1
    lists.depth[texel, at] = depth
    lists.count[texel, at] = amount


@wp.kernel
def number_points(first: int, texel: wp.array(dtype=int), key_out: wp.array(dtype=int), point_out: wp.array(dtype=int)):
    """What is sorted: texels, and the points that fall into them."""
    i = first + wp.tid()
    key_out[i] = texel[i]
    point_out[i] = i


@wp.kernel
def add_sorted(
    first: int,
    texel: wp.array(dtype=int),  # sorted
    point: wp.array(dtype=int),
    points: int,
    depth: wp.array(dtype=float),
    tolerance: wp.array(dtype=float),
    amount: int,
    lists: DepthLists,
):
    """The first point of a texel adds all of the texel's points."""
    i = first + wp.tid()
    own = texel[i]
    if own < 0 or (i > 0 and texel[wp.max(i - 1, 0)] == own):
        return
    j = i
    while j < points and texel[wp.min(j, points - 1)] == own:
        add_entry(lists, own, depth[point[j]], tolerance[point[j]], amount)
        j += 1


def add_points(
    lists: DepthLists,
    texel: wp.array,
    depth: wp.array,
    tolerance: wp.array,
    amount: int = 1,
    *,
    threads: int | None = None,
) -> None:
    """Adds points to the lists of the texels that they fall into.

    Args:
        lists: Are added to.
        texel: int32 (points,), the list of each; negative where it falls into none.
        depth: float32 (points,), finite, scene units.
        tolerance: float32 (points,), >= 0: how far an entry may be for the point to count as the same.
        amount: What each adds to its entry's count.
        threads: CPU threads; see ``wkernels.device.launch``. The result does not depend on it.
    """
    points, device = len(texel), str(texel.device)
    key, point = (wp.empty(2 * points, dtype=int, device=device) for _ in range(2))  # twice: room to sort in
    launch(number_points, points, [texel], [key, point], device=device, threads=threads)
    wp.utils.radix_sort_pairs(key, point, points)  # keeps the order of points in one texel
    inputs = [key, point, points, depth, tolerance, amount]
    launch(add_sorted, points, inputs, [lists], device=device, threads=threads)

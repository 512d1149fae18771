"""The layers of a light map that the receivers of a run read: ``light_map.to_layer``, 16 at a time."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints
from wkernels.light_maps.light_map import BY_DEPTH, BY_MARGIN, FILTER_TEXELS, LightMap


@wp.func
def to_layers(light_map: LightMap, wanted: Ints, px: Floats, py: Floats, pz: Floats):
    """``to_layer`` of each lane that is wanted (1), -1 of the others (0)."""
    if light_map.selection != BY_MARGIN:
        return to_splits(light_map, wanted, px, py, pz)
    best = Ints(-1)
    margin = Floats(0.0)
    for layer in range(light_map.layers):
        m = light_map.ws_to_ls[layer]
        m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
        m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
        m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
        for k in range(LANES):
            x = m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03
            y = m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13
            w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
            inside = 1.0 - wp.max(wp.abs(x), wp.abs(y)) / w
            better = wp.where(w > 0.0, wp.where(inside >= margin[k], wanted[k], 0), 0)
            margin[k] = wp.where(better != 0, inside, margin[k])
            best[k] = wp.where(better != 0, layer, best[k])
    return best


@wp.func
def to_splits(light_map: LightMap, wanted: Ints, px: Floats, py: Floats, pz: Floats):
    """``to_split`` of each lane that is wanted (1), -1 of the others (0).

    Neighbours mostly read the same split: layers that no lane can take are not looked at. Only where a lane finds none
    are all looked at again, for the last that holds it at all.
    """
    by_depth = light_map.selection == BY_DEPTH
    least = wp.where(by_depth, 0.0, 2.0 * FILTER_TEXELS / float(light_map.resolution))
    row = light_map.eye_row
    r0, r1, r2, r3 = row[0], row[1], row[2], row[3]
    eye_depth = Floats(0.0)
    best = Ints(-1)
    missing = int(0)
    for k in range(LANES):
        eye_depth[k] = r0 * px[k] + r1 * py[k] + r2 * pz[k] + r3
        missing += wanted[k]
    for layer in range(light_map.layers):
        end = wp.where(by_depth, light_map.split_far[layer], float(wp.inf))
        candidates = int(0)
        for k in range(LANES):
            candidates += wp.where(eye_depth[k] < end, wp.where(best[k] < 0, wanted[k], 0), 0)
        if candidates > 0:
            m = light_map.ws_to_ls[layer]
            m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
            m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
            m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
            for k in range(LANES):
                x = m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03
                y = m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13
                w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
                inside = 1.0 - wp.max(wp.abs(x), wp.abs(y)) / w
                held = wp.where(w > 0.0, wp.where(inside >= least, wanted[k], 0), 0)
                taken = wp.where(eye_depth[k] < end, wp.where(best[k] < 0, held, 0), 0)
                best[k] = wp.where(taken != 0, layer, best[k])
            missing = int(0)
            for k in range(LANES):
                missing += wp.where(best[k] < 0, wanted[k], 0)
        if missing == 0:
            break
    if missing > 0:
        open = Ints(0)
        for k in range(LANES):
            open[k] = wp.where(best[k] < 0, wanted[k], 0)
        for layer in range(light_map.layers):
            m = light_map.ws_to_ls[layer]
            m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
            m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
            m30, m31, m32, m33 = m[3, 0], m[3, 1], m[3, 2], m[3, 3]
            for k in range(LANES):
                x = m00 * px[k] + m01 * py[k] + m02 * pz[k] + m03
                y = m10 * px[k] + m11 * py[k] + m12 * pz[k] + m13
                w = m30 * px[k] + m31 * py[k] + m32 * pz[k] + m33
                inside = 1.0 - wp.max(wp.abs(x), wp.abs(y)) / w
                held = wp.where(w > 0.0, wp.where(inside >= 0.0, open[k], 0), 0)
                best[k] = wp.where(held != 0, layer, best[k])
    return best

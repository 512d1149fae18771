"""Reading shadow buffers of earlier views: one of them may know what is new to the last frame's (``buffer_shelf``)."""

from __future__ import annotations

import warp as wp

from wkernels.device.lanes import Ints
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import MOVES
from wkernels.scene.views import View
from wkernels.temporal.shadow_buffer.record import ShadowRecord, fetch_record
from wkernels.temporal.shadow_buffer.record_lanes import HistoryRun


@wp.struct
class EarlierBuffers:
    """Shadow buffers that were put aside, on the device."""

    count: int
    texels: wp.array3d(dtype=wp.vec4)  # (slots, H, W)
    views: wp.array(dtype=View)  # (slots,)


@wp.func
def fetch_earlier(
    earlier: EarlierBuffers, position_ws: wp.vec3, normal_ws: wp.vec3, epsilon: float, relative: float, steps: float
) -> ShadowRecord:
    """``fetch_record`` of the buffer that knows most of a point; n = 0 where none does."""
    result = ShadowRecord()
    for i in range(earlier.count):
        held = fetch_record(earlier.texels[i], earlier.views[i], position_ws, normal_ws, epsilon, relative, steps)
        if held.n > result.n and held.of_mover == 0:
            result = held
    return result


@wp.func
def fetch_earlier_run(
    earlier: EarlierBuffers,
    gbuffer: GBuffer,
    x0: int,
    y: int,
    held: int,
    wanted: Ints,
    history: HistoryRun,
    steps: float,
    epsilon: float,
    relative: float,
):
    """A run's history, with ``fetch_earlier`` in those wanted lanes (1) that the last frame's buffer knows nothing of.

    One pixel at a time: few frames have many such pixels, and each finds its own texels.
    """
    rho = history.rho
    n = history.n
    rise = history.blocker_rise
    spread = history.spread
    of_mover = history.of_mover
    for k in range(held):
        if wanted[k] != 0 and n[k] <= 0.0 and of_mover[k] == 0 and (gbuffer.flags[y, x0 + k] & MOVES) == 0:
            record = fetch_earlier(
                earlier, gbuffer.position_ws[y, x0 + k], gbuffer.normal_ws[y, x0 + k], epsilon, relative, steps
            )
            if record.n > 0.0:
                rho[k] = record.rho
                n[k] = record.n
                rise[k] = record.blocker_rise
                spread[k] = record.spread
    out = HistoryRun()
    out.rho = rho
    out.n = n
    out.blocker_rise = rise
    out.of_mover = of_mover
    out.spread = spread
    return out

"""What the first hardware had to do wedges with: coverage from tables, and sums in 8 bits a channel.

Tables (Assarsson et al. 2003, section 6): angles of 128 directions for each face of a cube, 16 bit; sectors of 256 x
256 pairs of angles, 16 bit for a disc and 8 for a square. Of the cube only the row of texels in which its third
coordinate is 0 is ever read, and it is that which is kept here.

Sums (section 4.3): shares are added in one buffer and subtracted in another. ``split12`` has 12 bits, three in each of
four 8-bit channels, whose upper five hold the carry: exact up to 36 additions of the largest, as 36 x 7 < 256.
``lut10`` reads those 12 bits from a table of 1024 entries. ``bits6of8`` is the earlier single channel of 6 bits, with
2 for the overflow. What is beyond a channel's 8 bits is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import warp as wp

from wkernels.casters.wedges.bodies import WedgeEdges
from wkernels.casters.wedges.coverage import beyond, border_at
from wkernels.casters.wedges.light_shapes import DISC, LightShape, see_light
from wkernels.casters.wedges.near_lists import NearLists
from wkernels.casters.wedges.recounting import blur_of
from wkernels.casters.wedges.shading import UNTRUSTED, edge_on_light, is_at_centre, lit_share
from wkernels.raster.binning import tile_at
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import RECEIVES

CoverageRule = Literal["analytic", "table"]
BufferRule = Literal["f32", "split12", "lut10", "bits6of8"]
BUFFERS: dict[str, int] = {"f32": 0, "split12": 1, "lut10": 2, "bits6of8": 3}
DIRECTIONS = wp.constant(128)  # of a face of the cube
ANGLES = wp.constant(256)
F32, SPLIT12, LUT10, BITS6OF8 = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)
Channels = wp.types.vector(length=4, dtype=wp.int32)


@wp.struct
class Storage:
    """How shares are found and summed."""

    buffer: int
    angle: wp.array(dtype=float)  # (4 x DIRECTIONS,), turns in [0, 1): by way along the square's border; none: analytic
    sector: wp.array2d(dtype=float)  # (ANGLES, ANGLES), share of the light between two angles


@dataclass(frozen=True)
class StorageRule:
    """Which coverage and which buffer."""

    coverage: CoverageRule = "analytic"
    buffer: BufferRule = "f32"

    @property
    def is_plain(self) -> bool:
        """Whether this is the method itself."""
        return self.coverage == "analytic" and self.buffer == "f32"

    def to_device(self, shape: int, device: str) -> Storage:
        """The struct that kernels take, for a DISC or a SQUARE."""
        out = Storage()
        out.buffer = BUFFERS[self.buffer]
        if self.coverage == "table":
            out.angle = wp.array(angle_table(), dtype=float, device=device)
            out.sector = wp.array(sector_table(shape), dtype=float, device=device)
        return out


PLAIN = StorageRule()
"""The method itself."""


def _border(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of the square's border, by the way along it from (1, -1)."""
    side, along = np.divmod(way, 2.0)
    along = along - 1.0
    x = np.choose(side.astype(int) % 4, [np.ones_like(along), -along, -np.ones_like(along), along])
    y = np.choose(side.astype(int) % 4, [along, np.ones_like(along), -along, -np.ones_like(along)])
    return x, y


def angle_table() -> np.ndarray:
    """Turns [0, 1) of the middles of the cube's texels, 16 bit, (4 x 128,)."""
    count = 4 * int(DIRECTIONS)
    x, y = _border((np.arange(count) + 0.5) * 8.0 / count)
    turns = np.mod(np.arctan2(y, x) / (2.0 * np.pi), 1.0)
    return (np.round(turns * 65535.0) / 65535.0).astype(np.float32)


def sector_table(shape: int) -> np.ndarray:
    """Shares of a light in the lesser sector between two angles, (256, 256): of 16 bit for a disc, 8 for a square."""
    turns = (np.arange(int(ANGLES)) + 0.5) / int(ANGLES)
    if shape == int(DISC):
        at, whole, levels = turns, 1.0, 65535.0
    else:
        x, y = np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns)
        wide = np.abs(x) >= np.abs(y)
        ratio = np.where(wide, y, x) / np.where(wide, x, y)
        at = np.where(wide, np.where(x > 0.0, ratio, 4.0 + ratio), np.where(y > 0.0, 2.0 - ratio, 6.0 - ratio))
        whole, levels = 8.0, 255.0
    apart = np.abs(at[:, None] - at)
    share = np.minimum(apart, whole - apart) / whole
    return (np.round(share * levels) / levels).astype(np.float32)


@wp.func
def angle_index(storage: Storage, x: float, y: float):
    """The sector table's row for a direction, by way of the cube."""
    at = (border_at(x, y) + 1.0) * (0.125 * float(storage.angle.shape[0]))
    turns = storage.angle[wp.clamp(int(at), 0, storage.angle.shape[0] - 1)]
    return wp.clamp(int(turns * float(ANGLES)), 0, ANGLES - 1)


@wp.func
def stored_share(storage: Storage, shape: int, ends: wp.vec4):
    """``beyond`` as the tables have it, or itself."""
    share = beyond(shape, ends)
    if storage.angle.shape[0] > 0:
        cross = ends[0] * ends[3] - ends[1] * ends[2]
        sector = storage.sector[angle_index(storage, ends[0], ends[1]), angle_index(storage, ends[2], ends[3])]
        triangle = 0.125 * wp.abs(cross)
        if shape == DISC:
            triangle = wp.abs(cross) * 0.15915494309189535
        share = wp.clamp(sector - triangle, 0.0, 0.5)
        if cross < 0.0:
            share = -share
    return share


@wp.func
def stored_code(buffer: int, share: float):
    """The whole number that a buffer adds for a share >= 0."""
    code = int(0)
    if buffer == SPLIT12:
        code = int(share * 4095.0 + 0.5)
    elif buffer == LUT10:
        code = int(float(int(share * 1023.0 + 0.5)) * (4095.0 / 1023.0) + 0.5)
    else:
        code = int(share * 63.0 + 0.5)
    return code


@wp.func
def add_code(buffer: int, channels: Any, code: int):
    """A buffer's channels with one more number in them, each kept to 8 bits."""
    out = channels
    if buffer == BITS6OF8:
        out[0] = (out[0] + code) & 255
    else:
        for k in range(4):
            out[k] = (out[k] + ((code >> (3 * k)) & 7)) & 255
    return out


@wp.func
def stored_sum(buffer: int, channels: Any):
    """What a buffer's channels say."""
    total = float(channels[0]) / 63.0
    if buffer != BITS6OF8:
        total = float(channels[0] + 8 * channels[1] + 64 * channels[2] + 512 * channels[3]) / 4095.0
    return total


@wp.kernel
def shade_stored(
    first: int,
    gbuffer: GBuffer,
    light: LightShape,
    edges: WedgeEdges,
    near: NearLists,
    counts: wp.array2d(dtype=int),
    storage: Storage,
    visibility_out: wp.array2d(dtype=float),
):
    """``shading.shade`` with shares from tables, and summed in two buffers of few bits."""
    row, x = wp.tid()
    y = first + row
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        position_ws = gbuffer.position_ws[y, x]
        sight = see_light(light, position_ws)
        blur = blur_of(gbuffer.view, sight, gbuffer.depth[y, x], position_ws)
        total = float(0.0)
        added = Channels(0)
        taken = Channels(0)
        untrusted = int(0)
        tile = tile_at(near.lists, y, x)
        for i in range(near.lists.begin[tile], near.end[tile]):
            e = near.lists.shape[i]
            edge = edge_on_light(light, sight, edges, e)
            if edge.visible != 0:
                share = sight.turn * stored_share(storage, light.shape, edge.ends)
                untrusted += is_at_centre(edge, blur)
                if storage.buffer == F32:
                    total += edges.weight[e] * share
                else:
                    for _ in range(int(edges.weight[e])):
                        code = stored_code(storage.buffer, wp.abs(share))
                        if share > 0.0:
                            added = add_code(storage.buffer, added, code)
                        else:
                            taken = add_code(storage.buffer, taken, code)
        if storage.buffer != F32:
            total = stored_sum(storage.buffer, added) - stored_sum(storage.buffer, taken)
        visible = lit_share(light, sight, gbuffer, y, x, 1.0 - float(counts[y, x]) + total)
        if untrusted > 0:
            visible = UNTRUSTED
    visibility_out[y, x] = visible

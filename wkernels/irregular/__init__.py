"""The irregular z-buffer: hard shadows exactly at the eye's pixels (Aila and Laine 2004; Johnson et al. 2005).

A depth map samples the light's view where its texels happen to be. Here the receivers are the samples: every pixel is
projected into the light's view and sorted into the cells of a grid that is fitted to them, casters are drawn into all
cells that they touch, and each sample in such a cell is tested against the triangle itself. No depth is stored, nothing
is interpolated, and the size of the cells changes the cost but not the result.

- ``grid``: light coordinates of points, and the grids of the light's faces;
- ``samples``: pixels to samples, sorted by cell; chunks of the image count for themselves, so that the order of the
  samples does not depend on the number of threads;
- ``casters``: the cells that a triangle touches, and the triangles of each band of rows;
- ``occlusion``: the exact test, one pixel at a time;
- ``lanes``: the same on the CPU, a run of samples at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wkernels.geometry import Geometry
from wkernels.irregular.casters import bound_triangles, count_bands, list_bands
from wkernels.irregular.grid import LightFace, fit_grid, light_faces
from wkernels.irregular.lanes import LANES, PIECE, Ints, Piece, SampleRuns, test_band
from wkernels.irregular.occlusion import test_pixels
from wkernels.irregular.samples import PAD, count_rows, list_rows, place_pixels, sort_rows
from wkernels.launch import launch
from wkernels.light_views import scene_views
from wkernels.receiver_lanes import uses_lanes

if TYPE_CHECKING:
    from wkernels.frame import Session
    from wkernels.gbuffer import GBuffer

__all__ = ["find_hidden"]

CHUNKS = 32
BANDS = 64


def find_hidden(frame: Session, gbuffer: GBuffer, resolution: int, visibility_out: wp.array) -> None:
    """Hard visibility of the centre of the frame's light, 0 or 1, at every pixel.

    Args:
        frame: Scene, light and memory; it must have casters.
        gbuffer: The pixels.
        resolution: Cells per side of the grid of each of the light's faces, 1 to 8192.
        visibility_out: float32 (H, W), 1 where there is no receiver.
    """
    light_ws = frame.light.centre
    geometry = frame.geometry
    receivers = geometry.bounds(receivers=True)
    if receivers.empty:
        visibility_out.fill_(1.0)
        return
    views = scene_views(light_ws, receivers, geometry.bounds(casters=True), resolution)
    faces = light_faces(views, light_ws, resolution)
    height, width = visibility_out.shape
    place = frame.buffer("sample places", (height, width), wp.vec3)
    row_of_pixel = frame.buffer("sample rows", (height, width), wp.int32)
    with frame.timed("project pixels"):
        bounds = frame.buffer("sample bounds", (height, len(faces), 6), wp.float32)
        inputs = [gbuffer, wp.vec4(*light_ws), _upload(faces, frame.device)]
        frame.launch(place_pixels, height, inputs, [place, row_of_pixel, visibility_out, bounds])
        found = bounds.numpy()
        low, high = found[:, :, :3].min(axis=0), found[:, :, 3:].max(axis=0)
        used = [k for k in range(len(faces)) if low[k, 0] <= high[k, 0]]
        for k in used:
            fit_grid(faces[k], np.concatenate([low[k], high[k]]))
    if not used:
        return
    with frame.timed("sort pixels"):
        on_device = _upload(faces, frame.device)
        rows = len(faces) * resolution
        counts = frame.buffer("sample counts", (rows, CHUNKS), wp.int32)
        frame.launch(count_rows, CHUNKS, [on_device, place, row_of_pixel, CHUNKS], [row_of_pixel, counts])
        samples = _sort(frame, on_device, place, row_of_pixel, counts) if uses_lanes(frame.device) else None
    for k in used:
        face = faces[k]
        with frame.timed("bound casters"):
            box_rows, box_columns, begin, listed, shift = _list_casters(frame, geometry, face)
        with frame.timed("test casters"):
            if samples is not None:
                bands = len(begin) - 1
                runs = wp.array(
                    ptr=listed.ptr, dtype=Ints, shape=len(listed) - int(LANES) + 1, strides=(4,), device="cpu"
                )
                inputs = [_flat(geometry.points_ws), geometry.caster_indices, face, box_rows, box_columns, begin, runs]
                outputs = [visibility_out.flatten()]
                launch(
                    test_band,
                    bands,
                    [*inputs, shift, samples],
                    outputs,
                    device=frame.device,
                    threads=frame.threads,
                    tile=1,
                )
            else:
                inputs = [geometry.points_ws, geometry.caster_indices, face, box_rows, box_columns, begin, listed]
                outputs = [visibility_out]
                frame.launch(test_pixels, (height, width), [*inputs, shift, place, row_of_pixel], outputs)


def _sort(
    frame: Session, faces: wp.array, place: wp.array, row_of_pixel: wp.array, counts: wp.array
) -> SampleRuns:
    """Samples in the order of their cells, each row with its padding."""
    rows, pixels = counts.shape[0], place.size
    held = counts.numpy()
    begins = np.zeros(rows + 1, dtype=np.int64)
    begins[1:] = np.cumsum(held.sum(axis=1) + int(PAD))
    held[:] = begins[:-1, None] + np.cumsum(held, axis=1) - held
    room = pixels + rows * int(PAD)
    resolution = rows // len(faces)
    out = SampleRuns()
    out.row_begin = frame.buffer("sample row begin", (rows + 1,), wp.int32)
    out.row_begin.numpy()[:] = begins
    listed = frame.buffer("samples by row", (room,), wp.int32)
    frame.launch(list_rows, CHUNKS, [row_of_pixel, CHUNKS, counts], [listed])
    cells = frame.buffer("sample cell begin", (rows, resolution + 1), wp.int32)
    out.pixel = frame.buffer("sample pixels", (room,), wp.int32)
    u, v, out.height = (frame.buffer(f"sample {name}", (room,), wp.float32) for name in "uvh")
    frame.launch(sort_rows, rows, [faces, place.flatten(), out.row_begin, listed], [cells, out.pixel, u, v, out.height])
    out.u, out.v, out.h = (
        wp.array(ptr=a.ptr, dtype=Piece, shape=room - int(PIECE) + 1, strides=(4,), device="cpu")
        for a in (u, v, out.height)
    )
    out.cell_begin = cells.flatten()
    return out


def _flat(points: wp.array) -> wp.array:
    return wp.array(ptr=points.ptr, dtype=float, shape=3 * len(points), device="cpu")


def _list_casters(
    frame: Session, geometry: Geometry, face: LightFace
) -> tuple[wp.array, wp.array, wp.array, wp.array, int]:
    count = geometry.caster_triangles
    rows = frame.buffer("caster rows", (count,), wp.int32)
    columns = frame.buffer("caster columns", (count,), wp.int32)
    frame.launch(bound_triangles, count, [geometry.points_ws, geometry.caster_indices, face], [rows, columns])
    shift = max(0, int(np.ceil(np.log2(face.resolution / BANDS))))
    bands = -(-face.resolution // (1 << shift))
    counts = frame.buffer("band counts", (bands, CHUNKS), wp.int32)
    frame.launch(count_bands, CHUNKS, [rows, count, shift, CHUNKS], [counts])
    starts = _starts(counts.numpy())
    counts.assign(starts[:-1].reshape(bands, CHUNKS).astype(np.int32))
    begin = frame.buffer("band begin", (bands + 1,), wp.int32)
    begin.assign(starts[::CHUNKS].astype(np.int32))
    listed = frame.buffer("band list", (_room(int(starts[-1]) + int(LANES)),), wp.int32)
    frame.launch(list_bands, CHUNKS, [rows, count, shift, CHUNKS, counts], [listed])
    return rows, columns, begin, listed, shift


def _starts(counts: np.ndarray) -> np.ndarray:
    """Where each count's slots begin, and the end of all."""
    return np.concatenate([[0], np.cumsum(counts.ravel(), dtype=np.int64)])


def _room(count: int) -> int:
    """A size that few different counts need."""
    return 1 << max(10, int(count).bit_length())


def _upload(faces: list[LightFace], device: str) -> wp.array:
    return wp.array(faces, dtype=LightFace, device=device)

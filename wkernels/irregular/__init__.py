"""The irregular z-buffer: hard shadows exactly at the eye's pixels (Aila and Laine 2004; Johnson et al. 2005).

A depth map samples the light's view where its texels happen to be. Here the receivers are the samples: every pixel is
projected into the light's view and sorted into the cells of a grid that is fitted to them, casters are drawn into all
cells that they touch, and each sample in such a cell is tested against the triangle itself. No depth is stored, nothing
is interpolated, and the size of the cells changes the cost but not the result.

- ``grid``: light coordinates of points, and the grids of the light's faces;
- ``samples``: pixels to samples, sorted by cell; chunks of the image count for themselves, so that the order of the
  samples does not depend on the number of threads;
- ``casters``: the cells that a triangle touches, whether they hold a receiver, and the triangles of each band of rows;
- ``occlusion``: the exact test, one pixel at a time;
- ``pixel_lanes``, ``caster_lanes``, ``lanes``: projection, bounds and test on the CPU, many at a time. On the CPU each
  band is one thread's: it owns its rows' samples, and the pixels they came from. On CUDA each pixel goes through its
  band's triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wkernels.device.lanes import uses_lanes
from wkernels.device.launch import launch
from wkernels.irregular.caster_lanes import LANES as CASTER_LANES
from wkernels.irregular.caster_lanes import (
    Corners,
    Longs,
    Points,
    bound_triangles_lanes,
    place_vertices_lanes,
)
from wkernels.irregular.caster_lanes import Ints as CasterInts
from wkernels.irregular.casters import bound_triangles, count_bands, list_bands, place_vertices
from wkernels.irregular.grid import LightFace, fit_grid, light_faces
from wkernels.irregular.lanes import LANES, PIECE, Ints, Piece, SampleRuns, test_band
from wkernels.irregular.occlusion import test_pixels
from wkernels.irregular.pixel_lanes import LANES as PIXEL_LANES
from wkernels.irregular.pixel_lanes import Floats as PixelFloats
from wkernels.irregular.pixel_lanes import Ints as PixelInts
from wkernels.irregular.pixel_lanes import PixelRuns, PlaceRuns, place_pixels_lanes
from wkernels.irregular.pixel_lanes import Vectors as PixelVectors
from wkernels.irregular.samples import (
    PAD,
    Places,
    bound_pixels,
    count_before,
    count_rows,
    list_rows,
    place_pixels,
    sort_rows,
)
from wkernels.projections.light_views import scene_views

if TYPE_CHECKING:
    from wkernels.frame.session import Session
    from wkernels.raster.gbuffer import GBuffer

__all__ = ["find_hidden"]

CHUNKS = 32
BANDS = 64
GROUP = 16  # columns added up by one grid cell


def find_hidden(frame: Session, gbuffer: GBuffer, resolution: int, visibility_out: wp.array) -> None:
    """Hard visibility of the centre of the frame's light, 0 or 1, at every pixel.

    Args:
        frame: Scene, light and memory; it must have casters.
        gbuffer: The pixels.
        resolution: Cells per side of the grid of each of the light's faces, 1 to 4096.
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
    places = Places()
    places.u, places.v, places.h = (frame.buffer(f"pixel {name}", (height, width), wp.float32) for name in "uvh")
    row_of_pixel = frame.buffer("sample rows", (height, width), wp.int32)
    with frame.timed("project pixels"):
        bounds = frame.buffer("sample bounds", (height, len(faces), 6), wp.float32)
        inputs: list[Any] = [gbuffer, wp.vec4(*light_ws), _upload(faces, frame.device)]
        if uses_lanes(frame.device) and width >= int(PIXEL_LANES):
            inputs = [_pixel_runs(gbuffer), *inputs[1:]]
            outputs = [_place_runs(places, row_of_pixel, visibility_out)]
            frame.launch(place_pixels_lanes, height, inputs, [*outputs, bounds])
        else:
            frame.launch(place_pixels, (height, width), inputs, [places, row_of_pixel, visibility_out])
            frame.launch(bound_pixels, height, [places, row_of_pixel], [bounds])
        found = bounds.numpy()
        low, high = found[:, :, :3].min(axis=0), found[:, :, 3:].max(axis=0)
        used = [k for k in range(len(faces)) if low[k, 0] <= high[k, 0]]
        for k in used:
            fit_grid(faces[k], np.concatenate([low[k], high[k]]))
    if not used:
        return
    with frame.timed("sort pixels"):
        on_device = _upload(faces, frame.device)
        samples = _sort(frame, on_device, resolution, places, row_of_pixel)
    for k in used:
        with frame.timed("bound casters"):
            boxes = _bound_casters(frame, faces[k], samples)
            bands = _list_casters(frame, boxes, resolution)
        with frame.timed("test casters"):
            inputs = [faces[k], boxes.rows, boxes.columns, bands.begin]
            corners = geometry.caster_indices
            if uses_lanes(frame.device):
                runs = _view(bands.listed, Ints, len(bands.listed) - int(LANES) + 1, 4)
                inputs = [_view(geometry.points_ws, float, 3 * len(geometry.points_ws)), corners, *inputs, runs]
                inputs += [bands.shift, samples.runs]
                # bands have different loads, so threads take them one by one
                options: dict[str, Any] = {"device": frame.device, "threads": frame.threads, "tile": 1}
                launch(test_band, len(bands.begin) - 1, inputs, [visibility_out.flatten()], **options)
            else:
                inputs = [geometry.points_ws, corners, *inputs, bands.listed, bands.shift, places, row_of_pixel]
                frame.launch(test_pixels, (height, width), inputs, [visibility_out])


def _pixel_runs(gbuffer: GBuffer) -> PixelRuns:
    """A G-buffer as runs of pixels, one from every pixel on that has the others behind it."""
    out, count = PixelRuns(), gbuffer.flags.size - int(PIXEL_LANES) + 1
    out.flags = _view(gbuffer.flags, PixelInts, count, 4)
    out.depth = _view(gbuffer.depth, PixelFloats, count, 4)
    out.position_ws = _view(gbuffer.position_ws, PixelVectors, count, 12)
    out.normal_ws = _view(gbuffer.normal_ws, PixelVectors, count, 12)
    out.width = gbuffer.flags.shape[1]
    return out


def _place_runs(places: Places, face: wp.array, visibility: wp.array) -> PlaceRuns:
    out, count = PlaceRuns(), face.size - int(PIXEL_LANES) + 1
    out.u, out.v, out.h = (_view(array, PixelFloats, count, 4) for array in (places.u, places.v, places.h))
    out.face, out.visibility = _view(face, PixelInts, count, 4), _view(visibility, PixelFloats, count, 4)
    return out


@dataclass
class _Samples:
    runs: SampleRuns
    cell_begin: wp.array


@dataclass
class _Boxes:
    rows: wp.array
    columns: wp.array


@dataclass
class _Bands:
    begin: wp.array
    listed: wp.array
    shift: int


def _sort(frame: Session, faces: wp.array, resolution: int, places: Places, row_of_pixel: wp.array) -> _Samples:
    """Samples in the order of their cells, each row with its padding."""
    rows, pixels = len(faces) * resolution, row_of_pixel.size
    counts = frame.buffer("sample counts", (rows, CHUNKS), wp.int32)
    frame.launch(count_rows, CHUNKS, [faces, places, row_of_pixel, CHUNKS], [row_of_pixel, counts])
    held = counts.numpy()
    begins = np.zeros(rows + 1, dtype=np.int32)
    begins[1:] = np.cumsum(held.sum(axis=1) + int(PAD))
    counts.assign(begins[:-1, None] + np.cumsum(held, axis=1, dtype=np.int32) - held)
    room = pixels + rows * int(PAD)
    out = SampleRuns()
    out.row_begin = frame.buffer("sample row begin", (rows + 1,), wp.int32)
    out.row_begin.assign(begins)
    listed = frame.buffer("samples by row", (room,), wp.int32)
    frame.launch(list_rows, CHUNKS, [row_of_pixel, CHUNKS, counts], [listed])
    cells = frame.buffer("sample cell begin", (rows, resolution + 1), wp.int32)
    out.pixel = frame.buffer("sample pixels", (room,), wp.int32)
    u, v, out.height = (frame.buffer(f"sample {name}", (room,), wp.float32) for name in "uvh")
    inputs = [faces, *(a.flatten() for a in (places.u, places.v, places.h)), out.row_begin, listed]
    frame.launch(sort_rows, rows, inputs, [cells, out.pixel, u, v, out.height])
    if uses_lanes(frame.device):
        out.u, out.v, out.h = (_view(a, Piece, room - int(PIECE) + 1, 4) for a in (u, v, out.height))
    out.cell_begin = cells.flatten()
    return _Samples(out, cells)


def _bound_casters(frame: Session, face: LightFace, samples: _Samples) -> _Boxes:
    """The cells of every casting triangle."""
    geometry, side = frame.geometry, face.resolution + 1
    points, corners, count = geometry.points_ws, geometry.caster_indices, geometry.caster_triangles
    occupied = frame.buffer("samples before", (side, side), wp.int32)
    frame.launch(count_before, -(-side // GROUP), [samples.cell_begin, face.first_row, GROUP], [occupied])
    vertex = frame.buffer("caster vertices", (len(points),), wp.int64)
    out = _Boxes(*(frame.buffer(f"caster {name}", (count,), wp.int32) for name in ("rows", "columns")))
    if not uses_lanes(frame.device):
        frame.launch(place_vertices, len(points), [points, face], [vertex])
        frame.launch(bound_triangles, count, [vertex, corners, face, occupied], [out.rows, out.columns])
        return out
    lanes = int(CASTER_LANES)
    whole = len(points) // lanes
    inputs = [_view(points, Points, whole), points, face]
    frame.launch(place_vertices_lanes, -(-len(points) // lanes), inputs, [_view(vertex, Longs, whole), vertex])
    whole = count // lanes
    inputs = [vertex, _view(corners, Corners, whole), corners, face, occupied, occupied.flatten()]
    outputs = [_view(array, CasterInts, whole) for array in (out.rows, out.columns)]
    frame.launch(bound_triangles_lanes, -(-count // lanes), inputs, [*outputs, out.rows, out.columns])
    return out


def _list_casters(frame: Session, boxes: _Boxes, resolution: int) -> _Bands:
    """The triangles of every band of rows."""
    count = len(boxes.rows)
    shift = max(0, int(np.ceil(np.log2(resolution / BANDS))))
    bands = -(-resolution // (1 << shift))
    counts = frame.buffer("band counts", (bands, CHUNKS), wp.int32)
    frame.launch(count_bands, CHUNKS, [boxes.rows, count, shift, CHUNKS], [counts])
    starts = np.concatenate([[0], np.cumsum(counts.numpy().ravel(), dtype=np.int64)])
    counts.assign(starts[:-1].reshape(bands, CHUNKS).astype(np.int32))
    begin = frame.buffer("band begin", (bands + 1,), wp.int32)
    begin.assign(starts[::CHUNKS].astype(np.int32))
    # a power of two, so that few sizes are ever held
    listed = frame.buffer("band list", (1 << (int(starts[-1]) + int(LANES)).bit_length(),), wp.int32)
    frame.launch(list_bands, CHUNKS, [boxes.rows, count, shift, CHUNKS, counts], [listed])
    return _Bands(begin, listed, shift)


def _view(array: wp.array, dtype: type, count: int, stride: int | None = None) -> wp.array:
    """The memory of an array as another type, one after the other or ``stride`` bytes apart."""
    strides = None if stride is None else (stride,)
    return wp.array(ptr=array.ptr, dtype=dtype, shape=count, strides=strides, device="cpu")


def _upload(faces: list[LightFace], device: str) -> wp.array:
    return wp.array(faces, dtype=LightFace, device=device)

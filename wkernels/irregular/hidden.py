"""Hard visibility of every pixel by the irregular z-buffer: pixels to samples, casters to bands, and the test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wkernels.device.lanes import uses_lanes
from wkernels.device.launch import launch
from wkernels.irregular.caster_lanes import Corners, bound_triangles_lanes, place_vertices_lanes
from wkernels.irregular.casters import bound_triangles, count_bands, list_bands, place_vertices
from wkernels.irregular.grid import LightFace, fit_grid, light_faces
from wkernels.irregular.lanes import PIECE, Piece, SampleRuns, test_band
from wkernels.irregular.occlusion import test_pixels
from wkernels.irregular.pixel_lanes import PIXEL_LANES, PixelRuns, PlaceRuns, place_pixels_lanes
from wkernels.irregular.pixel_lanes import Floats as PixelFloats
from wkernels.irregular.pixel_lanes import Ints as PixelInts
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
from wkernels.raster.gbuffer import GBuffer
from wkernels.raster.lane_bands import BAND_LANES, Ints
from wkernels.raster.lane_culling import MESH_LANES, Longs, Points
from wkernels.raster.lane_culling import Ints as MeshInts
from wkernels.scene.geometry import Geometry
from wkernels.workspace.workspace import Workspace

CHUNKS = 32
BANDS = 64
GROUP = 16  # columns added up by one grid cell


def find_hidden(
    work: Workspace,
    geometry: Geometry,
    light_ws: np.ndarray,
    gbuffer: GBuffer,
    resolution: int,
    visibility_out: wp.array,
) -> None:
    """Hard visibility of a point of a light, 0 or 1, at every pixel.

    Args:
        work: Of the work.
        geometry: The scene; it must have casters.
        light_ws: The light sample (4,), rebased world.
        gbuffer: The pixels.
        resolution: Cells per side of the grid of each of the light's faces, 1 to 4096.
        visibility_out: float32 (H, W), 1 where there is no receiver.

    Raises:
        InputError: A caster is cut out by a texture.
    """
    geometry.require_whole("irregular z-buffers")
    receivers = geometry.bounds(receivers=True)
    if receivers.empty:
        visibility_out.fill_(1.0)
        return
    views = scene_views(light_ws, receivers, geometry.bounds(casters=True), resolution)
    faces = light_faces(views, light_ws, resolution)
    height, width = visibility_out.shape
    places = Places()
    places.u, places.v, places.h = (work.buffer(f"pixel {name}", (height, width), wp.float32) for name in "uvh")
    row_of_pixel = work.buffer("sample rows", (height, width), wp.int32)
    with work.timed("project pixels"):
        bounds = work.buffer("sample bounds", (height, len(faces), 6), wp.float32)
        inputs: list[Any] = [gbuffer, wp.vec4(*light_ws), _upload(faces, work.device)]
        if uses_lanes(work.device) and width >= int(PIXEL_LANES):
            inputs = [_pixel_runs(gbuffer), *inputs[1:]]
            outputs = [_place_runs(places, row_of_pixel, visibility_out)]
            work.launch(place_pixels_lanes, height, inputs, [*outputs, bounds])
        else:
            work.launch(place_pixels, (height, width), inputs, [places, row_of_pixel, visibility_out])
            work.launch(bound_pixels, height, [places, row_of_pixel], [bounds])
        found = bounds.numpy()
        low, high = found[:, :, :3].min(axis=0), found[:, :, 3:].max(axis=0)
        used = [k for k in range(len(faces)) if low[k, 0] <= high[k, 0]]
        for k in used:
            fit_grid(faces[k], np.concatenate([low[k], high[k]]))
    if not used:
        return
    with work.timed("sort pixels"):
        on_device = _upload(faces, work.device)
        samples = _sort(work, on_device, resolution, places, row_of_pixel)
    for k in used:
        with work.timed("bound casters"):
            boxes = _bound_casters(work, geometry, faces[k], samples)
            bands = _list_casters(work, boxes, resolution)
        with work.timed("test casters"):
            inputs = [faces[k], boxes.rows, boxes.columns, bands.begin]
            corners = geometry.caster_indices
            if uses_lanes(work.device):
                runs = _view(bands.listed, Ints, len(bands.listed) - int(BAND_LANES) + 1, 4)
                inputs = [_view(geometry.points_ws, float, 3 * len(geometry.points_ws)), corners, *inputs, runs]
                inputs += [bands.shift, samples.runs]
                # bands have different loads, so threads take them one by one
                options: dict[str, Any] = {"device": work.device, "threads": work.threads, "tile": 1}
                launch(test_band, len(bands.begin) - 1, inputs, [visibility_out.flatten()], **options)
            else:
                inputs = [geometry.points_ws, corners, *inputs, bands.listed, bands.shift, places, row_of_pixel]
                work.launch(test_pixels, (height, width), inputs, [visibility_out])


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


def _sort(work: Workspace, faces: wp.array, resolution: int, places: Places, row_of_pixel: wp.array) -> _Samples:
    """Samples in the order of their cells, each row with its padding."""
    rows, pixels = len(faces) * resolution, row_of_pixel.size
    counts = work.buffer("sample counts", (rows, CHUNKS), wp.int32)
    work.launch(count_rows, CHUNKS, [faces, places, row_of_pixel, CHUNKS], [row_of_pixel, counts])
    held = counts.numpy()
    begins = np.zeros(rows + 1, dtype=np.int32)
    begins[1:] = np.cumsum(held.sum(axis=1) + int(PAD))
    counts.assign(begins[:-1, None] + np.cumsum(held, axis=1, dtype=np.int32) - held)
    room = pixels + rows * int(PAD)
    out = SampleRuns()
    out.row_begin = work.buffer("sample row begin", (rows + 1,), wp.int32)
    out.row_begin.assign(begins)
    listed = work.buffer("samples by row", (room,), wp.int32)
    work.launch(list_rows, CHUNKS, [row_of_pixel, CHUNKS, counts], [listed])
    cells = work.buffer("sample cell begin", (rows, resolution + 1), wp.int32)
    out.pixel = work.buffer("sample pixels", (room,), wp.int32)
    u, v, out.height = (work.buffer(f"sample {name}", (room,), wp.float32) for name in "uvh")
    inputs = [faces, *(a.flatten() for a in (places.u, places.v, places.h)), out.row_begin, listed]
    work.launch(sort_rows, rows, inputs, [cells, out.pixel, u, v, out.height])
    if uses_lanes(work.device):
        out.u, out.v, out.h = (_view(a, Piece, room - int(PIECE) + 1, 4) for a in (u, v, out.height))
    out.cell_begin = cells.flatten()
    return _Samples(out, cells)


def _bound_casters(work: Workspace, geometry: Geometry, face: LightFace, samples: _Samples) -> _Boxes:
    """The cells of every casting triangle."""
    side = face.resolution + 1
    points, corners, count = geometry.points_ws, geometry.caster_indices, geometry.caster_triangles
    occupied = work.buffer("samples before", (side, side), wp.int32)
    work.launch(count_before, -(-side // GROUP), [samples.cell_begin, face.first_row, GROUP], [occupied])
    vertex = work.buffer("caster vertices", (len(points),), wp.int64)
    out = _Boxes(*(work.buffer(f"caster {name}", (count,), wp.int32) for name in ("rows", "columns")))
    if not uses_lanes(work.device):
        work.launch(place_vertices, len(points), [points, face], [vertex])
        work.launch(bound_triangles, count, [vertex, corners, face, occupied], [out.rows, out.columns])
        return out
    lanes = int(MESH_LANES)
    whole = len(points) // lanes
    inputs = [_view(points, Points, whole), points, face]
    work.launch(place_vertices_lanes, -(-len(points) // lanes), inputs, [_view(vertex, Longs, whole), vertex])
    whole = count // lanes
    inputs = [vertex, _view(corners, Corners, whole), corners, face, occupied, occupied.flatten()]
    outputs = [_view(array, MeshInts, whole) for array in (out.rows, out.columns)]
    work.launch(bound_triangles_lanes, -(-count // lanes), inputs, [*outputs, out.rows, out.columns])
    return out


def _list_casters(work: Workspace, boxes: _Boxes, resolution: int) -> _Bands:
    """The triangles of every band of rows."""
    count = len(boxes.rows)
    shift = max(0, int(np.ceil(np.log2(resolution / BANDS))))
    bands = -(-resolution // (1 << shift))
    counts = work.buffer("band counts", (bands, CHUNKS), wp.int32)
    work.launch(count_bands, CHUNKS, [boxes.rows, count, shift, CHUNKS], [counts])
    starts = np.concatenate([[0], np.cumsum(counts.numpy().ravel(), dtype=np.int64)])
    counts.assign(starts[:-1].reshape(bands, CHUNKS).astype(np.int32))
    begin = work.buffer("band begin", (bands + 1,), wp.int32)
    begin.assign(starts[::CHUNKS].astype(np.int32))
    # a power of two, so that few sizes are ever held
    listed = work.buffer("band list", (1 << (int(starts[-1]) + int(BAND_LANES)).bit_length(),), wp.int32)
    work.launch(list_bands, CHUNKS, [boxes.rows, count, shift, CHUNKS, counts], [listed])
    return _Bands(begin, listed, shift)


def _view(array: wp.array, dtype: type, count: int, stride: int | None = None) -> wp.array:
    """The memory of an array as another type, one after the other or ``stride`` bytes apart."""
    strides = None if stride is None else (stride,)
    return wp.array(ptr=array.ptr, dtype=dtype, shape=count, strides=strides, device="cpu")


def _upload(faces: list[LightFace], device: str) -> wp.array:
    return wp.array(faces, dtype=LightFace, device=device)

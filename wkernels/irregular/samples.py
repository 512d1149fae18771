"""Receivers as samples: the eye's pixels in light coordinates, sorted by the cells of the light's grids."""

from __future__ import annotations

import warp as wp

from wkernels.irregular.grid import LightFace, column_of, row_of, to_face
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.rays.single_rays import ray_origin
from wkernels.scene.geometry import RECEIVES

NO_ROW = wp.constant(-1)
PAD = wp.constant(16)  # room behind each row, so that a run of samples that starts in it ends in it
HIDDEN = wp.constant(3.0e38)  # height of a sample that something was found to hide, above everything


@wp.struct
class Places:
    """Light coordinates of every pixel, (H, W)."""

    u: wp.array2d(dtype=float)
    v: wp.array2d(dtype=float)
    h: wp.array2d(dtype=float)


@wp.kernel
def place_pixels(
    first: int,
    gbuffer: GBuffer,
    light_ws: wp.vec4,
    faces: wp.array(dtype=LightFace),
    places: Places,
    face_out: wp.array2d(dtype=int),  # NO_ROW where a pixel needs no test
    visibility_out: wp.array2d(dtype=float),
):
    """Light coordinates of the pixels, lifted off their surface as shadow rays start.

    Pixels without a receiver are lit and back-lit ones dark; the others wait for ``face_out``'s grid.
    """
    row, x = wp.tid()
    y = first + row
    own = int(NO_ROW)
    visible = float(1.0)
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        if is_back_lit(gbuffer, y, x, to_light(light_ws, gbuffer.position_ws[y, x])):
            visible = 0.0
        else:
            origin = ray_origin(gbuffer, y, x)
            at = wp.vec4d()
            for f in range(faces.shape[0]):
                # of the six faces of a cube the point is on the one that has it deepest
                here = to_face(faces[f], origin)
                if here[2] > at[2]:
                    at = here
                    own = f
            if own != NO_ROW:
                places.u[y, x] = float(at[0] / at[2])
                places.v[y, x] = float(at[1] / at[2])
                places.h[y, x] = float(at[3] / at[2])
    face_out[y, x] = own
    visibility_out[y, x] = visible


@wp.kernel
def bound_pixels(first: int, places: Places, face_of: wp.array2d(dtype=int), bounds_out: wp.array3d(dtype=float)):
    """Least u, v, h and largest u, v, h of the pixels of a row on each face, (H, faces, 6)."""
    y = first + wp.tid()
    for f in range(bounds_out.shape[1]):
        low = wp.vec3(wp.inf, wp.inf, wp.inf)
        high = -low
        for x in range(face_of.shape[1]):
            if face_of[y, x] == f:
                at = wp.vec3(places.u[y, x], places.v[y, x], places.h[y, x])
                low = wp.min(low, at)
                high = wp.max(high, at)
        for i in range(3):
            bounds_out[y, f, i] = low[i]
            bounds_out[y, f, 3 + i] = high[i]


@wp.kernel
def count_rows(
    first: int,
    faces: wp.array(dtype=LightFace),
    places: Places,
    face_of: wp.array2d(dtype=int),
    chunks: int,
    row_out: wp.array2d(dtype=int),
    counts_out: wp.array2d(dtype=int),  # (rows, chunks)
):
    """The grid row of every pixel, and how many pixels of each chunk of image rows fall into it."""
    chunk = first + wp.tid()
    for row in range(counts_out.shape[0]):
        counts_out[row, chunk] = 0
    height = face_of.shape[0]
    for y in range(height * chunk / chunks, height * (chunk + 1) / chunks):
        for x in range(face_of.shape[1]):
            f = face_of[y, x]
            row = int(NO_ROW)
            if f != NO_ROW:
                row = faces[f].first_row + row_of(faces[f], places.v[y, x])
                counts_out[row, chunk] += 1
            row_out[y, x] = row


@wp.kernel
def list_rows(
    first: int,
    row_of_pixel: wp.array2d(dtype=int),
    chunks: int,
    next_slot: wp.array2d(dtype=int),  # (rows, chunks), advanced
    pixel_out: wp.array(dtype=int),
):
    """Writes the pixels of one chunk behind those of the chunks before it, row by row of the grid."""
    chunk = first + wp.tid()
    height = row_of_pixel.shape[0]
    width = row_of_pixel.shape[1]
    for y in range(height * chunk / chunks, height * (chunk + 1) / chunks):
        for x in range(width):
            row = row_of_pixel[y, x]
            if row != NO_ROW:
                slot = next_slot[row, chunk]
                next_slot[row, chunk] = slot + 1
                pixel_out[slot] = y * width + x


@wp.kernel
def sort_rows(
    first: int,
    faces: wp.array(dtype=LightFace),
    u: wp.array(dtype=float),  # of pixels, (H W,)
    v: wp.array(dtype=float),
    h: wp.array(dtype=float),
    row_begin: wp.array(dtype=int),
    listed: wp.array(dtype=int),
    cell_begin_out: wp.array2d(dtype=int),  # (rows, R + 1)
    pixel_out: wp.array(dtype=int),
    u_out: wp.array(dtype=float),
    v_out: wp.array(dtype=float),
    h_out: wp.array(dtype=float),
):
    """Sorts the samples of one row of the grid by column; where each column begins, and the end."""
    row = first + wp.tid()
    face = faces[row / faces[0].resolution]
    columns = face.resolution
    begin = row_begin[row]
    end = row_begin[row + 1] - PAD
    for column in range(columns + 1):
        cell_begin_out[row, column] = 0
    for i in range(begin, end):
        # one further on, so that adding up leaves each column's begin
        cell_begin_out[row, column_of(face, u[listed[i]]) + 1] += 1
    cell_begin_out[row, 0] = begin
    for column in range(columns):
        cell_begin_out[row, column + 1] += cell_begin_out[row, column]
    for i in range(begin, end):
        pixel = listed[i]
        column = column_of(face, u[pixel])
        slot = cell_begin_out[row, column]
        cell_begin_out[row, column] = slot + 1
        pixel_out[slot] = pixel
        u_out[slot] = u[pixel]
        v_out[slot] = v[pixel]
        h_out[slot] = h[pixel]
    for i in range(columns):  # each now holds its end, which is the next one's begin
        column = columns - i
        cell_begin_out[row, column] = cell_begin_out[row, column - 1]
    cell_begin_out[row, 0] = begin
    for i in range(end, end + PAD):
        u_out[i] = 0.0
        v_out[i] = 0.0
        h_out[i] = HIDDEN


@wp.kernel
def count_before(
    first: int, cell_begin: wp.array2d(dtype=int), first_row: int, group: int, occupied_out: wp.array2d(dtype=int)
):
    """Samples of a face in the cells before each row and column, (R + 1, R + 1), for a group of columns."""
    begin = (first + wp.tid()) * group
    end = wp.min(begin + group, occupied_out.shape[1])
    for column in range(begin, end):
        occupied_out[0, column] = 0
    for row in range(occupied_out.shape[0] - 1):
        row_begin = cell_begin[first_row + row, 0]
        for column in range(begin, end):
            occupied_out[row + 1, column] = occupied_out[row, column] + cell_begin[first_row + row, column] - row_begin

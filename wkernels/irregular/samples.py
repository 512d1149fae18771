"""Receivers as samples: the eye's pixels in light coordinates, sorted by the cells of the light's grids."""

from __future__ import annotations

import warp as wp

from wkernels.gbuffer import GBuffer, is_back_lit
from wkernels.geometry import RECEIVES
from wkernels.irregular.grid import LightFace, column_of, row_of, to_face
from wkernels.light_map import to_light
from wkernels.rays import ray_origin

NO_ROW = wp.constant(-1)
PAD = wp.constant(16)  # room behind each row, so that a run of samples that starts in it ends in it
HIDDEN = wp.constant(3.0e38)  # height of a sample that something was found to hide, above everything


@wp.kernel
def place_pixels(
    first: int,
    gbuffer: GBuffer,
    light_ws: wp.vec4,
    faces: wp.array(dtype=LightFace),
    place_out: wp.array2d(dtype=wp.vec3),  # u, v, h
    face_out: wp.array2d(dtype=int),  # NO_ROW where a pixel needs no test
    visibility_out: wp.array2d(dtype=float),
    bounds_out: wp.array3d(dtype=float),  # (H, faces, 6): least u, v, h, largest u, v, h
):
    """Light coordinates of the pixels of a row, lifted off their surface as shadow rays start, and their bounds.

    Pixels without a receiver are lit and back-lit ones dark; the others wait for ``face_out``'s grid.
    """
    y = first + wp.tid()
    for f in range(faces.shape[0]):
        for i in range(3):
            bounds_out[y, f, i] = wp.inf
            bounds_out[y, f, 3 + i] = -wp.inf
    for x in range(gbuffer.flags.shape[1]):
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
                    u = float(at[0] / at[2])
                    v = float(at[1] / at[2])
                    h = float(at[3] / at[2])
                    place_out[y, x] = wp.vec3(u, v, h)
                    bounds_out[y, own, 0] = wp.min(bounds_out[y, own, 0], u)
                    bounds_out[y, own, 1] = wp.min(bounds_out[y, own, 1], v)
                    bounds_out[y, own, 2] = wp.min(bounds_out[y, own, 2], h)
                    bounds_out[y, own, 3] = wp.max(bounds_out[y, own, 3], u)
                    bounds_out[y, own, 4] = wp.max(bounds_out[y, own, 4], v)
                    bounds_out[y, own, 5] = wp.max(bounds_out[y, own, 5], h)
        face_out[y, x] = own
        visibility_out[y, x] = visible


@wp.kernel
def count_rows(
    first: int,
    faces: wp.array(dtype=LightFace),
    place: wp.array2d(dtype=wp.vec3),
    face_of: wp.array2d(dtype=int),
    chunks: int,
    row_out: wp.array2d(dtype=int),
    counts_out: wp.array2d(dtype=int),  # (rows, chunks)
):
    """The grid row of every pixel, and how many pixels of each chunk of image rows fall into it."""
    chunk = first + wp.tid()
    for row in range(counts_out.shape[0]):
        counts_out[row, chunk] = 0
    height = place.shape[0]
    for y in range(height * chunk / chunks, height * (chunk + 1) / chunks):
        for x in range(place.shape[1]):
            f = face_of[y, x]
            row = int(NO_ROW)
            if f != NO_ROW:
                row = faces[f].first_row + row_of(faces[f], place[y, x][1])
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
    place: wp.array(dtype=wp.vec3),  # (H W,)
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
        cell_begin_out[row, column_of(face, place[listed[i]][0]) + 1] += 1
    cell_begin_out[row, 0] = begin
    for column in range(columns):
        cell_begin_out[row, column + 1] += cell_begin_out[row, column]
    for i in range(begin, end):
        at = place[listed[i]]
        column = column_of(face, at[0])
        slot = cell_begin_out[row, column]
        cell_begin_out[row, column] = slot + 1
        pixel_out[slot] = listed[i]
        u_out[slot] = at[0]
        v_out[slot] = at[1]
        h_out[slot] = at[2]
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
            occupied_out[row + 1, column] = (
                occupied_out[row, column] + cell_begin[first_row + row, column] - row_begin
            )

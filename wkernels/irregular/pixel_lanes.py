"""``samples.place_pixels`` and ``bound_pixels`` on the CPU: a row of the image, 64 pixels at a time."""

from __future__ import annotations

import warp as wp

from wkernels.irregular.grid import LightFace
from wkernels.irregular.samples import NO_ROW
from wkernels.rays.single_rays import ORIGIN_ERROR
from wkernels.scene.geometry import CASTS, RECEIVES

PIXEL_LANES = wp.constant(64)  # pixels placed in one step
Ints = wp.types.vector(length=PIXEL_LANES, dtype=wp.int32)
Floats = wp.types.vector(length=PIXEL_LANES, dtype=wp.float32)
Doubles = wp.types.vector(length=PIXEL_LANES, dtype=wp.float64)
Vectors = wp.types.vector(length=3 * PIXEL_LANES, dtype=wp.float32)


@wp.struct
class PixelRuns:
    """A G-buffer at least a run wide, a run of pixels from every pixel on."""

    width: int
    flags: wp.array(dtype=Ints)
    depth: wp.array(dtype=Floats)
    position_ws: wp.array(dtype=Vectors)
    normal_ws: wp.array(dtype=Vectors)


@wp.struct
class PlaceRuns:
    """What is known of the pixels, likewise."""

    u: wp.array(dtype=Floats)
    v: wp.array(dtype=Floats)
    h: wp.array(dtype=Floats)
    face: wp.array(dtype=Ints)
    visibility: wp.array(dtype=Floats)


@wp.kernel
def place_pixels_lanes(
    first: int,
    pixels: PixelRuns,
    light_ws: wp.vec4,
    faces: wp.array(dtype=LightFace),
    places: PlaceRuns,
    bounds_out: wp.array3d(dtype=float),  # (H, faces, 6)
):
    """Both for one row; its last run begins so early that it ends with the row."""
    y = first + wp.tid()
    row_begin = y * pixels.width
    last = pixels.width - PIXEL_LANES
    light_x, light_y, light_z, light_w = light_ws[0], light_ws[1], light_ws[2], light_ws[3]
    one = wp.float64(1.0)
    for x0 in range(0, pixels.width, PIXEL_LANES):
        at = row_begin + wp.min(x0, last)
        flags = pixels.flags[at]
        depth = pixels.depth[at]
        position = pixels.position_ws[at]
        normal = pixels.normal_ws[at]
        origin_x = Doubles()
        origin_y = Doubles()
        origin_z = Doubles()
        wanted = Ints(0)
        visible = Floats(0.0)
        for k in range(PIXEL_LANES):
            px = position[3 * k]
            py = position[3 * k + 1]
            pz = position[3 * k + 2]
            nx = normal[3 * k]
            ny = normal[3 * k + 1]
            nz = normal[3 * k + 2]
            facing = nx * (light_x - px * light_w) + ny * (light_y - py * light_w) + nz * (light_z - pz * light_w)
            receives = wp.where((flags[k] & RECEIVES) != 0, 1, 0)
            back_lit = wp.where((flags[k] & CASTS) != 0, wp.where(facing <= 0.0, receives, 0), 0)
            size = wp.max(wp.max(wp.abs(px), wp.abs(py)), wp.max(wp.abs(pz), wp.abs(depth[k])))
            lift = ORIGIN_ERROR * wp.where(receives == 1, size, 0.0)
            origin_x[k] = wp.float64(px + nx * lift)
            origin_y[k] = wp.float64(py + ny * lift)
            origin_z[k] = wp.float64(pz + nz * lift)
            wanted[k] = receives - back_lit
            visible[k] = float(1 - back_lit)
        places.visibility[at] = visible
        us = Floats(0.0)
        vs = Floats(0.0)
        hs = Floats(0.0)
        deepest = Doubles()
        own = Ints(NO_ROW)
        for f in range(faces.shape[0]):
            face = faces[f]
            face_x, face_y, face_z = face.origin_ws[0], face.origin_ws[1], face.origin_ws[2]
            right_x, right_y, right_z = face.right_ws[0], face.right_ws[1], face.right_ws[2]
            up_x, up_y, up_z = face.up_ws[0], face.up_ws[1], face.up_ws[2]
            forward_x, forward_y, forward_z = face.forward_ws[0], face.forward_ws[1], face.forward_ws[2]
            in_perspective = face.perspective != 0
            for k in range(PIXEL_LANES):
                wx = origin_x[k] - face_x
                wy = origin_y[k] - face_y
                wz = origin_z[k] - face_z
                x = right_x * wx + right_y * wy + right_z * wz
                y_ls = up_x * wx + up_y * wy + up_z * wz
                z = forward_x * wx + forward_y * wy + forward_z * wz
                w = wp.where(in_perspective, z, one)
                height = wp.where(in_perspective, one, -z)
                deeper = wp.where(wanted[k] == 1, wp.where(w > deepest[k], 1, 0), 0)
                over_w = one / wp.where(deeper == 1, w, one)
                us[k] = wp.where(deeper == 1, float(x * over_w), us[k])
                vs[k] = wp.where(deeper == 1, float(y_ls * over_w), vs[k])
                hs[k] = wp.where(deeper == 1, float(height * over_w), hs[k])
                deepest[k] = wp.where(deeper == 1, w, deepest[k])
                own[k] = wp.where(deeper == 1, f, own[k])
        places.u[at] = us
        places.v[at] = vs
        places.h[at] = hs
        places.face[at] = own
    for f in range(faces.shape[0]):
        low_u = Floats(wp.inf)
        low_v = Floats(wp.inf)
        low_h = Floats(wp.inf)
        high_u = Floats(-wp.inf)
        high_v = Floats(-wp.inf)
        high_h = Floats(-wp.inf)
        for x0 in range(0, pixels.width, PIXEL_LANES):
            at = row_begin + wp.min(x0, last)
            own = places.face[at]
            us = places.u[at]
            vs = places.v[at]
            hs = places.h[at]
            for k in range(PIXEL_LANES):
                here = own[k] == f
                low_u[k] = wp.min(low_u[k], wp.where(here, us[k], wp.inf))
                low_v[k] = wp.min(low_v[k], wp.where(here, vs[k], wp.inf))
                low_h[k] = wp.min(low_h[k], wp.where(here, hs[k], wp.inf))
                high_u[k] = wp.max(high_u[k], wp.where(here, us[k], -wp.inf))
                high_v[k] = wp.max(high_v[k], wp.where(here, vs[k], -wp.inf))
                high_h[k] = wp.max(high_h[k], wp.where(here, hs[k], -wp.inf))
        bounds_out[y, f, 0] = wp.min(low_u)
        bounds_out[y, f, 1] = wp.min(low_v)
        bounds_out[y, f, 2] = wp.min(low_h)
        bounds_out[y, f, 3] = wp.max(high_u)
        bounds_out[y, f, 4] = wp.max(high_v)
        bounds_out[y, f, 5] = wp.max(high_h)

"""The irregular buffer's kernels against NumPy, and the lane kernels against the plain ones."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small
import warp as wp

from wkernels.device.lanes import uses_lanes
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.irregular import hidden
from wkernels.irregular.casters import NO_ROWS, count_bands, list_bands
from wkernels.irregular.grid import LightFace, fit_grid, light_faces
from wkernels.irregular.samples import PAD, Places, count_before, count_rows, list_rows, sort_rows
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import CASTS, RECEIVES, Geometry
from wkernels.scene.lights import Light, PointLight

LIGHTS: dict[str, Light] = {
    "directional": small.light("directional"),
    "point outside": small.light("point"),
    "point inside": PointLight(position=np.array([0.2, 3.2, 1.5])),
}
CHUNKS = 5


def faces_of(count: int, resolution: int) -> list[LightFace]:
    """Faces with grids over [-1, 1]^2."""
    box = small.cluttered(LIGHTS["point inside"])
    bounds = Geometry(box).bounds(receivers=True, casters=True)
    views = scene_views(np.array([0.0, 0.0, 0.0, 1.0]), bounds, bounds, resolution)
    assert len(views) == 6
    faces = light_faces(views[:count], np.array([0.0, 0.0, 0.0, 1.0]), resolution)
    for face in faces:
        fit_grid(face, np.array([-1.0, -1.0, 0.1, 1.0, 1.0, 5.0], dtype=np.float32))
    return faces


@pytest.mark.parametrize("resolution", [1, 7, 64])
def test_samples_are_sorted_by_cell_and_keep_their_order(resolution: int, device: str) -> None:
    rng = np.random.default_rng(2)
    shape, count = (23, 31), 2
    u, v, h = rng.uniform(-1.0, 1.0, (3, *shape)).astype(np.float32)
    u[0, 0], v[0, 0], u[1, 1], v[1, 1] = -1.0, -1.0, 1.0, 1.0  # corners of the grid
    face = rng.integers(-1, count, shape).astype(np.int32)
    places = Places()
    places.u, places.v, places.h = (wp.array(a, dtype=float, device=device) for a in (u, v, h))
    on_device = wp.array(faces_of(count, resolution), dtype=LightFace, device=device)
    row_of_pixel = wp.array(face, dtype=int, device=device)
    rows = count * resolution
    counts = wp.empty((rows, CHUNKS), dtype=int, device=device)
    launch(count_rows, CHUNKS, [on_device, places, row_of_pixel, CHUNKS], [row_of_pixel, counts], device=device)
    row = np.clip(((v + 1.0) * (resolution / 2.0)).astype(int), 0, resolution - 1) + face * resolution
    row[face < 0] = -1
    np.testing.assert_array_equal(row_of_pixel.numpy(), row)
    held = counts.numpy()
    np.testing.assert_array_equal(held.sum(axis=1), np.bincount(row[row >= 0], minlength=rows))

    begins = np.concatenate([[0], np.cumsum(held.sum(axis=1) + int(PAD))]).astype(np.int32)
    slots = wp.array(begins[:-1, None] + np.cumsum(held, axis=1) - held, dtype=int, device=device)
    room = int(begins[-1])
    listed, pixel = (wp.full(room, -1, dtype=int, device=device) for _ in range(2))
    launch(list_rows, CHUNKS, [row_of_pixel, CHUNKS, slots], [listed], device=device)
    out = [wp.full(room, np.nan, dtype=float, device=device) for _ in range(3)]
    cells = wp.empty((rows, resolution + 1), dtype=int, device=device)
    flat = [a.flatten() for a in (places.u, places.v, places.h)]
    row_begin = wp.array(begins, dtype=int, device=device)
    launch(sort_rows, rows, [on_device, *flat, row_begin, listed], [cells, pixel, *out], device=device)
    column = np.clip(((u + 1.0) * (resolution / 2.0)).astype(int), 0, resolution - 1).ravel()
    flat_row = row.ravel()
    for r in range(rows):
        here = np.flatnonzero(flat_row == r)
        expected = here[np.argsort(column[here], kind="stable")]
        begin, end = begins[r], begins[r] + len(here)
        np.testing.assert_array_equal(pixel.numpy()[begin:end], expected)
        for plane, want in zip(out, (u, v, h), strict=True):
            np.testing.assert_array_equal(plane.numpy()[begin:end], want.ravel()[expected])
        want_begin = begin + np.searchsorted(np.sort(column[here]), np.arange(resolution + 1))
        np.testing.assert_array_equal(cells.numpy()[r], want_begin)
        assert np.isfinite(out[2].numpy()[end : begins[r + 1]]).all()  # padding is above everything
        assert (out[2].numpy()[end : begins[r + 1]] >= 1e38).all()

    before = wp.empty((resolution + 1, resolution + 1), dtype=int, device=device)
    for f in range(count):
        launch(count_before, -(-(resolution + 1) // 3), [cells, f * resolution, 3], [before], device=device)
        in_cells = np.zeros((resolution, resolution), int)
        mine = (face == f).ravel()
        np.add.at(in_cells, (flat_row[mine] - f * resolution, column[mine]), 1)
        np.testing.assert_array_equal(before.numpy()[1:, 1:], in_cells.cumsum(0).cumsum(1))
        assert not before.numpy()[0].any() and not before.numpy()[:, 0].any()


@pytest.mark.parametrize("shift", [0, 2])
def test_bands_list_their_triangles_in_order(shift: int, device: str) -> None:
    rng = np.random.default_rng(5)
    first = rng.integers(0, 16, 200)
    last = np.minimum(first + rng.integers(0, 9, 200), 15)
    packed = (first | (last << 16)).astype(np.int32)
    packed[rng.random(200) < 0.3] = int(NO_ROWS)
    rows = wp.array(packed, dtype=int, device=device)
    bands = 16 >> shift
    counts = wp.empty((bands, CHUNKS), dtype=int, device=device)
    launch(count_bands, CHUNKS, [rows, 200, shift, CHUNKS], [counts], device=device)
    starts = np.concatenate([[0], np.cumsum(counts.numpy().ravel())])
    slots = wp.array(starts[:-1].reshape(bands, CHUNKS), dtype=int, device=device)
    listed = wp.full(int(starts[-1]), -1, dtype=int, device=device)
    launch(list_bands, CHUNKS, [rows, 200, shift, CHUNKS, slots], [listed], device=device)
    for band in range(bands):
        inside = (packed != int(NO_ROWS)) & (first >> shift <= band) & (last >> shift >= band)
        found = listed.numpy()[starts[band * CHUNKS] : starts[(band + 1) * CHUNKS]]
        np.testing.assert_array_equal(found, np.flatnonzero(inside))


def buffers(light: str, device: str, lanes: bool, monkeypatch: pytest.MonkeyPatch) -> dict[str, np.ndarray]:
    """What a run leaves in the session's memory, by name, at a width that no run divides."""
    monkeypatch.setattr(hidden, "uses_lanes", lambda device: lanes)
    session = Session(Geometry(small.cluttered(LIGHTS[light]), device), width=100, height=60, device=device)
    visibility = wp.empty((60, 100), dtype=float, device=device)
    hidden.find_hidden(session, session.geometry, session.light.centre, session.gbuffer(), 32, visibility)
    found = {key[0]: array.numpy().copy() for key, array in session._buffers.items()}
    return {**found, "visibility": visibility.numpy()}


@pytest.mark.parametrize("light", LIGHTS)
def test_lanes_place_and_bound_as_the_plain_kernels_do(
    light: str, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not uses_lanes(device):
        pytest.skip("lane kernels run on the CPU only")
    plain, lanes = (buffers(light, device, by_lanes, monkeypatch) for by_lanes in (False, True))
    tested = plain["sample rows"] >= 0
    np.testing.assert_array_equal(lanes["sample rows"] >= 0, tested)
    assert tested.mean() > 0.3
    for name in ("pixel u", "pixel v", "pixel h"):
        # the origin is a float32 whose last bit depends on whether a product was fused with a sum
        np.testing.assert_allclose(lanes[name][tested], plain[name][tested], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(lanes["sample bounds"], plain["sample bounds"], rtol=1e-5, atol=1e-5)
    same = (lanes["caster rows"] == plain["caster rows"]) & (lanes["caster columns"] == plain["caster columns"])
    assert same.mean() > 0.97  # a bound on a cell's border may fall to either side of it
    assert (plain["caster rows"] != int(NO_ROWS)).mean() > 0.2


@pytest.mark.parametrize("light", LIGHTS)
def test_places_are_those_of_numpy(light: str, device: str) -> None:
    scene = small.cluttered(LIGHTS[light])
    geometry = Geometry(scene, device)
    session = Session(geometry, width=100, height=60, device=device)
    gbuffer = session.gbuffer()
    hidden.find_hidden(
        session, geometry, session.light.centre, gbuffer, 32, wp.empty((60, 100), dtype=float, device=device)
    )
    held = {key[0]: array.numpy() for key, array in session._buffers.items()}
    at, normal = gbuffer.position_ws.numpy().astype(float), gbuffer.normal_ws.numpy().astype(float)
    towards = session.light.centre[:3] - at * session.light.centre[3]
    flags = gbuffer.flags.numpy()
    back_lit = ((flags & int(CASTS)) != 0) & (np.einsum("yxi,yxi->yx", normal, towards) <= 0.0)
    tested = ((flags & int(RECEIVES)) != 0) & ~back_lit
    assert ((held["sample rows"] >= 0) == tested).mean() > 0.999  # facing is rounded to float32
    tested &= held["sample rows"] >= 0
    views = scene_views(session.light.centre, geometry.bounds(receivers=True), geometry.bounds(casters=True), 32)
    view_of = held["sample rows"] // 32
    for k, view in enumerate(views):
        mine = tested & (view_of == k)
        way = at[mine] - (view.eye_ws if view.perspective else 0.0)
        x, y, z = way @ view.right_ws, way @ view.up_ws, way @ view.forward_ws
        expected = (x / z, y / z, 1.0 / z) if view.perspective else (x, y, -z)
        for name, want in zip(("pixel u", "pixel v", "pixel h"), expected, strict=True):
            np.testing.assert_allclose(held[name][mine], want, rtol=1e-3, atol=1e-3)  # the lift is 4e-6 of 10

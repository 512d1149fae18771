"""Surfaces behind which the whole light lies: found by plain and lane code alike, dark at once, and without history."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp

from algorithms.plugins import find
from wkernels.device.lanes import LANES, Floats, runs_of, runs_per_row, uses_lanes
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.point_lanes import points_of_run
from wkernels.light_maps.receiver_lanes import LaneViews, lane_views
from wkernels.raster.gbuffer import PADDING, GBuffer
from wkernels.scene.geometry import CASTS, RECEIVES, Geometry
from wkernels.scene.lights import Light, SphereLight
from wkernels.scene.model import Camera
from wkernels.temporal.shadow_buffer.own_umbra import is_own_umbra, own_umbra_run, pull_light_corners

LIGHTS: dict[str, Light] = {
    "rectangle": small.light("rectangle", (3.0, 6.0, 2.0)),
    "directional": small.light("directional"),
    "sphere": SphereLight(center=np.array([2.0, 5.0, 1.5]), radius=0.8),
}


@wp.kernel
def mark(first: int, gbuffer: GBuffer, corners: wp.array(dtype=wp.vec4), out: wp.array2d(dtype=int)):
    row, x = wp.tid()
    y = first + row
    out[y, x] = wp.where((gbuffer.flags[y, x] & RECEIVES) != 0 and is_own_umbra(gbuffer, y, x, corners), 1, 0)


@wp.kernel
def mark_lanes(
    first: int,
    views: LaneViews,
    depth: wp.array(dtype=Floats),
    corners: wp.array(dtype=wp.vec4),
    out: wp.array2d(dtype=int),
):
    row, run = wp.tid()
    y = first + row
    x0 = run * LANES
    found = own_umbra_run(views, points_of_run(views, depth, x0, y), x0, y, corners)
    for k in range(wp.min(LANES, out.shape[1] - x0)):
        out[y, x0 + k] = found[k]


@pytest.mark.parametrize("kind", sorted(LIGHTS))
def test_own_umbra_is_where_every_corner_is_behind(kind: str, device: str) -> None:
    session = Session(Geometry(small.cluttered(LIGHTS[kind]), device), width=90, height=61, device=device)
    gbuffer, corners = session.gbuffer(), pull_light_corners(session, session.light)
    position, normal = (a.numpy().astype(float) for a in (gbuffer.position_ws, gbuffer.normal_ws))
    flags = gbuffer.flags.numpy()
    casts_and_receives = (flags & int(CASTS) != 0) & (flags & int(RECEIVES) != 0)
    hull = session.light.hull
    facing = np.stack([np.sum(normal * (c[:3] - position * c[3]), axis=-1) for c in hull])
    expected = casts_and_receives & (facing <= 0.0).all(axis=0)
    certain = (np.abs(facing) > 1e-4).all(axis=0) | ~casts_and_receives  # float32 decides the rest
    assert 50 < expected.sum() < 0.6 * expected.size and certain.mean() > 0.95

    shape = flags.shape
    out = wp.full(shape, 7, dtype=int, device=device)
    launch(mark, shape, [gbuffer, corners], [out], device=device)
    np.testing.assert_array_equal(out.numpy()[certain], expected[certain])
    launch(mark, shape, [gbuffer, wp.empty(0, dtype=wp.vec4, device=device)], [out], device=device)
    assert not out.numpy().any(), "without corners nothing is known to be hidden"
    if uses_lanes(device):
        views = lane_views(gbuffer, session.light_map(16).map)
        inputs = [views, runs_of(gbuffer.depth, Floats, PADDING), corners]
        out.fill_(7)
        launch(mark_lanes, (shape[0], runs_per_row(shape[1])), inputs, [out], device=device)
        np.testing.assert_array_equal(out.numpy()[certain], expected[certain])

    points = session.light.sample(np.random.default_rng(1).random((50, 3)))
    behind = np.stack([np.sum(normal * (p[:3] - position * p[3]), axis=-1) <= 1e-6 for p in points])
    assert behind.all(axis=0)[expected].all(), "no point of the light may be before such a surface"


def circling(frame: int) -> Camera:
    angle = 0.02 * frame
    return small.camera(eye=(6.0 * np.sin(angle), 3.0, 6.0 * np.cos(angle)))


@pytest.mark.parametrize("name", ["tc_soft_paper", "tc_soft_thesis"])
def test_history_does_not_cross_the_edge_of_a_surface_that_is_turned_away(name: str, device: str) -> None:
    """Curved casters: the lit rim's history passes the depth test on the dark side, as printed."""
    lamp = small.light("rectangle", (4.0, 4.0, 1.0))
    ball = small.mesh("ball", small.sphere((0.0, 1.2, 0.0), 1.2, points=400))
    scene = small.scene([small.mesh("ground", small.plane(12.0)), ball], lamp, circling)
    worst: dict[str, float] = {}
    for way in ("dark", "tested"):
        session = Session(Geometry(scene, device), width=96, height=72, device=device)
        plugin: Any = find(name)
        technique = plugin(plugin.Params(resolution=256, turned_away=way, overscan=0.0))
        for index in range(12):
            session.begin(index)
            result = session.render(technique)
            session.advance()
        gbuffer, corners = session.gbuffer(), pull_light_corners(session, session.light)
        out = wp.zeros(gbuffer.flags.shape, dtype=int, device=device)
        launch(mark, out.shape, [gbuffer, corners], [out], device=device)
        dark = out.numpy() == 1
        assert dark.sum() > 100
        worst[way] = float(result.visibility[dark].max())
        if way == "dark":
            assert result.standard_error is not None and not result.standard_error[dark].any()
            texels = session.history("shadow buffer", lambda: None).previous.numpy()
            assert not texels[dark, 1].any(), "what is known for certain must not be remembered"
    assert worst["dark"] == 0.0 and worst["tested"] > 0.02, worst

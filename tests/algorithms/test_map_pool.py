"""Pools of kept maps: their drawing, their tests beside those of light maps, movers' maps, and the variance of shares."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from sessions import open_session

from algorithms.technique import MapParams
from wkernels.device.launch import launch
from wkernels.light_maps.light_map import Bias, LightMap, compare_nearest, locate_receiver
from wkernels.raster.gbuffer import GBuffer, is_back_lit, to_light
from wkernels.sampling.point_sets import light_set
from wkernels.scene.geometry import CASTS, RECEIVES
from wkernels.scene.lights import DiscLight, Light
from wkernels.temporal.map_pool.carried_history import decode_offset, encode_offset
from wkernels.temporal.map_pool.drawing import PoolPainter, store_layers, store_tiles
from wkernels.temporal.map_pool.kept_maps import KeptMaps
from wkernels.temporal.map_pool.mover_maps import MoverMaps, box_axes, box_view
from wkernels.temporal.map_pool.pool import MapPool, allocate_pool, map_test
from wkernels.temporal.map_pool.update import hidden_variance
from wkernels.temporal.reach import MoverReach, may_reach, mover_reach

LAMP = small.light("rectangle", (2.0, 8.0, 1.0), 2.0)
LIGHTS: dict[str, Light] = {
    "perspective": LAMP,
    "orthographic": small.light("directional", (1.0, 8.0, 0.5)),
    "six faces": DiscLight(center=np.array([0.2, 3.2, 1.5]), normal=np.array([0.0, -1.0, 0.0]), radius=0.2),
}
BIASES = ("none", "constant", "slope", "normal")


@pytest.mark.parametrize("resolution", [16, 30, 64])
@pytest.mark.parametrize("nearest", [0.0, 2.0])
def test_tiles_hold_the_image(resolution: int, nearest: float, device: str) -> None:
    values = np.random.default_rng(resolution).uniform(0.1, 0.9, (2 * resolution, 2 * resolution)).astype(np.float32)
    values[3:5] = np.inf
    drawn, least = (wp.array(v, dtype=float, device=device) for v in (values, [0.0, nearest, nearest]))
    pools = [allocate_pool(4, 1, resolution, device) for _ in range(2)]
    store_layers(drawn, 2, least, 1, pools[0], None)
    tiles = pools[1].tiles
    launch(store_tiles, (tiles, tiles, 3), [drawn, 2, least, 1, resolution, tiles], [pools[1].depth], device=device)
    part = values[:resolution, resolution:]
    if nearest:
        part = np.where(np.isinf(part), part, nearest / (1.0 - part))
    for pool in pools:
        held = pool.depth.numpy()[2].reshape(tiles, tiles, 4, 4).transpose(0, 2, 1, 3).reshape(4 * tiles, 4 * tiles)
        np.testing.assert_allclose(held[:resolution, :resolution], part, rtol=1e-6)
        assert np.isinf(held[resolution:]).all() and np.isinf(held[:, resolution:]).all()


@wp.kernel
def both_tests(
    first: int, gbuffer: GBuffer, light_map: LightMap, pool: MapPool, bias: Bias, out: wp.array3d(dtype=float)
):
    row, x = wp.tid()
    y = first + row
    if (gbuffer.flags[y, x] & RECEIVES) != 0:
        at = gbuffer.position_ws[y, x]
        normal = gbuffer.normal_ws[y, x]
        visible = float(0.0)
        if not is_back_lit(gbuffer, y, x, to_light(light_map.light_ws, at)):
            receiver = locate_receiver(light_map, bias, at, normal)
            visible = receiver.visible
            if receiver.layer >= 0:
                visible = compare_nearest(light_map, receiver)
        found = map_test(pool, 1, bias, gbuffer.flags[y, x] & CASTS, at, normal)
        out[0, y, x] = 1.0 - visible
        out[1, y, x] = found.tau
        out[2, y, x] = float(found.holds)


@pytest.mark.parametrize("bias", BIASES)
@pytest.mark.parametrize("lamp", LIGHTS)
@pytest.mark.parametrize("warp", [None, "lispsm_nopt"])
def test_a_test_in_a_pool_is_that_of_a_light_map(lamp: str, bias: str, warp: str | None, device: str) -> None:
    """The slope by triple products is that of the plane's own solution, warped maps included."""
    projection = {"fit": "focused", "warp": warp} if warp else None
    session = open_session(small.cluttered(LIGHTS[lamp]), device, projection=projection)
    params = MapParams(resolution=256, bias=bias, bias_constant=2.0)
    gbuffer, samples = session.gbuffer(), session.light_samples(2)
    light_map = session.light_map(256, samples.host[1]).map
    kept = KeptMaps(session, 2, 256)
    # the first call may find that a map takes more layers than there is room for
    both = (0, range(6)), (1, range(6))
    assert kept.draw(session, both, "halton", 0) or kept.draw(session, both, "halton", 0)
    out = wp.zeros((3, *gbuffer.depth.shape), dtype=float, device=device)
    launch(both_tests, gbuffer.depth.shape, [gbuffer, light_map, kept.pool, params.device_bias], [out], device=device)
    expected, found, holds = out.numpy()
    receives = (gbuffer.flags.numpy() & int(RECEIVES)) != 0
    assert 0.05 < expected[receives].mean() < 0.95 and holds[receives].mean() > 0.9
    # a comparison that is a tie may go either way, and without bias many are; of the overlapping faces of a cube the
    # first is read, not that which holds a point most centrally
    differs = (expected != found)[receives & (holds > 0.0)].mean()
    assert differs <= (0.04 if lamp == "six faces" else 0.005), differs


def test_offsets_come_back(device: str) -> None:
    @wp.kernel
    def there_and_back(first: int, given: wp.array(dtype=wp.vec2), out: wp.array(dtype=wp.vec2)):
        i = first + wp.tid()
        out[i] = decode_offset(encode_offset(given[i]))

    given = np.random.default_rng(1).uniform(-1.9, 1.9, (500, 2)).astype(np.float32)
    given[0] = 0.0
    out = wp.zeros(500, dtype=wp.vec2, device=device)
    launch(there_and_back, 500, [wp.array(given, dtype=wp.vec2, device=device)], [out], device=device)
    np.testing.assert_allclose(out.numpy(), given, atol=0.5 / 128.0 + 1e-6)
    assert (out.numpy()[0] == 0.0).all()


def test_movers_drawn_at_once_are_those_drawn_apart(device: str) -> None:
    session = open_session(small.moved(small.cluttered(LAMP), 1, lambda frame: 0.1 * frame), device)
    box = session.geometry.bounds(casters=True, moving=True)
    points = session.light_samples(5).host
    at_once = MoverMaps(session, 5, 64)
    pool = at_once.draw(points, box, 0)
    depth = pool.depth.numpy()
    assert 0.02 < np.isfinite(depth).mean() < 0.95
    apart = allocate_pool(5, 1, 64, device)
    painter = PoolPainter(at_once.casters, 64, device, None, culls=False)
    for i in range(5):
        view = box_view(points[i], box.corners, box_axes(points[0], box.corners), 64)
        assert view is not None
        painter.draw(apart, i, [view], points[i], 1.0, 0)
    expected = apart.depth.numpy()
    both = np.isfinite(depth) & np.isfinite(expected)
    assert (np.isfinite(depth) == np.isfinite(expected)).mean() > 0.995  # vertices are rounded in another frame
    assert np.quantile(np.abs(depth[both] - expected[both]), 0.99) < 1e-3
    near = MoverMaps(session, 2, 64)
    inside = np.array([[*box.corners.mean(axis=0), 1.0]] * 2)
    assert near.draw(inside, box, 0).slots > 1, "a light amid the movers needs more than one view"


@wp.kernel
def ask_reach(first: int, reach: MoverReach, points_ws: wp.array(dtype=wp.vec3), out: wp.array(dtype=int)):
    i = first + wp.tid()
    out[i] = wp.where(may_reach(reach, points_ws[i]), 1, 0)


@pytest.mark.parametrize("kind", ["rectangle", "sphere", "directional"])
def test_no_shadow_of_a_mover_is_culled(kind: str, device: str) -> None:
    """Brute force: every point from which a way to some point of the light meets the movers' ball is reached."""
    rng = np.random.default_rng(5)
    lamp = small.light(kind, (1.0, 6.0, 0.5), 2.5)
    box = small.mesh("m", small.box((0.3, 2.0, -0.2), (0.8, 0.3, 1.1)))
    session = open_session(small.scene([box], lamp), device)
    box = session.geometry.bounds(casters=True)
    reach = mover_reach(session.light, box.low, box.high)
    points = rng.uniform((-6.0, -3.0, -6.0), (6.0, 5.0, 6.0), (4000, 3)).astype(np.float32)
    out = wp.zeros(len(points), dtype=int, device=device)
    launch(ask_reach, len(points), [reach, wp.array(points, dtype=wp.vec3, device=device)], [out], device=device)
    light = session.light_samples(64).host
    way = light[None, :, :3] - points[:, None] * light[None, :, 3:]
    length = np.linalg.norm(way, axis=2)
    to_ball = np.array(reach.centre_ws)[None, None] - points[:, None]
    along = np.maximum((to_ball * way).sum(axis=2) / length, 0.0)
    if not session.light.is_directional:
        along = np.minimum(along, length)
    aside = np.linalg.norm(to_ball - way * (along / length)[..., None], axis=2)
    met = (aside <= reach.radius).any(axis=1)
    reached = out.numpy() == 1
    assert 0.01 < met.mean() and not (met & ~reached).any()
    assert reached.mean() < 0.35, "so much is reached that little is saved"


@wp.kernel
def ask_variance(first: int, rho: wp.array(dtype=float), n: float, even: int, out: wp.array(dtype=float)):
    i = first + wp.tid()
    out[i] = hidden_variance(rho[i], n, even)


@pytest.mark.parametrize("kind", ["random", "halton"])
def test_variance_is_that_of_the_samples(kind: str, device: str) -> None:
    """Brute force: shares of a square light beyond random edges, of 64 points; independent ones differ far more."""
    rng = np.random.default_rng(3)
    truth_of, found = [], []
    dense = light_set("halton", 4096, 2)
    for seed in range(200):
        angle, at = rng.uniform(0.0, np.pi), rng.uniform(-0.3, 0.3)
        normal = np.array([np.cos(angle), np.sin(angle)])
        truth_of.append(((dense - 0.5) @ normal > at).mean())
        found.append(((light_set(kind, 64, 2, 0, seed + 2) - 0.5) @ normal > at).mean())
    error = np.sqrt(np.mean((np.array(found) - np.array(truth_of)) ** 2))
    out = wp.zeros(200, dtype=float, device=device)
    rho = wp.array(64.0 * np.array(found), dtype=float, device=device)
    launch(ask_variance, 200, [rho, 64.0, int(kind == "halton")], [out], device=device)
    reported = np.sqrt(out.numpy().mean())
    assert 0.9 < reported / error < 2.0, (reported, error)
    assert (reported < 0.035) == (kind == "halton"), reported

"""Shadow buffers of earlier views: when one is put aside and where, what is read from it, and a cut back to it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from compare import assert_twin, rmse
from seen_ground import EYE, HEIGHT, WIDTH, fetch_twin, ground_depth, ray
from sessions import open_session, render_frames, small_technique, technique, true_visibility, walk

from wkernels.device.launch import launch
from wkernels.scene.model import Camera
from wkernels.scene.views import View
from wkernels.temporal.shadow_buffer.buffer_shelf import PROBE, PUT_ASIDE, SEE, BufferShelf, pull_shelf
from wkernels.temporal.shadow_buffer.earlier_buffers import EarlierBuffers, fetch_earlier
from wkernels.temporal.shadow_buffer.record import BILINEAR, TEXEL_TYPES

STEPS = int(BILINEAR)
SIZE = (80, 60)
MAP = {"resolution": 512}


@wp.kernel
def fetch_all(first: int, kept: EarlierBuffers, positions: wp.array(dtype=wp.vec3), out: wp.array(dtype=wp.vec3)):
    i = first + wp.tid()
    record = fetch_earlier(kept, positions[i], wp.vec3(0.0, 1.0, 0.0), 0.01, 0.0, 256.0)
    out[i] = wp.vec3(record.rho, record.n, record.blocker_rise)


def some_texels(rng: np.random.Generator) -> np.ndarray:
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    depth = ground_depth(column, row) + np.where(rng.random((HEIGHT, WIDTH)) < 0.2, 0.5, 0.0)
    n = rng.integers(0, 30, depth.shape)
    rho = np.floor(n * rng.random(depth.shape))
    return np.stack([rho, n, depth / EYE.far, rng.uniform(0.1, 0.9, depth.shape)], axis=-1).astype(np.float32)


def test_the_buffer_that_knows_most_is_read(device: str) -> None:
    rng = np.random.default_rng(1)
    slots = [some_texels(rng) for _ in range(3)]
    slots[2][: HEIGHT // 2, :, 2] *= -1.0  # shadows of movers
    places = rng.integers(256, 256 * np.array([WIDTH - 1, HEIGHT - 1]), (400, 2)) / 256 + 0.3 / 256
    positions = EYE.eye_ws + ground_depth(*places.T)[:, None] * ray(*places.T)
    kept = EarlierBuffers()
    kept.count = 3
    kept.texels = wp.array(np.stack(slots), dtype=wp.vec4, device=device)
    kept.views = wp.array([EYE.to_device()] * 3, dtype=View, device=device)
    out = wp.empty(len(places), dtype=wp.vec3, device=device)
    launch(fetch_all, len(places), [kept, wp.array(positions, dtype=wp.vec3, device=device)], [out], device=device)
    expected = np.zeros((len(places), 3))
    middle = np.abs(places[:, 1] - HEIGHT // 2) < 1.0  # texels with and without tags are mixed by their weights
    for i, (x, y) in enumerate(places):
        for slot, texels in enumerate(slots):
            if slot == 2 and y < HEIGHT // 2:
                continue
            found = fetch_twin(texels, x, y, 0.01, STEPS)
            if found[1] > expected[i, 1]:
                expected[i] = found
    assert (expected[:, 1] > 0.0).mean() > 0.9
    assert_twin(out.numpy()[~middle], expected[~middle], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("format", sorted(TEXEL_TYPES))
def test_buffers_are_probed_and_copied(format: str, device: str) -> None:
    texels = some_texels(np.random.default_rng(2))
    held = wp.array(
        texels.astype(np.float16 if format == "float16" else np.float32), dtype=TEXEL_TYPES[format], device=device
    )
    kept = wp.zeros((2, HEIGHT, WIDTH), dtype=wp.vec4, device=device)
    launch(PUT_ASIDE[TEXEL_TYPES[format]], (HEIGHT, WIDTH), [held, 1], [kept], device=device)
    np.testing.assert_array_equal(kept.numpy()[1], held.numpy().astype(np.float32))
    assert not kept.numpy()[0].any()

    shape = (6, 8)
    points = wp.empty(shape, dtype=wp.vec4, device=device)
    launch(PROBE[TEXEL_TYPES[format]], shape, [held, EYE.to_device()], [points], device=device)
    y, x = np.meshgrid((2 * np.arange(6) + 1) * HEIGHT // 12, (2 * np.arange(8) + 1) * WIDTH // 16, indexing="ij")
    found = kept.numpy()[1][y, x].astype(float)
    expected = EYE.eye_ws + (found[..., 2:3] * EYE.far) * ray(x + 0.5, y + 0.5)
    np.testing.assert_array_equal(points.numpy()[..., 3], found[..., 1])
    known = found[..., 1] > 0.0
    assert_twin(points.numpy()[known][:, :3], expected[known], rtol=1e-5, atol=1e-5)
    moved = points.numpy() + np.where(np.arange(8) < 4, 0.0, 0.9)[:, None] * [0.0, 1.0, 0.0, 0.0]
    seen = wp.empty(shape, dtype=int, device=device)
    inputs = [wp.array(moved, dtype=wp.vec4, device=device), held, EYE.to_device()]
    launch(SEE[TEXEL_TYPES[format]], shape, inputs, [seen], device=device)
    np.testing.assert_array_equal(seen.numpy()[:, :4], np.where(known, 1, -1)[:, :4])
    to_ss = EYE.ws_to_ss
    at = np.concatenate([moved[..., :3], np.ones((*shape, 1))], axis=-1) @ to_ss.T
    x = np.floor((0.5 + 0.5 * at[..., 0] / at[..., 3]) * WIDTH).astype(int)
    y = np.floor((0.5 - 0.5 * at[..., 1] / at[..., 3]) * HEIGHT).astype(int)
    inside = (x >= 0) & (x < WIDTH) & (y >= 0) & (y < HEIGHT)
    there = kept.numpy()[1][np.where(inside, y, 0), np.where(inside, x, 0), 2].astype(float) * EYE.far
    twin = inside & (np.abs(there - at[..., 2]) < 0.02 * there)
    np.testing.assert_array_equal(seen.numpy()[:, 4:], np.where(known, twin, -1)[:, 4:])
    assert (seen.numpy()[:, 4:] == 0).any()


def test_slots_go_to_what_is_new_and_well_known(device: str) -> None:
    def probes(n: float) -> wp.array:
        return wp.full((2, 2), wp.vec4(0.0, 0.0, 0.0, n), dtype=wp.vec4, device=device)

    shelf = BufferShelf()
    assert shelf.choose(4.0, [], [], 2) == 0
    shelf.points = [probes(8.0)]
    assert shelf.choose(4.0, [0.2], [0.1], 2) == 1, "a free one"
    shelf.points = [probes(8.0), probes(3.0)]
    assert shelf.choose(13.0, [0.2, 0.9], [0.9, 0.0], 3) == 1, "what shows the same makes room"
    assert shelf.choose(11.0, [0.2, 0.9], [0.9, 0.0], 3) is None, "but not for what knows less"
    assert shelf.choose(13.0, [0.2, 0.3], [0.1, 0.1], 2) == 1, "what knows least"
    assert shelf.choose(2.0, [0.2, 0.3], [0.8, 0.1], 2) == 0, "what the frame has read needs no slot"
    shelf.points = [probes(500.0), probes(400.0)]
    assert shelf.choose(4 * 64.0, [0.2, 0.3], [0.1, 0.1], 2) == 0, "64 tests are enough to know"


A, B = small.camera(eye=(0.0, 4.0, 7.0)), small.camera(eye=(7.0, 4.0, 0.0), target=(30.0, 0.0, 0.0))


def a_b_a(frame: int) -> Camera:
    return B if 40 <= frame < 50 else A


@pytest.mark.parametrize(("name", "buffer"), [("tc_soft_paper", "float32"), ("tc_soft_thesis", "float16")])
def test_after_a_cut_back_the_error_is_that_before_the_cut(name: str, buffer: str, device: str) -> None:
    lamp = small.light("rectangle", (2.0, 8.0, 1.0), 2.5)
    scene = small.scene([small.mesh("ground", small.plane(80.0)), *small.cluttered(lamp).meshes[1:]], lamp, a_b_a)
    truth = true_visibility(scene, device, samples=1024, size=SIZE)
    session = open_session(scene, device, size=SIZE)
    kept = render_frames(session, technique(name, kept_views=2, buffer=buffer, **MAP), 51)
    plain = walk(scene, device, name, 51, {"size": SIZE}, kept_views=1, buffer=buffer, **MAP)
    before = rmse(kept[39].visibility, truth)
    assert before == rmse(plain[39].visibility, truth), "nothing was put aside before the cut"
    after, anew = (rmse(walked[50].visibility, truth) for walked in (kept, plain))
    assert after < 1.1 * before, (after, before)
    assert anew > 1.5 * before, "as published a cut is a start"
    texels = session.history("shadow buffer", lambda: None).previous.numpy()
    assert np.median(texels[..., 1][texels[..., 1] > 0.0]) == 41.0
    held = [b for b in session._buffers.values() if len(b.shape) == 3]
    assert len(held) == 1 and held[0].capacity == 16 * held[0].shape[1] * held[0].shape[2]


def test_a_frame_is_the_same_however_often_it_is_rendered(device: str) -> None:
    lamp = small.light("rectangle", (2.0, 8.0, 1.0), 2.5)
    session = open_session(small.box_on_ground(lamp, a_b_a), device, size=SIZE)
    made = small_technique("tc_soft_paper", kept_views=2)
    for index in (36, 37, 38, 39, 40, 41, 50):
        images = []
        for _ in range(2):
            session.begin(index)
            images.append(session.render(made).visibility)
        np.testing.assert_array_equal(*images)
        session.advance()
    assert pull_shelf(session, [session.light]).on_device.count == 1


@pytest.mark.parametrize("name", ["tc_soft_paper", "tc_soft_thesis"])
@pytest.mark.parametrize("lights", ["all", "drawn"])
def test_sums_of_several_lights_survive_a_cut(lights: str, name: str, device: str) -> None:
    lamps = (small.light("rectangle", (2.0, 8.0, 1.0), 2.5), small.light("disc", (-3.0, 7.0, 1.0), 2.0))
    scene = replace(small.box_on_ground(lamps[0], lambda i: a_b_a(i + 20)), lights=lamps)
    n = {}
    for kept in (1, 2):
        session = open_session(scene, device, size=SIZE)
        render_frames(session, technique(name, kept_views=kept, lights=lights, **MAP), 31)
        texels = session.history("shadow buffer", lambda: None).previous.numpy()
        n[kept] = float(np.median(texels[..., 1][texels[..., 1] > 0.0]))
        n[-kept] = float(texels[..., 0].sum() / texels[..., 1].sum())
    tests = 2.0 if lights == "all" else 1.0
    assert n[2] == pytest.approx(21 * tests) and n[1] == pytest.approx(tests), n
    assert abs(n[-2] - n[-1]) < 0.02, "the same shadows"


@pytest.mark.parametrize("params", [{}, {"movers": "gradual"}, {"mover_map": "centre"}, {"movers": "ignore"}])
def test_no_shadow_of_a_mover_comes_back(params: dict[str, Any], device: str) -> None:
    """A box that has gone while the eye looked away: where its shadow was it is as bright as without kept views."""
    lamp = small.light("rectangle", (2.0, 8.0, 1.0), 2.5)
    still = small.box_on_ground(lamp, lambda i: a_b_a(i + 20))
    scene = small.moved(still, 1, lambda i: 0.0 if i < 20 else 40.0)
    images = {}
    for kept in (1, 2):
        images[kept] = walk(scene, device, "tc_soft_paper", 31, {"size": SIZE}, kept_views=kept, **MAP, **params)
    then, now, plain = images[2][19].visibility, images[2][30].visibility, images[1][30].visibility
    was_dark = (then < 0.5) & (plain > 0.95)
    assert was_dark.sum() > 50
    assert now[was_dark].min() > 0.9, (params, now[was_dark].min())


def test_a_light_that_moves_voids_what_was_kept(device: str) -> None:
    def motion(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = 0.5 if frame >= 48 else 0.0
        return out

    lamp = replace(small.light("rectangle", (2.0, 8.0, 1.0), 2.5), motion=motion)
    scene = small.box_on_ground(lamp, a_b_a)
    session = open_session(scene, device, size=SIZE)
    render_frames(session, technique("tc_soft_paper", kept_views=4, **MAP), 48)
    held = pull_shelf(session, [session.light])
    assert held.on_device.count == 1 and len(held.views) == 1
    session.begin(48)
    session.render(technique("tc_soft_paper", resolution=64, kept_views=4))
    assert pull_shelf(session, [session.light]).on_device.count == 0

"""History with tags of moving casters, the published linear fetch, fading, motion of meshes; storage over many frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from compare import assert_twin
from seen_ground import EYE, HEIGHT, WIDTH, ground_depth, ray

from algorithms.plugins import find
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.sampling.estimators import UNLIMITED, add_test, fade_out, sampling_weight
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import View
from wkernels.temporal.mesh_motion import mesh_motion, pull_mesh_motion
from wkernels.temporal.shadow_buffer.record import (
    BILINEAR,
    TEXEL_TYPES,
    fetch_linear,
    fetch_record,
    read_record,
    storage_of,
    write_record,
)

# ---- fading and blending ------------------------------------------------------------------------------------------------


@wp.kernel
def fade_all(first: int, sums: wp.array(dtype=wp.vec2), decrement: float, out: wp.array(dtype=wp.vec2)):
    i = first + wp.tid()
    out[i] = fade_out(sums[i][0], sums[i][1], decrement)


def test_fading_keeps_psi_until_nothing_is_left(device: str) -> None:
    """Equations 5.15 to 5.17."""
    sums = np.array([[3.0, 12.0], [12.0, 12.0], [0.0, 5.0], [1.0, 2.0], [0.0, 0.0], [900.0, 1000.0]])
    out = wp.empty(len(sums), dtype=wp.vec2, device=device)
    launch(fade_all, len(sums), [wp.array(sums, dtype=wp.vec2, device=device), 2.5], [out], device=device)
    left = np.maximum(sums[:, 1] - 2.5, 0.0)
    ratio = np.divide(sums[:, 0], sums[:, 1], out=np.zeros(len(sums)), where=sums[:, 1] > 0.0)
    assert_twin(out.numpy(), np.stack([left * ratio, left], axis=1))


@wp.kernel
def weigh_all(first: int, errors: wp.array(dtype=float), least: float, largest: float, out: wp.array(dtype=float)):
    i = first + wp.tid()
    out[i] = sampling_weight(errors[i], least, largest)


def weights(errors: list[float], least: float, largest: float, device: str) -> np.ndarray:
    out = wp.empty(len(errors), dtype=float, device=device)
    launch(weigh_all, len(errors), [wp.array(errors, dtype=float, device=device), least, largest], [out], device=device)
    values: np.ndarray = out.numpy()
    return values


def test_a_sixteenth_between_an_eighth_and_a_thirtysecond_weighs_two_thirds(device: str) -> None:
    """The thesis's own example, section 5.2.4; beyond the bounds one of both stands alone."""
    assert_twin(weights([1 / 16, 1 / 8, 1 / 32, 1.0, 0.0], 1 / 32, 1 / 8, device), np.array([2 / 3, 0, 1, 0, 1]))
    np.testing.assert_array_equal(weights([0.0, 0.0999, 0.1, 0.2], 0.1, 0.1, device), [1.0, 1.0, 0.0, 0.0])


# ---- fetching -----------------------------------------------------------------------------------------------------------


@wp.kernel
def fetch_tagged(
    first: int,
    previous: wp.array2d(dtype=wp.vec4),
    view: View,
    positions: wp.array(dtype=wp.vec3),
    relative: float,
    steps: float,
    out: wp.array2d(dtype=float),
):
    i = first + wp.tid()
    up = wp.vec3(0.0, 1.0, 0.0)
    record = fetch_record(previous, view, positions[i], up, 0.0, relative, 256.0)
    if steps == 0.0:
        record = fetch_linear(previous, view, positions[i], 0.0, relative)
    out[i, 0] = record.rho
    out[i, 1] = record.n
    out[i, 2] = record.blocker_rise
    out[i, 3] = float(record.of_mover)


def tagged_ground(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Texels that see the ground, three in ten with a mover's tag and two in ten with no blocker; places to look up."""
    depth = ground_depth(*np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5))
    sign = np.where(rng.random(depth.shape) < 0.3, -1.0, 1.0)
    n = rng.integers(1, 30, depth.shape)
    rise = rng.uniform(0.1, 0.9, depth.shape) * (rng.random(depth.shape) < 0.8)
    texels = np.stack([np.floor(n * rng.random(depth.shape)), n, sign * depth / EYE.far, rise], axis=-1)
    places = (rng.integers(128, 256 * np.array([WIDTH - 1, HEIGHT - 1]), (600, 2)) + 0.2) / 256  # no ties, all inside
    return texels.astype(np.float32), places


def corners(texels: np.ndarray, place: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """(Weights (4,), texels (4, 4)) around a place; ``steps`` as for ``fetch_record``, 0 for no rounding."""
    x, y = place - 0.5 if steps == 0 else np.round((place - 0.5) * steps) / steps
    column, row = int(np.floor(x)), int(np.floor(y))
    share = np.array([(1.0 - abs(x - column - dx)) * (1.0 - abs(y - row - dy)) for dy in (0, 1) for dx in (0, 1)])
    held = [texels[min(row + dy, HEIGHT - 1), min(column + dx, WIDTH - 1)] for dy in (0, 1) for dx in (0, 1)]
    return share, np.array(held, dtype=float)


def fetch_all(texels: np.ndarray, places: np.ndarray, relative: float, steps: float, device: str) -> np.ndarray:
    positions = EYE.eye_ws + ground_depth(*places.T)[:, None] * ray(*places.T)
    out = wp.empty((len(places), 4), dtype=float, device=device)
    inputs: list[Any] = [wp.array(texels, dtype=wp.vec4, device=device), EYE.to_device()]
    inputs += [wp.array(positions, dtype=wp.vec3, device=device), relative, steps]
    launch(fetch_tagged, len(places), inputs, [out], device=device)
    values: np.ndarray = out.numpy()
    return values


def test_movers_shadows_are_not_mixed_with_others(device: str) -> None:
    texels, places = tagged_ground(np.random.default_rng(6))
    expected = []
    for place in places:
        share, held = corners(texels, place, int(BILINEAR))
        moving = held[:, 2] < 0.0
        tag = share[moving].sum() > share[~moving].sum()
        share = share * (moving == tag)
        known = share * (held[:, 3] > 0.0)
        mean = share @ held[:, :2] / share.sum()
        expected.append([*mean, known @ held[:, 3] / max(known.sum(), 1e-6), tag])
    assert 0.1 < np.mean([row[3] for row in expected]) < 0.5
    assert_twin(fetch_all(texels, places, 1e-4, BILINEAR, device), np.array(expected), rtol=1e-4, atol=1e-5)


def test_the_linear_fetch_mixes_tags_and_sentinels(device: str) -> None:
    """Erratum E27: signs cancel, so that borders of movers' shadows count as new; one missing blocker takes all."""
    texels, places = tagged_ground(np.random.default_rng(7))
    relative = 0.05  # the point's own depth differs from the mean of four by less
    expected = []
    for place in places:
        share, held = corners(texels, place, 0)
        rho, n, depth, _ = share @ held
        blocker = share @ np.where(held[:, 3] > 0.0, 1.0 - held[:, 3], -1e6)
        known = abs(abs(depth) * EYE.far - ground_depth(*place)) < relative * abs(depth) * EYE.far
        expected.append([rho, n, 1.0 - blocker if blocker >= 0.0 else 0.0, depth < 0.0] if known else [0.0] * 4)
    table = np.array(expected)
    assert 0.3 < (table[:, 1] > 0.0).mean() < 0.7 and (table[:, 3] == 1.0).any() and (table[:, 2] > 0.0).any()
    found = fetch_all(texels, places, relative, 0.0, device)
    differs = np.abs(found - table).max(axis=1) > 1e-3
    assert differs.mean() < 0.01  # a depth that just passes or just fails its test


# ---- motion -------------------------------------------------------------------------------------------------------------


def tumbling(frame: int) -> np.ndarray:
    """Turns, slides and grows."""
    angle = 0.3 * frame
    out = np.eye(4)
    out[:3, :3] = (1.0 + 0.05 * frame) * np.array(
        [[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]]
    )
    out[:3, 3] = (0.2 * frame, 0.1 * frame, -0.3)
    return out


def test_mesh_motion_takes_points_back_to_where_they_were(device: str) -> None:
    scene = small.box_on_ground(small.light("rectangle"))
    box = replace(scene.meshes[1], object_to_ws=tumbling, moving=True)
    flat = replace(
        small.mesh("flat", small.plane(2.0)), object_to_ws=lambda f: np.diag([1.0, 0.0, 1.0, 1.0]), moving=True
    )
    geometry = Geometry(replace(scene, meshes=(scene.meshes[0], box, flat)), device)
    assert geometry.origin_ws.any()
    points, normals = mesh_motion(geometry, 7, 4)
    index = {mesh.name: i for i, mesh in enumerate(geometry.meshes)}
    np.testing.assert_array_equal(points[index["ground"]], np.eye(4))
    np.testing.assert_array_equal(points[index["flat"]], np.eye(4))

    def placed(frame: int) -> np.ndarray:
        world = box.vertices @ tumbling(frame)[:3, :3].T + tumbling(frame)[:3, 3]
        out: np.ndarray = world - geometry.origin_ws
        return out

    own = points[index["box"]]
    np.testing.assert_allclose(placed(7) @ own[:3, :3].T + own[:3, 3], placed(4), atol=1e-12)
    a, b, c = box.faces[0]
    before, after = (np.cross(v[b] - v[a], v[c] - v[a]) for v in (placed(7), placed(4)))
    turned = normals[index["box"]] @ before
    np.testing.assert_allclose(turned / np.linalg.norm(turned), after / np.linalg.norm(after), atol=1e-12)

    session = Session(geometry, width=8, height=8, device=device)
    session.begin(4)
    session.advance()
    session.begin(7)
    pulled = pull_mesh_motion(session, 4)
    np.testing.assert_allclose(pulled.points.numpy(), points, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(pulled.normals.numpy(), normals, rtol=1e-6, atol=1e-6)
    assert pull_mesh_motion(session, 5) is pulled  # the memory is reused
    assert not np.allclose(pulled.points.numpy(), points)


# ---- 100 000 frames -----------------------------------------------------------------------------------------------------


@wp.kernel
def accumulate_long(
    first: int,
    truth: wp.array(dtype=float),
    frames: int,
    limit: float,
    texels: wp.array2d(dtype=Any),
    reached_out: wp.array(dtype=int),
    worst_out: wp.array(dtype=float),
):
    """Tests that say psi as evenly as can be; ``worst_out`` is the largest error of psi from frame 2048 on."""
    i = first + wp.tid()
    reached_out[i] = frames
    worst_out[i] = 0.0
    step = truth[i]
    turn = float(0.0)
    for k in range(frames):
        tau = float(0.0)
        turn = turn + step
        if turn >= 1.0:
            turn = turn - 1.0
            tau = 1.0
        record = read_record(texels, 0, i, 10.0)
        sums = add_test(record.rho, record.n, tau, 1.0, limit)
        record.rho = sums[0]
        record.n = sums[1]
        write_record(texels, 0, i, record, 10.0)
        if k >= 2048:
            psi = sums[0] / sums[1]
            worst_out[i] = wp.max(worst_out[i], wp.abs(psi - truth[i]))
            if psi >= 1.0:
                reached_out[i] = wp.min(reached_out[i], k + 1)


for _texel in TEXEL_TYPES.values():
    wp.overload(accumulate_long, {"texels": wp.array2d(dtype=_texel)})

TRUTH = (0.0, 0.05, 0.25, 0.3, 0.5, 0.9)


@pytest.mark.parametrize(
    ("format", "cap"), [("float32", True), ("float16", True), ("float16", False), ("float32", False)]
)
def test_100_000_frames_do_not_drift_but_for_the_published_buffer(format: str, cap: bool, device: str) -> None:
    frames = 100_000
    texels = wp.zeros((1, len(TRUTH)), dtype=TEXEL_TYPES[format], device=device)
    reached = wp.empty(len(TRUTH), dtype=int, device=device)
    worst = wp.empty(len(TRUTH), dtype=float, device=device)
    inputs = [wp.array(TRUTH, dtype=float, device=device), frames, storage_of(format, cap).limit]
    launch(accumulate_long, len(TRUTH), inputs, [texels, reached, worst], device=device)
    if format == "float16" and not cap:
        # n stops at 2048 and rho does not: psi = 0.3 is 1 once 0.3 k is 2048
        assert 6800 <= reached.numpy()[3] <= 6850, reached.numpy()
        assert (reached.numpy()[1:] < frames).all() and texels.numpy()[0, :, 1].max() == 2048.0
    else:
        assert (reached.numpy() == frames).all()
        # a test weighs 1 / 512 just after sums were halved, and each halving may round rho once
        assert worst.numpy().max() < 1.0 / 512.0, worst.numpy()
        assert worst.numpy()[0] == 0.0


@pytest.mark.parametrize("name", ["tc_soft_paper", "tc_soft_thesis"])
def test_the_cap_is_a_parameter(name: str, device: str) -> None:
    scene = small.box_on_ground(small.light("rectangle"))
    for buffer in TEXEL_TYPES:
        limits = []
        for cap in (True, False):
            session = Session(Geometry(scene, device), width=16, height=16, device=device)
            technique = find(name)
            made: Any = technique(technique.Params(buffer=buffer, cap=cap))
            limits.append(made.counting(session, made.begin(session)).limit)
        assert limits[0] == storage_of(buffer).limit < 1e7 and limits[1] == np.float32(UNLIMITED)

"""Meshes at rest, and the history that is forgotten where they come to rest or leave it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from sessions import open_session

from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.scene.geometry import MOVES, Geometry
from wkernels.scene.model import Scene
from wkernels.scene.rest import REST_FRAMES, Poses
from wkernels.scene.views import eye_view
from wkernels.temporal.forgetting import FORGET, reached_by_change
from wkernels.temporal.reach import MoverReach, mover_reach

STOP, GO = 3, 40
"""Frames between which the boxes of ``stop_and_go`` stand."""


def stop_and_go(kind: str = "rectangle") -> Scene:
    """A box that moves along x, rests from ``STOP`` to ``GO``, and goes on."""
    still = small.box_on_ground(small.light(kind))
    return small.moved(still, 1, lambda frame: 0.1 * min(frame, STOP) + 0.2 * max(frame - GO, 0))


def test_a_mesh_rests_once_its_pose_has_stayed_the_same_for_a_while() -> None:
    mesh = stop_and_go().meshes[1]
    poses = Poses({0: mesh.object_to_ws})
    resting = [frame for frame in range(60) if poses.resting(frame)]
    assert resting == list(range(STOP + REST_FRAMES, GO + 1))
    assert [poses.rests(0, frame) for frame in (GO + 1, GO, STOP + REST_FRAMES - 1)] == [False, True, False]


def test_what_never_moves_before_a_frame_that_late_does_not_rest_yet() -> None:
    poses = Poses({0: lambda frame: np.eye(4)})
    assert not poses.resting(REST_FRAMES - 1) and poses.resting(REST_FRAMES)


def test_what_rests_counts_as_still(device: str) -> None:
    geometry, plain = Geometry(stop_and_go(), device), Geometry(small.box_on_ground(small.light("rectangle")), device)
    geometry.set_frame(GO - 1)
    version = geometry.version
    assert not geometry.casters_move and geometry.resting
    assert not (geometry.mesh_flags.numpy() & int(MOVES)).any()
    assert len(geometry.moving_triangles) == 0 and len(geometry.caster_sets["moving"]) == 0
    still = geometry.caster_sets["still"].numpy().reshape(-1, 3)
    np.testing.assert_array_equal(still, plain.caster_sets["still"].numpy().reshape(-1, 3))
    geometry.set_frame(GO)
    assert geometry.version == version  # products stay
    geometry.set_frame(GO + 1)
    assert geometry.version > version and geometry.casters_move
    assert (geometry.mesh_flags.numpy() & int(MOVES)).any()
    assert len(geometry.caster_sets["still"]) == 0 and len(geometry.caster_sets["moving"]) == 3 * 12
    geometry.set_frame(STOP + REST_FRAMES)
    assert not geometry.casters_move


def test_sets_of_casters_where_one_rests_and_another_moves(device: str) -> None:
    scene = stop_and_go()
    other = small.mesh("other", small.box((-3.0, 1.0, 0.0), (1.0, 1.0, 1.0)), receives=False)
    ball = small.mesh("ball", small.sphere((3.0, 1.0, 0.0), 0.5))
    scene = replace(scene, meshes=(*scene.meshes, other, ball))
    scene = small.moved(scene, 2, lambda frame: 0.05 * frame)
    geometry = Geometry(scene, device)
    corners = geometry.caster_indices.numpy().reshape(-1, 3)
    owner = geometry.triangle_mesh.numpy()
    names = [mesh.name for mesh in geometry.meshes]
    geometry.set_frame(GO)
    sets = {name: {tuple(c) for c in geometry.caster_sets[name].numpy().reshape(-1, 3)} for name in ("still", "moving")}
    for t, corner in enumerate(corners):
        assert (tuple(corner) in sets["moving"]) == (names[owner[t]] == "other")
        assert (tuple(corner) in sets["still"]) == (names[owner[t]] != "other")
    ((begin, end),) = geometry.moving_triangles.numpy()
    assert {names[owner[t]] for t in range(begin, end)} == {"other"}
    points, indices, _ = geometry.caster_buffers(moving=True)
    moved = points.numpy()[indices.numpy()]
    np.testing.assert_array_equal(moved, geometry.points_ws.numpy()[geometry.caster_sets["moving"].numpy()])


@pytest.mark.parametrize("texel", list(FORGET))
@pytest.mark.parametrize("kind", ["rectangle", "directional", "sphere"])
def test_sums_are_cleared_where_a_caster_may_hide_the_light(kind: str, texel: type, device: str) -> None:
    """Against segments to samples of the light: what meets the ball is cleared, and most of what does not is kept."""
    rng = np.random.default_rng(4)
    view = eye_view(small.camera(), 60, 40, np.zeros(3))
    lamp = small.light(kind)
    low, high = np.array([0.4, 1.0, -0.6]), np.array([1.4, 1.6, 0.4])
    depth = rng.uniform(4.0, 14.0, (40, 60))
    held = np.stack([rng.uniform(0.0, 8.0, depth.shape), rng.uniform(1.0, 9.0, depth.shape), depth / view.far], axis=-1)
    held[::3, :, 2] *= -1.0
    held = np.concatenate([held, rng.random((40, 60, 1))], axis=-1).astype(np.float32)
    texels = wp.array(held.astype(np.float16) if texel is wp.vec4h else held, dtype=texel, device=device)
    reaches = wp.array([mover_reach(lamp, low, high)], dtype=MoverReach, device=device)
    launch(FORGET[texel], (40, 60), [view.to_device(), view.far, reaches], [texels], device=device)
    out = texels.numpy().astype(np.float32)
    stored = np.abs(held.astype(np.float16) if texel is wp.vec4h else held)[..., 2].astype(float) * view.far
    column, row = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    left, right, bottom, top = view.window
    across = left + (right - left) * column / 60, top + (bottom - top) * row / 40
    along = view.forward_ws + across[0][..., None] * view.right_ws + across[1][..., None] * view.up_ws
    position = view.eye_ws + stored[..., None] * along
    samples = lamp.sample(rng.random((64, 3)))
    middle, radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low)
    hit = np.zeros((40, 60), bool)
    for sample in samples:
        way = sample[:3] - position * sample[3]
        longest = 1.0 if sample[3] else 1e3
        share = np.clip(((middle - position) * way).sum(-1) / (way * way).sum(-1), 0.0, longest)
        hit |= np.linalg.norm(position + share[..., None] * way - middle, axis=-1) <= radius
    cleared = (out[..., 1] == 0.0) & (out[..., 0] == 0.0)
    assert hit.sum() > 25 and cleared[hit].all()
    assert cleared.mean() < 3.0 * hit.mean() + 0.05
    np.testing.assert_array_equal(out[~cleared], texels.numpy().astype(np.float32)[~cleared])
    same = held.astype(np.float16).astype(np.float32) if texel is wp.vec4h else held
    np.testing.assert_array_equal(out[..., 2:], same[..., 2:])


def session_at(frame: int, device: str) -> Session:
    session = open_session(stop_and_go(), device)
    session.begin(frame)
    return session


@pytest.mark.parametrize(
    ("then", "now", "changes"),
    [
        (0, 1, 0),  # moves on
        (STOP + REST_FRAMES - 1, STOP + REST_FRAMES, 2),  # comes to rest
        (STOP + REST_FRAMES, STOP + REST_FRAMES + 1, 0),  # rests on
        (GO, GO + 1, 2),  # leaves
        (1, GO, 2),  # frames between were not rendered
    ],
)
def test_reach_is_asked_for_where_rest_changes(then: int, now: int, changes: int, device: str) -> None:
    session = session_at(now, device)
    assert len(reached_by_change(session, then, [session.light])) == changes

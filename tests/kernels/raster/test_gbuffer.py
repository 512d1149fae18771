"""The G-buffer against primary rays in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_scenes
from compare import assert_twin

from wkernels.frame.session import Session
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import CASTS, MOVES, RECEIVES, Geometry
from wkernels.scene.model import Scene

WIDTH, HEIGHT = 64, 48


def primary_hits(session: Session, overscan: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linear depth, triangle and rebased position of the nearest hit of every pixel's ray; (H, W[, 3])."""
    view = session.eye(session.margin(overscan))
    geometry = session.geometry
    corners = geometry.points_ws.numpy().astype(float)[geometry.indices.numpy().reshape(-1, 3)]
    left, right, bottom, top = view.window
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    along = (left + (right - left) * x.ravel() / view.width)[:, None] * view.right_ws
    along = along + (top + (bottom - top) * y.ravel() / view.height)[:, None] * view.up_ws + view.forward_ws
    t, _ = small_scenes.ray_hits(np.broadcast_to(view.eye_ws, along.shape), along, corners)
    t = np.where((t >= view.near) & (t <= view.far), t, np.inf)
    depth = t.min(axis=1)
    owner = np.where(np.isfinite(depth), t.argmin(axis=1), -1)
    position = view.eye_ws + np.where(np.isfinite(depth), depth, 0.0)[:, None] * along
    shape = (view.height, view.width)
    return depth.reshape(shape), owner.reshape(shape), position.reshape(*shape, 3)


def next_to_another_triangle(owner: np.ndarray) -> np.ndarray:
    """Pixels with a neighbour (of eight) that shows another triangle."""
    padded = np.pad(owner, 1, mode="edge")
    h, w = owner.shape
    shifts = [padded[1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    return np.any([shift != owner for shift in shifts], axis=0)


def position_error(session: Session, actual: np.ndarray, expected: np.ndarray, gbuffer: GBuffer) -> np.ndarray:
    """Distance (H, W) relative to the eye's, at a surface seen face on: a plane seen at a slant magnifies any rounding."""
    way = expected - session.eye().eye_ws
    distance = np.linalg.norm(way, axis=2)
    facing = np.abs(np.einsum("ijk,ijk->ij", way, gbuffer.normal_ws.numpy()))
    return np.linalg.norm(actual - expected, axis=2) * facing / np.maximum(distance, 1e-9) ** 2


def everything(device: str) -> Session:
    """Meshes with all kinds of flags."""
    lamp = small_scenes.light("rectangle")
    scene = small_scenes.cluttered(lamp)
    terrain, boxes, sphere = scene.meshes
    meshes = (
        replace(terrain, casts=False),
        boxes,
        replace(sphere, moving=True),
        small_scenes.mesh("ghost", small_scenes.box((-2.5, 1.0, 2.0), (1.0, 1.5, 1.0)), receives=False),
    )
    return Session(Geometry(replace(scene, meshes=meshes), device), width=WIDTH, height=HEIGHT, device=device)


@pytest.mark.parametrize("overscan", [0.0, 0.05])
def test_it_shows_what_rays_hit_on_all_but_silhouette_pixels(overscan: float, device: str) -> None:
    session = everything(device)
    gbuffer = session.gbuffer(overscan)
    depth, owner, position = primary_hits(session, overscan)
    got_owner = gbuffer.triangle.numpy()
    differs = got_owner != owner
    assert not (differs & ~next_to_another_triangle(owner)).any()
    assert differs.mean() < 0.02
    same = ~differs & (owner >= 0)
    assert same.mean() > 0.4 and (owner < 0).any()
    assert_twin(gbuffer.depth.numpy()[same], depth[same], rtol=1e-5)
    assert (position_error(session, gbuffer.position_ws.numpy(), position, gbuffer)[same] < 2e-6).all()
    assert np.isposinf(gbuffer.depth.numpy()[~differs & (owner < 0)]).all()


def test_normal_mesh_and_flags_are_those_of_the_triangle(device: str) -> None:
    session = everything(device)
    gbuffer, geometry = session.gbuffer(), session.geometry
    owner = gbuffer.triangle.numpy()
    seen = owner >= 0
    corners = geometry.points_ws.numpy().astype(float)[geometry.indices.numpy().reshape(-1, 3)][owner[seen]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    to_eye = session.eye().eye_ws - gbuffer.position_ws.numpy()[seen]
    normal *= np.where(np.einsum("ij,ij->i", normal, to_eye) < 0.0, -1.0, 1.0)[:, None]
    assert_twin(gbuffer.normal_ws.numpy()[seen], normal, atol=1e-5)

    starts = np.cumsum([0] + [len(mesh.faces) for mesh in geometry.meshes])
    mesh = np.searchsorted(starts, owner[seen], side="right") - 1
    np.testing.assert_array_equal(gbuffer.mesh.numpy()[seen], mesh)
    flags = np.array([CASTS * m.casts + RECEIVES * m.receives + MOVES * m.moving for m in geometry.meshes])
    np.testing.assert_array_equal(gbuffer.flags.numpy()[seen], flags[mesh])
    assert len(np.unique(flags[mesh])) == 4, "the scene must show every kind of mesh"
    for name, empty in (("mesh", -1), ("triangle", -1), ("flags", 0), ("normal_ws", 0.0), ("position_ws", 0.0)):
        assert (getattr(gbuffer, name).numpy()[~seen] == empty).all()


def test_overscan_keeps_the_receiver_points_of_the_plain_frame(device: str) -> None:
    session = everything(device)
    plain = session.gbuffer()
    fields = ("depth", "position_ws", "triangle", "flags", "normal_ws")
    expected = {name: getattr(plain, name).numpy().copy() for name in fields}
    wide = session.gbuffer(0.1)
    mx, my = session.margin(0.1)
    assert wide.depth.shape == (HEIGHT + 2 * my, WIDTH + 2 * mx) and mx > 0 and my > 0
    middle = (slice(my, my + HEIGHT), slice(mx, mx + WIDTH))
    same = wide.triangle.numpy()[middle] == expected["triangle"]
    assert same.mean() > 0.995  # pixel coordinates round differently, so single edge pixels may flip
    seen = same & (expected["triangle"] >= 0)
    np.testing.assert_array_equal(wide.flags.numpy()[middle][same], expected["flags"][same])
    assert_twin(wide.normal_ws.numpy()[middle][seen], expected["normal_ws"][seen], atol=1e-6)
    moved = position_error(session, wide.position_ws.numpy()[middle], expected["position_ws"], session.gbuffer())
    assert (moved[seen] < 4e-6).all()


def test_positions_lie_on_their_planes_at_grazing_angles(device: str) -> None:
    """A receiver point off its plane would shadow itself."""
    ground = small_scenes.mesh("ground", small_scenes.plane(2000.0))
    view = small_scenes.camera((0.0, 0.05, 0.0), (1.0, 0.049, 0.3), near=0.01, far=5000.0)
    scene = small_scenes.scene([ground], small_scenes.light("point"), view)
    session = Session(Geometry(scene, device), width=6, height=480, device=device)
    gbuffer = session.gbuffer()
    seen = gbuffer.triangle.numpy() >= 0
    assert seen.mean() > 0.4
    height = gbuffer.position_ws.numpy()[seen][:, 1]
    distance = gbuffer.depth.numpy()[seen]
    assert distance.max() > 100.0 * distance.min()
    assert (np.abs(height) <= 4e-7 * distance + 1e-8).all()


def test_the_eye_inside_the_geometry_sees_it(device: str) -> None:
    inside = small_scenes.mesh("room", small_scenes.box((0.0, 0.0, 0.0), (4.0, 3.0, 5.0)))
    view = small_scenes.camera((0.5, 0.2, 1.0), (-1.0, -0.4, -1.0), near=0.5, fov_deg=100.0)
    scene: Scene = small_scenes.scene([inside], small_scenes.light("point", (0.0, 1.0, 0.0)), view)
    session = Session(Geometry(scene, device), width=33, height=31, device=device)
    gbuffer = session.gbuffer()
    depth, owner, _ = primary_hits(session)
    assert (gbuffer.triangle.numpy() >= 0).all() and (owner >= 0).all()
    assert_twin(gbuffer.depth.numpy(), depth, rtol=2e-5)
    away = np.einsum("ijk,ijk->ij", gbuffer.normal_ws.numpy(), gbuffer.position_ws.numpy())
    assert (away < 0.0).all(), "normals face the eye, also on the inside of a box"

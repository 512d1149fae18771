"""Cut-outs against NumPy: alpha at texture coordinates, what the eye sees of a card, and what rays meet of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import small_scenes
import warp as wp
from sessions import open_session

from wkernels.device.launch import launch
from wkernels.errors import InputError
from wkernels.raster import Rasteriser
from wkernels.rays.shaft_rays import trace_shafts
from wkernels.rays.single_rays import trace_light
from wkernels.scene.cutouts import WRAPS, Cutout, Cutouts, Mask, alpha_at, upload_cutouts
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Mesh, Scene


def alpha_by_hand(mask: Mask, uv: np.ndarray) -> np.ndarray:
    """Alpha at texture coordinates (N, 2), texel by texel."""
    height, width = mask.alpha.shape

    def texel(index: np.ndarray, size: int, wrap: str) -> np.ndarray:
        if wrap == "clamp":
            return np.clip(index, 0, size - 1)
        if wrap == "repeat":
            return index % size
        index = index % (2 * size)
        return np.where(index < size, index, 2 * size - 1 - index)

    def at(column: np.ndarray, row: np.ndarray) -> np.ndarray:
        picked = texel(row, height, mask.wrap[1]), texel(column, width, mask.wrap[0])
        return np.asarray(mask.alpha[picked], np.float64)

    x, y = uv[:, 0] * width, uv[:, 1] * height
    if mask.nearest:
        return at(np.floor(x).astype(int), np.floor(y).astype(int))
    i, j = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    s, t = x - 0.5 - i, y - 0.5 - j
    upper = at(i, j) * (1 - s) + at(i + 1, j) * s
    lower = at(i, j + 1) * (1 - s) + at(i + 1, j + 1) * s
    return upper * (1 - t) + lower * t


@wp.kernel
def ask_alpha(first: int, cutouts: Cutouts, which: int, uv: wp.array(dtype=wp.vec2), out: wp.array(dtype=float)):
    i = first + wp.tid()
    own = cutouts.textures[which]
    out[i] = alpha_at(cutouts, own, uv[i])


@pytest.mark.parametrize("wrap", [("repeat", "mirror"), ("mirror", "clamp"), ("clamp", "repeat")])
@pytest.mark.parametrize("nearest", [False, True])
def test_alpha_is_that_of_the_texels(wrap: tuple, nearest: bool, device: str) -> None:
    rng = np.random.default_rng(3)
    card = small_scenes.plane(2.0)
    other = Mask(np.zeros((4, 2)), rng.random((2, 2)), 0.5)
    mask = Mask(np.zeros((4, 2)), rng.random((5, 7)), 0.5, wrap, nearest)
    meshes = [Mesh("other", *card, mask=other), Mesh("plain", *card), Mesh("card", *card, mask=mask)]
    cutouts = upload_cutouts(meshes, device)
    assert cutouts.count == 2 and cutouts.texture.numpy().tolist() == [0] * 4 + [-1] * 4 + [1] * 4
    uv = rng.uniform(-3.0, 4.0, (2000, 2)).astype(np.float32)
    uv = uv[np.all(np.abs(uv * [7, 5] - np.round(uv * [7, 5])) > 1e-4, axis=1)]  # not within rounding of a texel's edge
    out = wp.zeros(len(uv), dtype=float, device=device)
    launch(ask_alpha, len(uv), [cutouts, 1, wp.array(uv, dtype=wp.vec2, device=device)], [out], device=device)
    np.testing.assert_allclose(out.numpy(), alpha_by_hand(mask, uv.astype(np.float64)), atol=2e-5)


def test_a_texture_that_meshes_share_is_held_once() -> None:
    card, alpha = small_scenes.plane(2.0), np.ones((16, 16))
    uv = card[0][:, [0, 2]]
    meshes = [Mesh("a", *card, mask=Mask(uv, alpha)), Mesh("b", *card, mask=Mask(uv, alpha, 0.7))]
    cutouts = upload_cutouts(meshes)
    assert cutouts.alpha.shape == (256,) and cutouts.count == 2
    assert isinstance(cutouts.textures.numpy()[1]["cutoff"], np.floating | float)
    assert set(WRAPS) == {"repeat", "mirror", "clamp"} and Cutout is not None


def slanted(seed: int = 0, nearest: bool = False) -> Scene:
    """A card that stands askew above the ground, reaches behind the eye, and is cut out by random texels."""
    vertices, faces = small_scenes.plane(8.0, cells=3)
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axes *= np.sign(axes[1, 1])
    uv = vertices[:, [0, 2]] / 8.0 * 3.0
    mask = Mask(uv, rng.random((6, 5)), 0.5, ("repeat", "mirror"), nearest)
    placed = vertices @ (0.25 * axes + 0.75 * np.eye(3)).T + [0.0, 2.5, 1.0]
    ground = small_scenes.mesh("ground", small_scenes.plane(14.0))
    block = small_scenes.mesh("block", small_scenes.box((1.0, 0.5, 0.0), (1.0, 1.0, 1.0)))
    card = Mesh("card", placed, faces, mask=mask)
    return small_scenes.scene([ground, card, block], small_scenes.light("rectangle"))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_eye_sees_the_card_where_its_texels_are(seed: int, device: str) -> None:
    """By rays in float64 through pixel centres against every triangle, cards asked for their alpha."""
    scene = slanted(seed)
    session = open_session(scene, device, size=(60, 44))
    gbuffer, view = session.gbuffer(), session.eye()
    meshes = session.geometry.meshes
    best, owner = np.full((44, 60), np.inf), np.full((44, 60), -1)
    unsure = np.zeros((44, 60), bool)
    column, row = np.meshgrid(np.arange(60) + 0.5, np.arange(44) + 0.5)
    left, right, bottom, top = view.window
    x = left + (right - left) * column / 60
    y = top + (bottom - top) * row / 44
    way = view.forward_ws + x[..., None] * view.right_ws + y[..., None] * view.up_ws
    for number, mesh in enumerate(meshes):
        for face in mesh.faces:
            a, b, c = mesh.vertices[face] - session.geometry.origin_ws - view.eye_ws
            weights = np.stack([way @ np.cross(b, c), way @ np.cross(c, a), way @ np.cross(a, b)], axis=-1)
            total = weights.sum(axis=-1)
            share = weights / total[..., None]
            depth = np.dot(np.cross(b - a, c - a), a) / (way @ np.cross(b - a, c - a))
            hit = np.all(share >= 0.0, axis=-1) & (depth > view.near) & (depth < best)
            unsure |= np.any(np.abs(share) < 0.02, axis=-1) & np.all(share > -0.05, axis=-1) & (depth > 0.0)
            if mesh.mask is not None:
                alpha = alpha_by_hand(mesh.mask, (share @ mesh.mask.uv[face]).reshape(-1, 2)).reshape(hit.shape)
                unsure |= hit & (np.abs(alpha - mesh.mask.cutoff) < 0.02)
                hit &= alpha >= mesh.mask.cutoff
            best, owner = np.where(hit, depth, best), np.where(hit, number, owner)
    card = next(i for i, mesh in enumerate(meshes) if mesh.mask is not None)
    assert 0.05 < (owner == card).mean() < 0.95
    sure = ~unsure
    assert sure.mean() > 0.5
    np.testing.assert_array_equal(gbuffer.mesh.numpy()[sure], owner[sure])


def test_all_paths_of_the_rasteriser_draw_the_same(device: str) -> None:
    """Lanes with the cut triangles drawn over, all of it plainly, peeled, and from many views at once."""
    geometry = Geometry(slanted(4), device)
    session = open_session(slanted(4), device, size=(96, 64))
    view = session.eye().to_device()
    images = []
    for path in ("lanes", "tiles"):
        rasteriser = Rasteriser(device, 2, path)  # type: ignore[arg-type]
        depths = [wp.zeros((64, 96), dtype=float, device=device) for _ in range(4)]
        owners = [wp.zeros((64, 96), dtype=int, device=device) for _ in range(4)]
        given = geometry.points_ws, geometry.indices
        rasteriser.draw(*given, view, depths[0], owners[0], cutouts=geometry.cutouts)
        rasteriser.draw_many(*given, [view], [depths[1]], [owners[1]], cutouts=geometry.cutouts)
        rasteriser.peel(*given, view, depths[2:], owners[2:], cutouts=geometry.cutouts)
        images.append([array.numpy() for array in (*depths, *owners)])
    whole = wp.zeros((64, 96), dtype=float, device=device)
    Rasteriser(device, 2).draw(geometry.points_ws, geometry.indices, view, whole)
    for one, other in zip(*images, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
    depth, many, near, far, owner, _, first, _ = images[0]
    np.testing.assert_array_equal(many, depth)
    np.testing.assert_allclose(near, depth, rtol=1e-6)
    np.testing.assert_array_equal(first, owner)
    assert ((far > near) | ~np.isfinite(near)).all()
    assert (whole.numpy() < depth).mean() > 0.05, "the card hides more where it is not cut"


@pytest.mark.parametrize("kind", ["rectangle", "directional"])
def test_shafts_meet_what_single_rays_meet(kind: str) -> None:
    for seed in range(3):
        scene = small_scenes.scene(slanted(seed).meshes, small_scenes.light(kind, (2.0, 9.0, 1.0), 2.5))
        session = open_session(scene, "cpu", size=(64, 48))
        gbuffer, lit, hull = session.gbuffer(), session.light_samples(64), session.light_hull()
        images = []
        for kernel, inputs in (
            (trace_shafts, [gbuffer, session.caster_tree(), lit.batches, hull, 1]),
            (trace_light, [gbuffer, session.caster_mesh(), lit.points_ws, lit.weights, hull, 1]),
        ):
            visibility = wp.zeros((48, 64), dtype=float)
            session.launch(kernel, (48, 64), inputs, [visibility, wp.zeros((48, 64), dtype=int)])
            images.append(visibility.numpy())
        difference = 64.0 * (images[0] - images[1])
        assert (np.abs(difference) > 0.01).mean() <= 0.02 and np.abs(difference).max() <= 2.01
        solid = small_scenes.scene([Mesh(m.name, m.vertices, m.faces) for m in scene.meshes], scene.lights[0])
        plain = open_session(solid, "cpu", size=(64, 48))
        visibility = wp.zeros((48, 64), dtype=float)
        inputs = [gbuffer, plain.caster_tree(), lit.batches, hull, 1]
        plain.launch(trace_shafts, (48, 64), inputs, [visibility, wp.zeros((48, 64), dtype=int)])
        assert (images[0] - visibility.numpy()).mean() > 0.02, "light comes through the holes"


def test_a_card_that_moves_takes_its_holes_along(device: str) -> None:
    """In the tree of boxes, in Warp's structures and in the rasteriser."""
    still = slanted(1)
    card = next(mesh for mesh in still.meshes if mesh.mask is not None)

    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[:3, 3] = [0.3 * frame, 0.1 * frame, 0.0]
        return out

    moving = Mesh(card.name, card.vertices, card.faces, mask=card.mask, object_to_ws=pose, moving=True)
    there = Mesh(card.name, card.vertices + pose(2)[:3, 3], card.faces, mask=card.mask)
    others = [mesh for mesh in still.meshes if mesh is not card]
    images = []
    for scene, frames in (([*others, moving], (0, 2)), ([*others, there], (2,))):
        session = open_session(small_scenes.scene(scene, still.lights[0]), device)
        for frame in frames:
            session.begin(frame)
            gbuffer, lit, hull = session.gbuffer(), session.light_samples(16), session.light_hull()
            visibility = [wp.zeros(gbuffer.depth.shape, dtype=float, device=device) for _ in range(2)]
            proof = wp.zeros(gbuffer.depth.shape, dtype=int, device=device)
            rays = [gbuffer, session.caster_mesh(), lit.points_ws, lit.weights, hull, 0]
            session.launch(trace_light, proof.shape, rays, [visibility[0], proof])
            if device == "cpu":
                shafts = [gbuffer, session.caster_tree(), lit.batches, hull, 1]
                session.launch(trace_shafts, proof.shape, shafts, [visibility[1], proof])
        images.append([gbuffer.mesh.numpy() == [m.name for m in session.geometry.meshes].index("card")])
        images[-1] += [array.numpy() for array in visibility]
    for one, other in zip(*images, strict=True):
        assert (np.abs(one.astype(float) - other) > 0.01).mean() <= 0.02


def test_what_needs_outlines_refuses_a_cut_caster() -> None:
    geometry = Geometry(slanted())
    with pytest.raises(InputError, match=r"silhouettes need whole casters; the mesh 'card' is cut out by a texture\."):
        geometry.require_whole("silhouettes")
    lit = small_scenes.scene([Mesh(m.name, m.vertices, m.faces) for m in slanted().meshes], slanted().lights[0])
    Geometry(lit).require_whole("silhouettes")
    assert all(low <= high for low, high in pairwise([0, geometry.caster_triangles]))

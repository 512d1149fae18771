"""Checks of single images: what they are, what they must not depend on, and what they must equal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import small_scenes
from compare import assert_same_image, rmse
from rig import (
    a_piece_apart,
    behind_two_casters,
    check,
    kinds_of,
    lamp,
    moved_world,
    overlapping_boxes,
    render,
    scaled,
    scenes_for,
    small_params,
    small_session,
    takes_any_mesh,
    truth,
)

from algorithms.plugins import find
from algorithms.technique import Technique
from experiments.schema.needs import unmet_need
from wkernels.frame.session import FrameResult
from wkernels.scene.cutouts import Mask
from wkernels.scene.geometry import RECEIVES
from wkernels.scene.lights import Light
from wkernels.scene.model import Camera, Scene


def frames_of(technique: type[Technique]) -> int:
    """Frames after which an image is worth looking at."""
    return 3 if technique.needs.history else 1


def assert_is_visibility(result: FrameResult, size: tuple[int, int], receives: np.ndarray) -> None:
    width, height = size
    assert result.visibility.shape == (height, width) and result.visibility.dtype == np.float32
    np.testing.assert_array_equal(np.isfinite(result.visibility), receives)
    seen = result.visibility[receives]
    assert (seen >= 0.0).all() and (seen <= 1.0).all(), f"from {seen.min()} to {seen.max()}"
    if result.standard_error is not None:
        assert result.standard_error.shape == (height, width)
        error = result.standard_error[receives]
        assert np.isfinite(error).all() and (error >= 0.0).all() and (error <= 1.0).all()


@check()
def image_is_visibility(technique: type[Technique], device: str) -> None:
    """Shape, type, receivers, range; at odd sizes, without anything to see, and with the default parameters."""
    cases = [(scene, (64, 48), small_params(technique)) for scene in scenes_for(technique)]
    away = Camera(np.array([0.0, 6.0, 8.0]), np.array([0.0, 60.0, 8.0]), np.array([0.0, 0.0, 1.0]), 50.0, 0.1, 100.0)
    cases += [(cases[0][0], (33, 17), cases[0][2]), (cases[0][0], (1, 1), cases[0][2])]
    cases += [(replace(cases[0][0], camera=lambda frame: away), (16, 12), cases[0][2])]
    cases += [(cases[0][0], (16, 12), technique.Params())]
    for scene, size, params in cases:
        result = render(technique, scene, device, params=params, size=size, frames=frames_of(technique))
        plain = small_session(scene, device, size=size).gbuffer()
        assert_is_visibility(result, size, (plain.flags.numpy() & RECEIVES) != 0)


@check()
def a_scene_without_meshes_is_no_error(technique: type[Technique], device: str) -> None:
    for skips in (True, False):
        empty = small_scenes.scene([], lamp(technique))
        result = render(technique, empty, device, skips=skips, size=(16, 12), frames=frames_of(technique))
        assert_is_visibility(result, (16, 12), np.zeros((12, 16), bool))


@check()
def same_bits_on_any_number_of_threads(technique: type[Technique], device: str) -> None:
    for scene in scenes_for(technique):
        images = [
            render(technique, scene, device, threads=threads, size=(100, 70), frames=frames_of(technique))
            for threads in (1, 2, 3)
        ]
        for image in images[1:]:
            np.testing.assert_array_equal(image.visibility, images[0].visibility)
            np.testing.assert_array_equal(image.standard_error, images[0].standard_error)


@check()
def same_bits_from_the_same_seed(technique: type[Technique], device: str) -> None:
    scene = scenes_for(technique)[-1]
    frames = frames_of(technique)
    for seed in (1, 7):
        first, second = (render(technique, scene, device, seed=seed, frames=frames).visibility for _ in range(2))
        np.testing.assert_array_equal(first, second)


@check()
def without_casters_all_is_lit(technique: type[Technique], device: str) -> None:
    scene = small_scenes.box_on_ground(lamp(technique))
    nothing_casts = replace(scene, meshes=tuple(replace(mesh, casts=False, receives=True) for mesh in scene.meshes))
    for skips in (True, False):
        visibility = render(technique, nothing_casts, device, skips=skips, frames=frames_of(technique)).visibility
        assert np.nanmin(visibility) == 1.0, f"down to {np.nanmin(visibility)}, skips {'on' if skips else 'off'}"


@check()
def behind_an_opaque_slab_all_is_dark(technique: type[Technique], device: str) -> None:
    """One closed slab hides the whole light from the whole receiver."""
    slab = small_scenes.mesh("slab", small_scenes.box((0.0, 7.5, 0.0), (60.0, 0.5, 60.0)), receives=False)
    ground = small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False)
    for kind in kinds_of(technique):
        scene = small_scenes.scene([ground, slab], small_scenes.light(kind))
        visibility = render(technique, scene, device, frames=frames_of(technique)).visibility
        assert np.nanmax(visibility) <= 2e-3, f"up to {np.nanmax(visibility)} under {kind}"


def rotation(seed: int) -> np.ndarray:
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return axes * np.linalg.det(axes)


@check()
def turning_the_world_changes_nothing(technique: type[Technique], device: str) -> None:
    """Maps look from elsewhere afterwards and their texels have another size, so edges may move a little.

    The light is far enough away to stay outside the box round the turned scene, which one map covers before and after.
    """
    params = small_params(technique, resolution=1024)
    frames = 16 if technique.needs.history else 1
    high = lamp(technique, centre=(0.0, 30.0, 0.0), size=4.0)
    for scene in scenes_for(technique):
        scene = replace(scene, lights=(high,))
        expected = render(technique, scene, device, params=params, frames=frames).visibility
        moved = moved_world(scene, rotation(3), np.array([30.0, -20.0, 50.0]))
        actual = render(technique, moved, device, params=params, frames=frames).visibility
        assert_same_image(actual, expected, tolerance=0.15, flips=0.04, biased=True)
        difference = actual - expected
        mean, spread = float(np.nanmean(difference)), float(np.sqrt(np.nanmean(difference**2)))
        assert abs(mean) < 0.008 and spread < 0.08, f"differs by {mean:+.4f} in the mean, {spread:.4f} rms"


@check()
def moving_the_world_a_million_units_changes_nothing(technique: type[Technique], device: str) -> None:
    offset = np.array([1e6, -1e6, 1e6])
    for scene in scenes_for(technique):
        expected = render(technique, scene, device, frames=frames_of(technique)).visibility
        actual = render(
            technique, moved_world(scene, np.eye(3), offset), device, frames=frames_of(technique)
        ).visibility
        assert_same_image(actual, expected, tolerance=1e-3, flips=0.005)


@check()
def inputs_are_left_untouched(technique: type[Technique], device: str) -> None:
    arrays = ("points_ws", "indices", "triangle_normal_ws", "triangle_mesh", "mesh_flags", "mesh_diffuse")
    fields = ("depth", "position_ws", "normal_ws", "mesh", "triangle", "flags")
    for scene in scenes_for(technique):
        session = small_session(scene, device)
        geometry, gbuffer = session.geometry, session.gbuffer()
        before = {name: getattr(geometry, name).numpy().copy() for name in arrays}
        before |= {name: getattr(gbuffer, name).numpy().copy() for name in fields}
        session.render(technique(small_params(technique)))
        for name, value in before.items():
            source = geometry if name in arrays else gbuffer
            np.testing.assert_array_equal(getattr(source, name).numpy(), value, err_msg=f"{name} was written to")


def low_box(light: Light) -> Scene:
    """A closed box near the ground: with the light close by it takes all six faces of a cube to cover the receiver."""
    return small_scenes.scene(
        [
            small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False),
            small_scenes.mesh("box", small_scenes.box((0.3, 0.6, -0.4), (2.0, 0.6, 1.2)), receives=False),
        ],
        light,
    )


@check()
def every_light_kind_casts_its_shadow(technique: type[Technique], device: str) -> None:
    params = small_params(technique)
    frames = 8 if technique.needs.history else 1
    places = [(small_scenes.box_on_ground, (1.0, 9.0, -2.0), 1.5), (low_box, (0.2, 1.9, 1.6), 0.3)]
    for kind in kinds_of(technique):
        for build, centre, size in places if kind != "directional" else places[:1]:
            scene = build(small_scenes.light(kind, centre, size))
            visibility = render(technique, scene, device, params=params, frames=frames).visibility
            expected = truth(technique, build, device, kind, centre, size)
            assert np.nanmin(expected) < 0.1 and np.nanmax(expected) > 0.9
            error = rmse(visibility, expected)
            assert error < 0.2, f"rmse {error:.3f} under {kind} at {centre}"
            assert np.corrcoef(visibility[np.isfinite(expected)], expected[np.isfinite(expected)])[0, 1] > 0.8, kind


def checkered_card(light: Light, cut_by_texture: bool, casts: bool = True) -> Scene:
    """Half of a card above the ground, two of four squares: cut out by a texture, or as two squares.

    One that does not cast lies below a box that does.
    """
    others = [small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False)]
    if not casts:
        others.append(small_scenes.mesh("box", small_scenes.box((0.4, 3.5, -0.3), (1.4, 0.5, 1.0)), receives=False))
    vertices, faces = small_scenes.plane(3.0, y=2.0, cells=2)
    if not cut_by_texture:
        kept = np.isin(np.arange(len(faces)) % 4, (0, 3))  # of the grid's squares, row by row, twice
        used = np.unique(faces[kept])
        squares = vertices[used], np.searchsorted(used, faces[kept]).astype(np.int32)
        return small_scenes.scene([*others, small_scenes.mesh("card", squares, casts=casts)], light)
    whole = small_scenes.plane(3.0, y=2.0)
    mask = Mask(whole[0][:, [0, 2]] / 3.0 + 0.5, np.eye(2), 0.5, ("clamp", "clamp"), nearest=True)
    return small_scenes.scene([*others, small_scenes.mesh("card", whole, mask=mask, casts=casts)], light)


@check()
def a_cut_out_caster_shades_by_what_is_left_of_it(technique: type[Technique], device: str) -> None:
    """A card that is cut out casts and receives as the squares that are left; who cannot do so refuses it."""
    cut, squares = (checkered_card(lamp(technique), by_texture) for by_texture in (True, False))
    if technique.needs.whole_casters or technique.needs.closed_meshes:
        assert unmet_need(technique, cut, cut.lights[0]) is not None, "is not refused beforehand"
        return
    assert_same_card(technique, cut, squares, device)


@check()
def a_cut_out_receiver_shows_what_is_left_of_it(technique: type[Technique], device: str) -> None:
    """One that does not cast, so that techniques that need whole casters take it, too."""
    assert_same_card(technique, *(checkered_card(lamp(technique), cut, casts=False) for cut in (True, False)), device)


def assert_same_card(technique: type[Technique], cut: Scene, squares: Scene, device: str) -> None:
    frames = frames_of(technique)
    a, b = (render(technique, scene, device, size=(96, 72), frames=frames).visibility for scene in (cut, squares))
    differs = ~np.isclose(a, b, atol=2e-3, equal_nan=True)
    assert differs.mean() <= 0.006, f"{differs.mean():.4f} of the pixels differ from those of two squares"


@check(lambda technique: bool(technique.limits))
def equals_others_in_its_limits(technique: type[Technique], device: str) -> None:
    for limit in technique.limits:
        other = find(limit.equals)
        common = set(kinds_of(technique)) & set(other.needs.lights)
        scenes = [small_scenes.box_on_ground, *([small_scenes.cluttered] if takes_any_mesh(technique) else [])]
        for build in scenes:
            kind = next(kind for kind in kinds_of(technique) if kind in common)
            scene = build(scaled(small_scenes.light(kind), limit.light_scale))
            own_params = small_params(technique).model_copy(update=limit.params)
            other_params = small_params(other).model_copy(update=limit.other_params)
            actual = render(technique, scene, device, params=own_params, frames=limit.frames).visibility
            expected = render(other, scene, device, params=other_params).visibility
            assert np.nanmin(expected) < 0.1 and np.nanmax(expected) > 0.9
            assert_same_image(actual, expected, tolerance=limit.tolerance, flips=limit.flips, biased=True)


@check()
def bias_sign_is_as_declared(technique: type[Technique], device: str) -> None:
    """The mean signed error where penumbrae of casters at different heights meet, and where two casters hide the light.

    A tenth of the root mean square error counts as none. ``none`` says that there is no more in either scene (of others
    it says nothing); ``lighter`` that there is more in one of them and no darkness in the other, ``darker`` vice versa.
    Where ``bias_turns`` is declared, the opposite of the sign is to be seen where a caster has a piece apart.
    """
    kind = kinds_of(technique)[0]
    params, frames = small_params(technique, resolution=1024, samples=64), 32 if technique.needs.history else 1
    excess, text = [], f"declared '{technique.bias_sign}'"
    for build in (overlapping_boxes, behind_two_casters, *([a_piece_apart] if technique.bias_turns else [])):
        scene = build(small_scenes.light(kind, size=2.0))
        error = render(technique, scene, device, params=params, frames=frames).visibility
        error = error - truth(technique, build, device, kind, size=2.0)
        mean, slack = float(np.nanmean(error)), 0.001 + 0.1 * float(np.sqrt(np.nanmean(error**2)))
        excess.append(mean / slack)
        text += f", {build.__name__}: mean error {mean:+.4f}, slack {slack:.4f}"
    if technique.bias_turns:
        turned = excess.pop() * (-1.0 if technique.bias_sign == "lighter" else 1.0)
        assert turned > 1.0, f"{text}: where {technique.bias_turns}, the sign does not turn"
    wrong_way, right_way = {
        "none": (max(map(abs, excess)), np.inf),
        "lighter": (-min(excess), max(excess)),
        "darker": (max(excess), -min(excess)),
    }[technique.bias_sign]
    assert wrong_way <= 1.0, text
    assert right_way > 1.0, f"{text}: not to be seen"

"""Hard shadow volumes against rays to the light's centre: any light, any caster, any eye; and where z-pass fails, with its sign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_scenes
import trimesh
from compare import assert_same_image, edge_band
from sessions import open_session, render, render_frames, technique, true_visibility

from experiments import render_visibility
from experiments.scenes import analytic
from wkernels.casters.volume_counts import Uncounted
from wkernels.scene.model import Camera, Mesh, Scene
from wkernels.workspace.products import Product

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
SIZE = (320, 240)
EDGE_PIXELS = 0.002  # share of receiver pixels that may differ: corners are drawn on a grid of 1/256 pixel
KINDS = ("point", "directional", "rectangle", "disc", "sphere", "linear", "polygon")
VOLUMES: dict[str, tuple[str, dict[str, Any]]] = {
    "zpass": ("shadow_volume_zpass", {}),
    "zpass, nonzero": ("shadow_volume_zpass", {"shadowed": "nonzero"}),
    "zpass, per caster": ("shadow_volume_zpass", {"volume": "per_caster"}),
    "zfail": ("shadow_volume_zfail", {"volume": "zfail"}),
    "zfail, per caster": ("shadow_volume_zfail", {"volume": "per_caster"}),
}
AT_EYE = Uncounted.AT_EYE.pair
ANY_EYE = ("zpass, per caster", "zfail", "zfail, per caster")


def at(centre: tuple[float, float, float], shape: trimesh.Trimesh) -> small_scenes.Triangles:
    return np.asarray(shape.vertices) + np.array(centre), np.asarray(shape.faces, np.int32)


def ten_bodies() -> list[Mesh]:
    """Ten closed meshes that cast on each other and on themselves."""
    turned = trimesh.transformations.euler_matrix(0.5, 0.3, 0.9)
    torus, tube = trimesh.creation.torus(0.7, 0.25), trimesh.creation.annulus(0.3, 0.5, 0.9)
    capsule, cone = trimesh.creation.capsule(0.8, 0.3), trimesh.creation.cone(0.5, 1.0)
    for shape in (torus, tube, capsule, cone):
        shape.apply_transform(turned)
    shapes = {
        "box": small_scenes.box((0.3, 2.2, -0.2), (1.6, 0.6, 1.2)),
        "ball": small_scenes.sphere((1.8, 1.2, 0.9), 0.7),
        "boxes": small_scenes.random_boxes(3, seed=5),
        "torus": at((-1.6, 1.6, 0.6), torus),
        "tube": at((-0.4, 0.9, 1.9), tube),
        "capsule": at((2.2, 2.4, -1.4), capsule),
        "cone": at((-2.2, 0.9, -1.6), cone),
        "icosphere": at((0.2, 3.4, -1.8), trimesh.creation.icosphere(2, 0.5)),
        "cylinder": at((2.4, 0.5, 2.2), trimesh.creation.cylinder(0.4, 0.9)),
        "standing box": small_scenes.box((-1.2, 0.75, -0.6), (0.5, 1.5, 0.5)),
    }
    return [small_scenes.mesh(name, shape) for name, shape in shapes.items()]


def bodies_on_ground(kind: str = "point", camera: Camera | None = None) -> Scene:
    ground = small_scenes.mesh("ground", small_scenes.plane(12.0, cells=4))
    return small_scenes.scene([ground, *ten_bodies()], small_scenes.light(kind, (1.5, 9.0, 2.0)), camera)


def picture(scene: Scene, device: str, how: str, **options: Any) -> np.ndarray:
    name, params = VOLUMES[how]
    return render(scene, device, name, {"size": SIZE, **options}, **params).visibility


@pytest.mark.parametrize("kind", KINDS)
def test_equal_to_rays_but_for_edge_pixels(kind: str, device: str) -> None:
    """Ten closed meshes, all light kinds; of soft lights the centre."""
    scene = bodies_on_ground(kind)
    expected = true_visibility(scene, device, size=SIZE, centre=True)
    assert 0.1 < np.nanmean(expected) < 0.95
    for how in VOLUMES:
        assert_same_image(picture(scene, device, how), expected, flips=EDGE_PIXELS, biased=True)


EYES: Mapping[str, Camera] = {
    "in shadow": small_scenes.camera((-0.2, 0.8, -0.6), (-3.0, 0.0, 3.0), near=0.02),
    "in a caster": small_scenes.camera((0.3, 2.2, -0.2), (-2.0, 0.0, 3.0), near=0.02),
    "near plane cuts volumes": small_scenes.camera((1.0, 2.0, 4.0), (0.0, 0.3, 0.0), near=2.5, fov_deg=75.0),
    "near plane cuts a caster": small_scenes.camera((0.5, 4.6, 0.6), (0.0, 0.0, -0.5), near=2.2),
}


@pytest.mark.parametrize("kind", ["point", "directional"])
@pytest.mark.parametrize("eye", EYES)
def test_the_eye_may_be_anywhere(eye: str, kind: str, device: str) -> None:
    """In shadow, in a caster, its near plane in volumes: right behind what is seen, wrong before it."""
    scene = bodies_on_ground(kind, EYES[eye])
    expected = true_visibility(scene, device, size=SIZE, centre=True)
    images = {how: picture(scene, device, how) for how in VOLUMES}
    for how in ANY_EYE:
        assert_same_image(images[how], expected, flips=EDGE_PIXELS, biased=True)
        np.testing.assert_array_equal(images[how], images["zfail"])
    if eye != "in a caster":  # which shows little but its own dark inside
        wrong = np.isfinite(expected) & (images["zpass"] != expected)
        assert wrong.sum() > 10 * EDGE_PIXELS * np.isfinite(expected).sum()


def eye_in_the_shadow_of_a_roof() -> Scene:
    """An eye under a roof that looks out on ground in its shadow and in the light."""
    roof = small_scenes.mesh("roof", small_scenes.box((0.0, 3.0, 0.0), (4.0, 0.4, 4.0)), receives=False)
    post = small_scenes.mesh("post", small_scenes.box((0.6, 0.6, 3.0), (0.4, 1.2, 0.4)), receives=False)
    ground = small_scenes.mesh("ground", small_scenes.plane(14.0), casts=False)
    eye = small_scenes.camera((0.0, 1.2, -1.0), (0.3, 0.0, 3.0), near=0.02, fov_deg=70.0)
    return small_scenes.scene([ground, roof, post], small_scenes.light("point", (0.0, 9.0, 0.5)), eye)


def test_zpass_fails_with_the_eye_in_shadow_and_the_sign_is_known(device: str) -> None:
    """Every count lacks the 1 of the eye's own volume.

    "Positive" loses exactly that volume's shadow, so it is too light; "anything but zero" has light and that shadow change
    places. A second caster within the light, whose count is 0 instead of 1, is lost by both.
    """
    scene = eye_in_the_shadow_of_a_roof()
    expected = true_visibility(scene, device, size=SIZE, centre=True)
    edges = edge_band(expected)
    seen = np.isfinite(expected) & ~edges
    dark, lit = seen & (expected == 0.0), seen & (expected == 1.0)
    assert dark.mean() > 0.1 and lit.mean() > 0.1
    positive, nonzero = picture(scene, device, "zpass"), picture(scene, device, "zpass, nonzero")
    assert (positive[dark] == 1.0).all() and (positive[lit] == 1.0).all()
    assert np.nanmean(positive - expected) > 0.1
    assert (nonzero[lit] == 0.0).all() and (nonzero[dark] == 1.0).all()
    for how in ANY_EYE:
        assert_same_image(picture(scene, device, how), expected, flips=EDGE_PIXELS, biased=True)
    told = {
        how: [count for what, why, count in render(scene, device, name, **params).left_out if (what, why) == AT_EYE]
        for how, (name, params) in VOLUMES.items()
    }
    assert told == {how: [1] if how.startswith("zpass") and how not in ANY_EYE else [] for how in VOLUMES}


def broken(name: str) -> list[Mesh]:
    """Casters that are open, branch, are turned over, repeated, or inside out, and receive too."""
    vertices, faces = small_scenes.box((0.3, 2.0, -0.2), (2.0, 1.0, 1.6))
    fin = np.concatenate([vertices, [(0.3, 3.4, 0.1)]]), np.concatenate([faces, [[faces[0, 0], faces[0, 1], 8]]])
    shapes: dict[str, list[small_scenes.Triangles]] = {
        "open box": [(vertices, faces[2:])],
        "sheet": [small_scenes.terrain(3.0, 6, 0.9)],
        "fin on a box": [fin],
        "some faces turned over": [(vertices, np.concatenate([faces[:5, ::-1], faces[5:]]))],
        "some faces twice": [(vertices, np.concatenate([faces, faces[:7]]))],
        "inside out": [(vertices, faces[:, ::-1])],
        "one box through another": [(vertices, faces), small_scenes.box((0.9, 2.1, 0.3), (1.4, 0.5, 2.0))],
        "no area and no numbers": [
            (
                np.concatenate([vertices, [(np.nan, 0.0, 0.0), (np.inf, 1.0, 0.0)]]),
                np.concatenate([[[0, 0, 1], [2, 3, 2]], faces, [[0, 1, 8], [1, 2, 9]]]),
            )
        ],
    }
    lifted = shapes[name] if name != "sheet" else [(shapes[name][0][0] + (0.0, 1.4, 0.0), shapes[name][0][1])]
    return [small_scenes.mesh(f"{name} {i}", (v, f.astype(np.int32))) for i, (v, f) in enumerate(lifted)]


@pytest.mark.parametrize("kind", ["point", "directional"])
@pytest.mark.parametrize(
    "name",
    [
        "open box",
        "sheet",
        "fin on a box",
        "some faces turned over",
        "some faces twice",
        "inside out",
        "one box through another",
        "no area and no numbers",
    ],
)
@pytest.mark.parametrize("eye", ["clear", "below"])
def test_any_caster_hides_what_its_faces_hide(name: str, kind: str, eye: str, device: str) -> None:
    ground = small_scenes.mesh("ground", small_scenes.plane(12.0, cells=3))
    view = (
        small_scenes.camera() if eye == "clear" else small_scenes.camera((0.4, 0.5, 0.2), (2.0, 1.5, -3.0), near=0.02)
    )
    scene = small_scenes.scene([ground, *broken(name)], small_scenes.light(kind, (1.5, 9.0, 2.0)), view)
    expected = true_visibility(scene, device, size=SIZE, centre=True)
    assert (expected == 0.0).mean() > 0.01 and (expected == 1.0).any()
    for how in ANY_EYE + (("zpass",) if eye == "clear" else ()):
        assert_same_image(picture(scene, device, how), expected, flips=EDGE_PIXELS, biased=True)


@pytest.mark.parametrize("place", ["in a body", "on a face", "in a hole", "under the ground"])
def test_the_light_may_be_anywhere(place: str, device: str) -> None:
    centre = {
        "in a body": (0.3, 2.2, -0.2),
        "on a face": (0.3, 2.5, -0.2),
        "in a hole": (-1.6, 1.6, 0.6),
        "under the ground": (0.5, -3.0, 0.5),
    }[place]
    scene = replace(bodies_on_ground(), lights=(small_scenes.light("point", centre),))
    expected = true_visibility(scene, device, size=SIZE, centre=True)
    for how in ANY_EYE:  # outside of a body that holds the light the eye is in shadow
        image = picture(scene, device, how)
        if place == "on a face":  # which of its sides the light is on is a matter of rounding
            assert set(np.unique(image[np.isfinite(expected)])) <= {0.0, 1.0}
        else:
            assert_same_image(image, expected, flips=EDGE_PIXELS, biased=True)


@pytest.mark.parametrize("how", VOLUMES)
def test_shadow_of_a_box_under_the_sun(how: str) -> None:
    """A8, in closed form: h / tan e long, to the grid of 1/256 pixel that corners are drawn on."""
    name, params = VOLUMES[how]
    result = render_visibility(SCENES / "a8_box.yaml", name, params, width=320, height=240)
    seen = np.isfinite(result.visibility)
    position, lit = result.world_position[seen].astype(float), result.visibility[seen]
    assert (lit == 0.0).mean() > 0.05
    assert np.mean(lit != analytic.a8_box(position)) <= EDGE_PIXELS
    strip = (np.abs(position[:, 2]) < 0.9) & (position[:, 0] > 0.5)
    end = 0.5 + analytic.a8_shadow_length()
    assert abs(position[strip & (lit == 0.0), 0].max() - end) < 0.02


@pytest.mark.parametrize("how", ["zpass", "zfail, per caster"])
def test_offsets_of_a_million_cost_nothing(how: str, device: str) -> None:
    scene = bodies_on_ground()
    offset = np.array([1e6, -1e6, 1e6])
    meshes = tuple(replace(mesh, vertices=mesh.vertices + offset) for mesh in scene.meshes)
    camera = scene.camera(0)
    far_camera = replace(camera, eye=camera.eye + offset, target=camera.target + offset)
    far = replace(scene, meshes=meshes, lights=(scene.lights[0].moved(offset),), camera=lambda frame: far_camera)
    assert_same_image(picture(far, device, how), picture(scene, device, how), flips=EDGE_PIXELS, biased=True)


def test_a_silhouette_is_found_once_for_light_and_casters(device: str) -> None:
    """An eye that walks has it found in the first frame only."""
    scene = replace(bodies_on_ground(), camera=small_scenes.circling(3.0))
    session = open_session(scene, device, size=(64, 48))
    results = render_frames(session, technique("shadow_volume_zfail"), 4)
    found = [[name for name, _ in result.passes] for result in results]
    assert found[0].count(Product.SILHOUETTES.value) == 1 and found[0].count(Product.VOLUMES.value) == 1
    for names in found[1:]:
        assert Product.SILHOUETTES.value not in names and Product.VOLUMES.value not in names


def test_volumes_beside_the_view_are_left_out(device: str) -> None:
    scene = bodies_on_ground(camera=small_scenes.camera((0.0, 1.0, 5.5), (0.0, 0.0, 9.0)))
    result = render(scene, device, "shadow_volume_zfail", {"size": SIZE})
    counts = {(what, why): count for what, why, count in result.left_out}
    assert counts[Uncounted.BESIDE.pair] >= 9
    kept = render(scene, device, "shadow_volume_zfail", {"size": SIZE, "skips": False})
    np.testing.assert_array_equal(result.visibility, kept.visibility)

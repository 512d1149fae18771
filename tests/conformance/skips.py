"""Whether leaving out shows: every frame of scenes that need little, with skips on and off."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import small_scenes
from over_time import moving_scene
from rig import SIZE, check, kinds_of, lamp, scaled, scenes_for, small_params, small_session, takes_any_mesh
from sessions import render_frames

from algorithms.technique import Technique
from wkernels.scene.model import Camera, Scene

WALK = (0, 1, 2, 2, 2, 5)
"""Frames that are rendered: a walk, a still view, a jump."""


def walked(scene: Scene) -> Scene:
    """The same scene seen by an eye that walks sideways."""

    def camera(frame: int) -> Camera:
        return small_scenes.camera((0.3 * frame, 6.0, 8.0), (0.2 * frame, 0.0, 0.0))

    return replace(scene, camera=camera)


def ground_and(technique: type[Technique], *shapes: small_scenes.Triangles, casts: bool = True) -> Scene:
    """A planar receiver and bodies beside or over it."""
    bodies = [
        small_scenes.mesh(f"body {i}", shape, receives=takes_any_mesh(technique), casts=casts)
        for i, shape in enumerate(shapes)
    ]
    return small_scenes.scene(
        [small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False), *bodies], lamp(technique)
    )


def casters_beside(technique: type[Technique]) -> Scene:
    """Nothing lies between light and ground: the only bodies are below it, and behind the light."""
    return ground_and(
        technique,
        small_scenes.box((0.0, -9.0, 0.0), (2.0, 1.0, 2.0)),
        small_scenes.box((0.0, 30.0, 0.0), (2.0, 1.0, 2.0)),
    )


def casters_behind_the_light(technique: type[Technique]) -> Scene:
    """The only body lies behind the light, where no view of the light looks."""
    return ground_and(technique, small_scenes.box((0.0, 30.0, 0.0), (2.0, 1.0, 2.0)))


def nothing_casts(technique: type[Technique]) -> Scene:
    """Bodies that hide nothing."""
    return ground_and(technique, small_scenes.box((0.3, 2.0, -0.2), (2.0, 1.0, 1.6)), casts=False)


def back_lit(technique: type[Technique]) -> Scene:
    """The light is below all that is seen."""
    scene = scenes_for(technique)[-1]
    ground = replace(scene.meshes[0], casts=True)
    light = small_scenes.light(kinds_of(technique)[0], (0.0, -10.0, 0.0))
    return replace(scene, meshes=(ground, *scene.meshes[1:]), lights=(light,))


def light_without_area(technique: type[Technique]) -> Scene:
    """All samples of the light are one point."""
    return replace(scenes_for(technique)[-1], lights=(scaled(lamp(technique), 0.0),))


def receivers_move(technique: type[Technique]) -> Scene:
    """What moves casts nothing."""
    scene = moving_scene(technique)
    ground, box = scene.meshes
    return replace(
        scene,
        meshes=(
            replace(ground, object_to_ws=box.object_to_ws, moving=True),
            small_scenes.box_on_ground(scene.lights[0]).meshes[1],
        ),
    )


def mover_without_area(technique: type[Technique]) -> Scene:
    """A moving caster under a light that is one point."""
    scene = moving_scene(technique)
    return replace(scene, lights=(scaled(scene.lights[0], 0.0),))


SCENES: dict[str, Callable[[type[Technique]], Scene]] = {
    "plain": lambda technique: scenes_for(technique)[0],
    "full of everything": lambda technique: walked(scenes_for(technique)[-1]),
    "a caster moves": moving_scene,
    "only receivers move": receivers_move,
    "casters below and above": lambda technique: walked(casters_beside(technique)),
    "casters behind the light": lambda technique: walked(casters_behind_the_light(technique)),
    "nothing casts": lambda technique: walked(nothing_casts(technique)),
    "back-lit": back_lit,
    "light without area": lambda technique: walked(light_without_area(technique)),
    "mover, light without area": mover_without_area,
}


def images(technique: type[Technique], scene: Scene, device: str, skips: bool) -> Iterator[tuple[np.ndarray, ...]]:
    """Visibility and standard error of each frame of ``WALK``."""
    session = small_session(scene, device, size=(SIZE[0] // 2, SIZE[1] // 2), skips=skips)
    made = technique(small_params(technique, samples=4))
    for index in WALK:
        (result,) = render_frames(session, made, 1, index)
        assert skips or not result.left_out, f"left out with skips off: {result.left_out}"
        error = result.standard_error
        yield result.visibility, np.zeros(0) if error is None else error


@check()
def skips_change_no_bit(technique: type[Technique], device: str) -> None:
    for name, build in SCENES.items():
        scene = build(technique)
        pairs = zip(images(technique, scene, device, True), images(technique, scene, device, False), strict=True)
        for step, ((seen, error), (all_seen, all_error)) in enumerate(pairs):
            where = f"{name}, frame {WALK[step]}, step {step}"
            np.testing.assert_array_equal(seen, all_seen, err_msg=where)
            if any(mesh.casts for mesh in scene.meshes):
                np.testing.assert_array_equal(error, all_error, err_msg=where)
            else:  # that all is lit is certain, whatever a sample or two say
                assert not (np.nan_to_num(error) > np.nan_to_num(all_error)).any(), where

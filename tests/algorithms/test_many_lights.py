"""Several lights in one shadow buffer (Scherzer et al. 2009, section 5), weighted by radiance, and how they are scored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from pydantic import ValidationError
from sessions import open_session, render_frames, small_technique, true_visibility, walk

from algorithms.plugins import find
from experiments import render_visibility
from experiments.kinds.walkthrough.config import load_experiment
from experiments.kinds.walkthrough.explain import explain
from experiments.rendering.engine import WarpEngine
from experiments.rendering.reference import ReferenceRenderer
from wkernels.errors import InputError
from wkernels.scene.lights import Light
from wkernels.scene.model import Scene
from wkernels.temporal.shadow_buffer.many_lights import drawn_light, light_weights

BOTH = ("tc_soft_paper", "tc_soft_thesis")
BRIGHT = replace(small.light("rectangle", (2.0, 8.0, 1.0), 1.5), radiance=(3.0, 3.0, 3.0))
DIM = small.light("disc", (-3.0, 7.0, 1.0), 1.5)
WEIGHTS = (0.75, 0.25)


def lit_by(*lights: Light) -> Scene:
    return replace(small.box_on_ground(lights[0]), lights=lights)


def weighted(of_light: Callable[[int], np.ndarray], weights: tuple[float, float] = WEIGHTS) -> np.ndarray:
    """The mean over both lights of an image of each."""
    return weights[0] * of_light(0) + weights[1] * of_light(1)


# ---- weights ------------------------------------------------------------------------------------------------------------


def test_lights_weigh_their_luminance() -> None:
    np.testing.assert_allclose(light_weights([BRIGHT, DIM]), WEIGHTS)
    green, blue = (replace(DIM, radiance=colour) for colour in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    np.testing.assert_allclose(light_weights([green, blue]), np.array([0.7152, 0.0722]) / 0.7874)
    black = replace(DIM, radiance=(0.0, 0.0, 0.0))
    np.testing.assert_array_equal(light_weights([BRIGHT, black]), [1.0, 0.0])
    np.testing.assert_array_equal(light_weights([black, black]), [0.5, 0.5])


def test_lights_are_drawn_as_often_as_they_weigh_and_evenly() -> None:
    weights = np.array([0.6, 0.0, 0.3, 0.1])
    drawn = np.array([drawn_light(weights, frame) for frame in range(2000)])
    np.testing.assert_allclose(np.bincount(drawn, minlength=4) / 2000, weights, atol=1e-3)
    assert not (drawn == 1).any(), "a black light is never drawn"
    for begin in range(0, 2000, 50):  # no stretch without one of them: random draws would leave 0.5 % without the last
        assert abs((drawn[begin : begin + 50] == 3).sum() - 5) <= 2
    assert all(drawn_light(np.ones(1), frame) == 0 for frame in range(9))


# ---- one buffer ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lights", ["all", "drawn"])
@pytest.mark.parametrize("name", BOTH)
def test_with_one_light_nothing_is_different(name: str, lights: str, device: str) -> None:
    """Bit for bit."""
    scene = small.cluttered(BRIGHT)
    for plain, several in zip(walk(scene, device, name, 3), walk(scene, device, name, 3, lights=lights), strict=True):
        np.testing.assert_array_equal(plain.visibility, several.visibility)
        np.testing.assert_array_equal(plain.standard_error, several.standard_error)


@pytest.mark.parametrize("buffer", ["float32", "float16"])
@pytest.mark.parametrize("name", BOTH)
def test_sampling_alone_is_the_weighted_mean_of_each_lights_maps(name: str, buffer: str, device: str) -> None:
    """Of ``multi_shadow_map`` of the same samples, light by light."""
    scene, frames = lit_by(BRIGHT, DIM), 12
    params: dict[str, Any] = {"filter": False, "start": "sample", "buffer": buffer}
    found = walk(scene, device, name, frames, lights="all", **params)[-1]
    maps = {"samples": frames, "resolution": 256}
    expected = weighted(lambda l: walk(scene, device, "multi_shadow_map", 1, {"light_index": l}, **maps)[0].visibility)
    assert ((expected > 0.02) & (expected < 0.98)).sum() > 300
    np.testing.assert_allclose(found.visibility, expected, atol=1e-5 if buffer == "float32" else 3e-3)
    # n grows by 1 / sum w^2 = 1.6 a frame
    psi, n = 1.0 - found.visibility, frames / (WEIGHTS[0] ** 2 + WEIGHTS[1] ** 2)
    stated = np.sqrt(psi * (1.0 - psi) / (n - 1.0))
    np.testing.assert_allclose(found.standard_error, stated, atol=1e-3 if buffer == "float32" else 5e-3)


@pytest.mark.parametrize("lights", ["all", "drawn"])
@pytest.mark.parametrize("name", BOTH)
def test_it_converges_to_the_weighted_mean_of_both_references(name: str, lights: str, device: str) -> None:
    scene = lit_by(BRIGHT, DIM)
    expected = weighted(lambda l: true_visibility(scene, device, light=l))
    session = open_session(scene, device)
    results = render_frames(session, small_technique(name, lights=lights, resolution=512), 64)
    assert session.lights.index == 0, "the light that is asked for stays so"
    errors = [rmse(results[k].visibility, expected) for k in (0, 7, 63)]
    assert errors[0] > errors[1] > errors[2] and errors[2] < 0.01, errors
    equal = weighted(lambda l: true_visibility(scene, device, light=l), (0.5, 0.5))
    assert rmse(results[63].visibility, equal) > 3.0 * errors[2], "equal weights are for equal lights"
    error = results[63].standard_error
    assert error is not None
    penumbra = (expected > 0.02) & (expected < 0.98)
    covered = np.abs(results[63].visibility - expected)[penumbra] <= 2.0 * error[penumbra] + 1e-3
    assert covered.mean() > 0.9


@pytest.mark.parametrize("name", BOTH)
def test_a_mover_that_leaves_takes_its_shadows_along(name: str, device: str) -> None:
    """Both lights' shadows, within the frames that its sums are worth."""

    def away(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = 0.0 if frame < 6 else 200.0
        return out

    scene = lit_by(BRIGHT, DIM)
    scene = replace(scene, meshes=(scene.meshes[0], replace(scene.meshes[1], object_to_ws=away, moving=True)))
    results = walk(scene, device, name, 12, lights="all")
    assert np.nanmin(results[5].visibility) < 0.3
    assert np.nanmin(results[11].visibility) == 1.0
    ignored = walk(scene, device, name, 12, lights="all", movers="ignore")
    assert np.nanmin(ignored[11].visibility) < 0.8, "or else this says nothing"


def test_a_black_light_has_no_map(device: str) -> None:
    scene = lit_by(BRIGHT, replace(DIM, radiance=(0.0, 0.0, 0.0)))
    (*_, result) = walk(scene, device, "tc_soft_paper", 3, lights="all")
    assert ("light depth map", "the light is black", 1) in result.left_out
    np.testing.assert_array_equal(result.visibility, walk(scene, device, "tc_soft_paper", 3)[-1].visibility)


def test_a_map_of_movers_is_of_one_light() -> None:
    plugin: Any = find("tc_soft_paper")
    with pytest.raises(ValidationError, match="one light"):
        plugin.Params(lights="all", mover_map="centre")


# ---- scores -------------------------------------------------------------------------------------------------------------

EXPERIMENT = """
kind: walkthrough
scene:
  meshes: [{primitive: plane, size: [8, 8]}, {primitive: box, size: [1, 1, 1], transform: {translate: [0, 1.5, 0]}}]
  lights:
    - {kind: rectangle, center: [1, 6, 0], edge_u: [1, 0, 0], edge_v: [0, 0, 1], radiance: [3, 3, 3]}
    - {kind: KIND}
  camera: {eye: [0, 4, 6], target: [0, 0, 0]}
image: {width: 40, height: 30}
reference: {samples: 32}
techniques:
  - tc_soft_paper: {lights: all}
  - OTHER
frames: 1
"""
DISC = "disc, center: [-2, 6, 0], normal: [0, -1, 0], radius: 0.5"


def experiment(folder: Path, other: str, kind: str = DISC) -> Any:
    file = folder / "several.yaml"
    file.write_text(EXPERIMENT.replace("OTHER", other).replace("KIND", kind))
    return load_experiment(file)


def test_the_reference_is_the_mean_that_techniques_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WKERNELS_CACHE", str(tmp_path))
    made = experiment(tmp_path, "tc_soft_thesis: {lights: drawn}")
    engine = WarpEngine(made)
    visibility, error = engine.reference(0)
    parts = [
        ReferenceRenderer(engine.geometry, samples=32, width=40, height=30, light=light, seed=2).render(0)
        for light in (0, 1)
    ]
    np.testing.assert_allclose(visibility, 0.75 * parts[0].visibility + 0.25 * parts[1].visibility, atol=1e-6)
    errors = np.hypot(0.75 * parts[0].standard_error, 0.25 * parts[1].standard_error)
    np.testing.assert_allclose(error, errors, atol=1e-6)
    assert "all lights, weighted by radiance" in explain(made)


def test_no_reference_suits_both_sorts(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'pcss' shows one light and 'tc_soft_paper' all") as caught:
        experiment(tmp_path, "pcss")
    assert caught.value.line == 13


def test_every_light_must_be_one_that_the_technique_works_with(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs a light with an area"):
        experiment(tmp_path, "tc_soft_thesis: {lights: all}", "point, position: [0, 5, 0]")
    scene = lit_by(BRIGHT, small.light("point"))
    with pytest.raises(InputError, match="needs a light with an area"):
        render_visibility(scene, technique="tc_soft_paper", params={"lights": "all"}, width=16, height=12)

"""Both shadow buffers under a light that moves: what trails without ageing, and what is left of it with (Scherzer et al.
2009, section 5; Schwaerzler 2009, section 5.4.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_scenes as small
from sessions import true_visibility, walk

from experiments import render_visibility
from wkernels.errors import InputError
from wkernels.scene.model import Scene

BOTH = ("tc_soft_paper", "tc_soft_thesis")
STANDS = 16  # frames before the light begins to move
MAP = {"resolution": 512}
LAMP = small.light("rectangle", (1.5, 8.0, 0.0), 1.5)


def swinging(step: float = 0.12) -> Scene:
    """The light stands, then moves along x by ``step`` a frame (0.08 of its size)."""

    def motion(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = -step * max(frame - STANDS, 0)
        return out

    return small.box_on_ground(replace(LAMP, motion=motion))


@pytest.mark.parametrize("name", BOTH)
def test_shadows_trail_unless_what_is_remembered_ages(name: str, device: str) -> None:
    """Behind the shadow, whence it came, it is darker than the truth without ageing; before it, where it goes, lighter.

    The light moves to -x and the shadow to +x.
    """
    scene, last = swinging(), STANDS + 16
    now, then = true_visibility(scene, device, last), true_visibility(scene, device, STANDS)
    gone, come = then - now < -0.3, then - now > 0.3
    assert gone.sum() > 60 and come.sum() > 60
    errors = {}
    for ageing in ("none", "frames", "displacement", "balanced"):
        shown = walk(scene, device, name, last + 1, ageing=ageing, age_factor=0.75, **MAP)[-1].visibility
        error = shown - now
        errors[ageing] = [float(error[gone].mean()), float(error[come].mean()), float(np.sqrt(np.nanmean(error**2)))]
    print(name, {key: np.round(values, 3) for key, values in errors.items()})
    behind, before, trailing = errors.pop("none")
    assert behind < -0.2 and before > 0.2, "darker where it left, lighter where it came"
    for ageing, (left, arrived, rmse) in errors.items():
        assert abs(left) < 0.4 * abs(behind) and abs(arrived) < 0.4 * before and rmse < 0.6 * trailing, ageing
    assert errors["balanced"][2] < 0.4 * trailing


@pytest.mark.parametrize("name", BOTH)
def test_the_standard_error_does_not_claim_what_was_forgotten(name: str, device: str) -> None:
    """Over pixels in penumbra the stated error must not be less than the true one; without ageing it is a fifth of it."""
    scene, last = swinging(), STANDS + 16
    now = true_visibility(scene, device, last)
    penumbra = (now > 0.05) & (now < 0.95)
    stated = {}
    for ageing in ("none", "balanced"):
        result = walk(scene, device, name, last + 1, ageing=ageing, filter=False, **MAP)[-1]
        assert result.standard_error is not None
        error = np.sqrt(np.mean((result.visibility - now)[penumbra] ** 2))
        stated[ageing] = np.sqrt(np.mean(result.standard_error[penumbra] ** 2)) / error
    assert stated["none"] < 0.5 and stated["balanced"] > 0.8, stated


@pytest.mark.parametrize("name", BOTH)
def test_nothing_ages_while_the_light_stands(name: str, device: str) -> None:
    """The same bits until it moves, and from its first move on other ones."""
    scene = swinging()
    images = {
        ageing: walk(scene, device, name, STANDS + 2, ageing=ageing, resolution=128) for ageing in ("none", "balanced")
    }
    for frame in range(STANDS + 1):
        np.testing.assert_array_equal(images["none"][frame].visibility, images["balanced"][frame].visibility)
        np.testing.assert_array_equal(images["none"][frame].standard_error, images["balanced"][frame].standard_error)
    assert np.nansum(np.abs(images["none"][-1].visibility - images["balanced"][-1].visibility)) > 1.0


@pytest.mark.parametrize("name", BOTH)
def test_a_float16_buffer_ages_as_a_float32_one(name: str, device: str) -> None:
    scene = swinging()
    images = [
        walk(scene, device, name, STANDS + 10, buffer=buffer, filter=False, **MAP)[-1].visibility
        for buffer in ("float32", "float16")
    ]
    # sums are rounded to 2^-11 in every frame; a texel of history may just fail its depth test in one of them
    assert np.nanmean(np.abs(images[0] - images[1]) > 0.01) < 0.01


def test_a_technique_of_kept_maps_refuses_a_light_that_moves() -> None:
    with pytest.raises(InputError, match="'tc_adaptive' is made for lights that stand still; this one moves"):
        render_visibility("configs/scenes/moving_light.yaml", "tc_adaptive", width=32, height=18)

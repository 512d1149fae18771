"""The ray-cast reference against closed forms: the scenes A1 to A9 of docs/glossary.md."""

from pathlib import Path

import numpy as np
import pytest

from experiments import render_visibility
from experiments.scenes import analytic
from wkernels.frame.session import FrameResult

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
SAMPLES = 1024
PENUMBRAE = ("a1_half_plane", "a2_half_plane_disc", "a3_coaxial_discs", "a4_rectangle", "a5_two_occluders")


def reference(name: str, samples: int = SAMPLES) -> tuple[FrameResult, np.ndarray, np.ndarray]:
    """The rendered frame, the mask of its receivers, and their closed-form visibility."""
    result = render_visibility(
        SCENES / f"{name}.yaml", "reference_multisample", {"samples": samples}, width=160, height=120
    )
    seen = np.isfinite(result.visibility)
    assert seen.mean() > 0.85
    return result, seen, analytic.CLOSED_FORMS[name](result.world_position[seen].astype(np.float64))


@pytest.mark.parametrize("name", PENUMBRAE)
def test_reference_within_three_standard_errors(name: str) -> None:
    result, seen, expected = reference(name)
    soft = (expected > 0.0) & (expected < 1.0)
    assert soft.mean() > 0.1, "the camera must look at the penumbra"
    error = np.abs(result.visibility[seen] - expected)
    # N samples know N + 1 levels, so that even a perfect set is off by 1 / N, where its standard error says 0
    allowed = 3.0 * result.standard_error[seen] + 1.0 / SAMPLES
    assert (error <= allowed).mean() >= 0.997
    # low-discrepancy samples do at least twice as well as the independent ones that the standard error speaks of
    assert np.sqrt(np.mean(error[soft] ** 2)) < 0.5 * np.sqrt(np.mean(result.standard_error[seen][soft] ** 2))
    assert abs(np.mean(result.visibility[seen] - expected)) < 0.5 / SAMPLES


@pytest.mark.parametrize("name", PENUMBRAE)
def test_umbra_and_full_light_are_exact(name: str) -> None:
    result, seen, expected = reference(name, samples=64)
    margin = 1e-4  # float32 positions move the borders of the penumbra by less
    lit = result.visibility[seen]
    for value in (0.0, 1.0):
        inside = np.abs(expected - value) == 0.0
        wrong = inside & (lit != value)
        assert wrong.sum() <= margin * inside.sum()
    assert np.any(expected == 1.0)


def test_standard_error_matches_its_own_definition() -> None:
    result, seen, _ = reference("a1_half_plane", samples=16)
    v = result.visibility[seen].astype(np.float64)
    np.testing.assert_allclose(result.standard_error[seen], np.sqrt(v * (1.0 - v) / 15.0), rtol=1e-5, atol=1e-7)


def test_two_occluders_fuse() -> None:
    """A5: where both cover a part, neither alone gives the umbra that they give together."""
    result, seen, expected = reference("a5_two_occluders", samples=64)
    position = result.world_position[seen].astype(np.float64)
    nowhere = ((50.0, 51.0), (50.0, 51.0))
    alone = [
        analytic.a5_two_occluders(position, blockers=blockers)
        for blockers in ((analytic.A5_BLOCKERS[0], nowhere), (nowhere, analytic.A5_BLOCKERS[1]))
    ]
    fused = (expected == 0.0) & (alone[0] > 0.2) & (alone[1] > 0.2)
    assert fused.sum() > 20
    assert np.all(result.visibility[seen][fused] == 0.0)


@pytest.mark.parametrize(("name", "value"), [("a6_empty", 1.0), ("a7_full_occluder", 0.0), ("a9_tilted_plane", 1.0)])
def test_nothing_and_everything(name: str, value: float) -> None:
    result, seen, expected = reference(name, samples=16)
    assert np.all(expected == value)
    assert np.all(result.visibility[seen] == value)


def test_coaxial_disc_radii() -> None:
    """A3: umbra, half light and outer edge of the penumbra lie at their radii, to a pixel's size on the plane."""
    result, seen, _ = reference("a3_coaxial_discs", samples=256)
    position = result.world_position[seen]
    radius = np.hypot(position[:, 0], position[:, 2])
    lit = result.visibility[seen]
    umbra, hard, outer = analytic.a3_radii()
    pixel = 0.15
    assert lit[radius < umbra - pixel].max() == 0.0
    assert lit[(radius > umbra + 2 * pixel) & (radius < hard)].min() > 0.0
    assert lit[radius > outer + pixel].min() == 1.0
    assert lit[(radius > hard) & (radius < outer - 2 * pixel)].max() < 1.0


def test_box_shadow_length() -> None:
    """A8: along the box's middle the shadow ends h / tan e behind it."""
    result = render_visibility(SCENES / "a8_box.yaml", "ray_cast_point_shadow", width=320, height=240)
    seen = np.isfinite(result.visibility)
    position, lit = result.world_position[seen], result.visibility[seen]
    strip = (np.abs(position[:, 2]) < 0.9) & (position[:, 0] > 0.5)
    end = 0.5 + analytic.a8_shadow_length()
    dark_end = position[strip & (lit == 0.0), 0].max()
    lit_begin = position[strip & (lit == 1.0), 0].min()
    assert dark_end <= end + 1e-5 <= lit_begin + 2e-5
    assert lit_begin - dark_end < 0.01
    assert np.array_equal(lit, analytic.a8_box(position.astype(np.float64)))

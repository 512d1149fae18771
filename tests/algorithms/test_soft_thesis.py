"""tc_soft_thesis: start, blur, blend and history (Schwaerzler 2009, section 5.2 and appendix A), and what both techniques
with a shadow buffer converge to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from pydantic import ValidationError
from sessions import SIZE, open_session, render_frames, small_technique, true_visibility, walk

from algorithms.plugins import find
from wkernels.scene.model import Scene

LAMP = small.light("rectangle", (2.0, 8.0, 1.0), 2.0)
THESIS = "tc_soft_thesis"
BOTH = ("tc_soft_paper", THESIS)


def texels_after(scene: Scene, device: str, frames: int, **params: Any) -> np.ndarray:
    """The shadow buffer, float32 (H, W, 4), that so many frames leave."""
    session = open_session(scene, device)
    render_frames(session, small_technique(THESIS, overscan=0.0, **params), frames)
    texels: np.ndarray = session.history("shadow buffer", lambda: None).previous.numpy()
    return texels


# ---- convergence --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BOTH)
def test_a_still_camera_reaches_256_levels_in_256_frames(name: str, device: str) -> None:
    """Half a level of 128 is where more samples no longer show; the map of 2048 texels is fine enough not to limit it."""
    scene = small.box_on_ground(LAMP)
    error = rmse(
        walk(scene, device, name, 256, resolution=2048)[-1].visibility, true_visibility(scene, device, samples=4096)
    )
    assert error < 1.0 / 128.0
    print(f"{name}: rmse at n = 256 is {128 * error:.3f} of 1/128")


@pytest.mark.parametrize("name", BOTH)
def test_a_mean_over_the_same_maps_is_what_they_converge_to(name: str, device: str) -> None:
    scene = small.cluttered(small.light("rectangle", (1.0, 8.0, 0.5)))
    sampling = {"start": "sample", "filter": False}
    ours = walk(scene, device, name, 16, resolution=128, overscan=0.0, **sampling)[-1]
    maps = open_session(scene, device).render(small_technique("multi_shadow_map", resolution=128, samples=16))
    np.testing.assert_allclose(ours.visibility, maps.visibility, atol=1e-6)
    np.testing.assert_allclose(ours.standard_error, maps.standard_error, atol=1e-5)


def coverage(scene: Scene, device: str, sample_set: str, seeds: range) -> tuple[float, float]:
    """Over penumbra pixels and seeds at n = 32: share within 2 standard errors, and their mean size over the true error's.

    Pixels nearer to lit or umbra than a tenth are left out: there 32 tests may well agree, and then the error is 0.
    """
    expected = true_visibility(scene, device, samples=4096)
    penumbra = (expected > 0.1) & (expected < 0.9)
    assert penumbra.sum() > 120
    inside, stated, true = [], [], []
    for seed in seeds:
        result = walk(scene, device, THESIS, 32, {"seed": seed}, filter=False, resolution=1024, sample_set=sample_set)[
            -1
        ]
        error = (result.visibility - expected)[penumbra]
        inside.append(np.abs(error) <= 2.0 * result.standard_error[penumbra])
        stated.append(result.standard_error[penumbra])
        true.append(error)
    return float(np.mean(inside)), float(np.sqrt(np.mean(np.square(stated)) / np.mean(np.square(true))))


def test_the_standard_error_is_that_of_independent_samples(device: str) -> None:
    """All pixels of a frame share one light sample, so that only many seeds make a fair share."""
    within, ratio = coverage(small.box_on_ground(LAMP), device, "random", range(2, 14))
    print(f"random samples: {within:.1%} within 2 standard errors, which are {ratio:.2f} times the true ones")
    assert 0.90 < within < 0.999
    assert 0.75 < ratio < 1.35  # 12 sequences know a deviation to 1 / sqrt(2 * 11), 21 %


def test_the_standard_error_is_conservative_for_halton(device: str) -> None:
    within, ratio = coverage(small.box_on_ground(LAMP), device, "halton", range(1, 5))
    print(f"Halton: {within:.1%} within 2 standard errors, which are {ratio:.2f} times the true ones")
    assert within > 0.99 and ratio > 2.0


# ---- start --------------------------------------------------------------------------------------------------------------


def roofed(height: float = 2.0, size: float = 3.0) -> Scene:
    """A plate parallel to the light and to the ground: every blocker has the same depth."""
    return small.scene(
        [
            small.mesh("ground", small.plane(12.0), casts=False),
            small.mesh("plate", small.plane(size, height, (0.5, 0.2)), receives=False),
        ],
        LAMP,
    )


def test_the_search_finds_the_plate(device: str) -> None:
    """1 - z_b / z_r is 2 / 8 under the plate and within 7 texels of its shadow, and nowhere else."""
    rise = texels_after(roofed(), device, 1)[..., 3]
    assert (rise > 0.0).sum() > 300
    np.testing.assert_allclose(rise[rise > 0.0], 0.25, atol=1e-5)
    wider = texels_after(roofed(), device, 1, search_radius=20.0)[..., 3] > 0.0
    hidden = texels_after(roofed(), device, 1, filter=False)[..., 3] > 0.0
    assert hidden.sum() < (rise > 0.0).sum() < wider.sum()
    assert not (hidden & (rise == 0.0) & wider).any()


def test_the_mean_blocker_holds_for_as_long_as_it_is_said_to(device: str) -> None:
    """After the search one blocker a shadowed frame (default), or a weight as if every frame had one (published)."""

    def after(frames: int, mean: str) -> np.ndarray:
        return texels_after(two_plates(), device, frames, blocker_mean=mean, search_radius=0.0)[..., [0, 3]]

    ours, published = (after(24, mean) for mean in ("blockers", "frames"))
    np.testing.assert_array_equal(ours[..., 0], published[..., 0])
    searched = after(1, "blockers")[..., 1]
    mixed = (searched > 0.0) & (ours[..., 0] < 18) & (np.abs(ours[..., 1] - searched) > 0.01)
    assert mixed.sum() > 10
    moved_ours, moved_published = (np.abs(x[..., 1] - searched)[mixed] for x in (ours, published))
    assert (moved_published <= moved_ours + 1e-6).all() and moved_published.mean() < 0.95 * moved_ours.mean()


def two_plates() -> Scene:
    """Plates at two heights whose penumbrae overlap, so that a point's blockers differ from frame to frame."""
    plates = [
        small.mesh("low", small.plane(2.0, 1.5, (0.5, 0.2)), receives=False),
        small.mesh("high", small.plane(1.5, 4.0, (-0.3, 0.6)), receives=False),
    ]
    return small.scene([small.mesh("ground", small.plane(12.0), casts=False), *plates], LAMP)


def test_a_stored_start_is_worth_16_samples(device: str) -> None:
    scene = small.box_on_ground(LAMP)
    session, made = (
        open_session(scene, device),
        small_technique(THESIS, start="blur", overscan=0.0, filter_depth_range=0.05),
    )
    shown = session.render(made)
    session.advance()
    texels = session.history("shadow buffer", lambda: None).previous.numpy()
    started = texels[..., 1] == 16.0
    assert started.sum() > 50 and set(np.unique(texels[..., 1])) <= {0.0, 1.0, 16.0}
    np.testing.assert_allclose(texels[started, 0] / 16.0, 1.0 - shown.visibility[started], atol=1e-6)
    tau = texels_after(scene, device, 1, filter=False)[..., 0]  # rho = 8 (blur + tau), blur in [0, 1]
    blur = texels[started, 0] / 8.0 - tau[started]
    assert blur.min() >= -1e-6 and blur.max() <= 1.0 + 1e-6 and len(np.unique(np.round(blur, 4))) > 5
    # and its bias goes as 16 / n: after 64 frames psi differs by 16 (psi_0 - mean of 16 tests) / 80 at most
    ours, plain = (
        walk(scene, device, THESIS, 64, start=s, filter_depth_range=0.05)[-1].visibility for s in ("blur", "sample")
    )
    assert 0.01 < np.nanmax(np.abs(ours - plain)) < 16.0 / 64.0


# ---- blend --------------------------------------------------------------------------------------------------------------


def test_samples_are_shown_from_the_least_error_down_and_the_blur_from_the_largest_up(device: str) -> None:
    scene = small.box_on_ground(LAMP)
    options: dict[str, Any] = {"least_error": 0.05, "largest_error": 0.1, "filter_depth_range": 0.05}
    blended, sampled = (walk(scene, device, THESIS, 48, filter=f, **options) for f in (True, False))
    always = walk(scene, device, THESIS, 48, least_samples=1e6, **options)
    for n in (2, 8, 15, 16, 32, 48):
        own, plain, blur = (frames[n - 1].visibility for frames in (blended, sampled, always))
        error = sampled[n - 1].standard_error
        confident = (error <= 0.05) & (n >= 16)
        unsure = (error >= 0.1) | (n < 16)
        np.testing.assert_array_equal(own[confident], plain[confident])
        np.testing.assert_array_equal(own[unsure], blur[unsure])
        between = ~confident & ~unsure & (error > 0.0)
        if n > 16:
            weight = ((0.1 - error) / 0.05)[between]
            expected = blur[between] * (1.0 - weight) + plain[between] * weight
            np.testing.assert_allclose(own[between], expected, atol=2e-6)
            assert between.sum() > 30 or n == 48
    assert not np.array_equal(always[47].visibility, sampled[47].visibility, equal_nan=True)


def test_pixel_sizes_are_those_of_the_camera_and_of_the_print(device: str) -> None:
    """Equations 5.9 and 5.10 are right for near = 1 / (2 tan(fov / 2)) alone: 1.07 here; near is 0.1, as the shader's."""
    scene = roofed()
    settings = {
        size: small_technique(THESIS, pixel_size=size)._width_error(open_session(scene, device))
        for size in ("projected", "near_plane", "shader")
    }
    margin = 1.0 + 2.0 * np.ceil(0.025 * SIZE[1]) / SIZE[1]
    height_at_1 = 2.0 * np.tan(np.radians(25.0)) * margin
    assert settings["projected"] == pytest.approx(1.0)
    assert settings["near_plane"] == settings["shader"] == pytest.approx(0.1 * height_at_1)
    first = {size: walk(scene, device, THESIS, 1, pixel_size=size)[0].visibility for size in settings}
    hard = walk(scene, device, THESIS, 1, filter=False)[0].visibility
    assert np.nanmean(first["projected"] != hard) > 0.03
    np.testing.assert_array_equal(first["shader"], hard)  # a tenth of the width is less than a pixel of this image


def test_a_wholly_lit_blur_counts(device: str) -> None:
    """A lone shadowed pixel among lit ones: the published shader rejects a blur of 0 and leaves it dark."""
    scene = roofed(4.0, 0.12)
    options: dict[str, Any] = {"filter_depth_range": 0.5, "kernel": "poisson"}
    taken, rejected = (
        walk(scene, device, THESIS, 1, zero_blur=z, **options)[0].visibility for z in ("taken", "rejected")
    )
    differs = np.nan_to_num(taken) != np.nan_to_num(rejected)
    assert differs.any()
    np.testing.assert_array_equal(taken[differs], 1.0)
    np.testing.assert_array_equal(rejected[differs], 0.0)


# ---- history ------------------------------------------------------------------------------------------------------------


def test_relative_depth_keeps_slanted_ground(device: str) -> None:
    """At any epsilon that is above the rounding of float32: texels are tested on the receiver's plane."""
    for epsilon in (1e-3, 1e-5):
        frames = walk(
            small.box_on_ground(LAMP, small.circling(0.2)), device, THESIS, 8, overscan=0.1, depth_epsilon=epsilon
        )
        receives = np.isfinite(frames[-1].visibility)
        assert (frames[-1].standard_error[receives] < 1.0).mean() > 0.99


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"start": "pcss"}, "blur"),
        ({"least_error": 0.3}, "s_min <= s_max"),
        ({"taps": 7}, "multiple of 2"),
        ({"history": "cubic"}, "linear"),
        ({"pixel_size": "near"}, "near_plane"),
        ({"movers": "slow"}, "gradual"),
        ({"mover_decrement": 0.0}, "mover_decrement"),
        ({"error_threshold": 0.1}, "error_threshold"),
    ],
)
def test_wrong_parameters_are_named(params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        find("tc_soft_thesis").Params(**params)

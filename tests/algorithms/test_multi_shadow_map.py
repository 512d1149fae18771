"""multi_shadow_map: against hard maps averaged by hand, the ray-cast reference and a closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from pydantic import ValidationError
from sessions import render, true_visibility, walk

from algorithms.plugins import find
from wkernels.frame import map_keeper
from wkernels.frame.session import FrameResult
from wkernels.sampling.point_sets import light_set
from wkernels.scene.lights import DirectionalLight, Light, PointLight, RectangleLight


def hard_light(sample: np.ndarray) -> Light:
    """The light without area at one sample of another light."""
    return PointLight(position=sample[:3]) if sample[3] == 1.0 else DirectionalLight(direction=-sample[:3])


@pytest.mark.parametrize("kind", ["rectangle", "directional", "sphere", "linear"])
def test_equals_the_mean_of_hard_maps(kind: str, device: str) -> None:
    lamp = small.light(kind, (1.0, 8.0, 0.5))
    ours = render(small.cluttered(lamp), device, "multi_shadow_map", samples=5, resolution=128)
    hard = [
        render(small.cluttered(hard_light(sample)), device, "shadow_map", resolution=128).visibility
        for sample in lamp.sample(light_set("halton", 5))
    ]
    expected = np.mean(hard, axis=0)
    assert 0.0 < np.nanmin(expected[expected > 0.0]) < 1.0
    # the hard light's directions are normalised once more, which moves a map by a rounding error
    assert np.nanmean(np.abs(ours.visibility - expected) > 1e-6) <= (0.005 if kind == "directional" else 0.0)
    variance = expected * (1.0 - expected) / 4.0
    assert ours.standard_error is not None
    close = np.abs(ours.visibility - expected) < 1e-6
    np.testing.assert_allclose(ours.standard_error[close], np.sqrt(variance[close]), atol=1e-3)


def test_texture_weights_the_samples(device: str) -> None:
    texture = np.array([[0.0, 3.0], [1.0, 2.0]])
    lamp = small.light("rectangle")
    assert isinstance(lamp, RectangleLight)
    lamp = replace(lamp, texture=texture)
    ours = render(small.box_on_ground(lamp), device, "multi_shadow_map", samples=8, resolution=256).visibility
    u = light_set("halton", 8)
    hard = [
        render(small.box_on_ground(hard_light(s)), device, "shadow_map", resolution=256).visibility
        for s in lamp.sample(u)
    ]
    weights = lamp.weights(u)
    assert np.ptp(weights) > 1.0
    np.testing.assert_allclose(ours, np.average(hard, axis=0, weights=weights), atol=1e-6)


def test_converges_to_the_reference_down_to_the_size_of_a_texel(device: str) -> None:
    scene = small.box_on_ground(small.light("rectangle", (2.0, 8.0, 1.0), 2.0))
    truth = true_visibility(scene, device, samples=1024)

    def error(samples: int, resolution: int) -> float:
        made = render(scene, device, "multi_shadow_map", samples=samples, resolution=resolution)
        return rmse(made.visibility, truth)

    fine = [error(n, 1024) for n in (16, 64, 256)]
    assert fine[1] < 0.5 * fine[0] and fine[2] < 0.5 * fine[1], fine  # slope 1/2 or better
    coarse = error(256, 128)
    assert coarse > 3.0 * fine[2], "128 texels must limit the error, or the slope above proves nothing"


def test_penumbra_of_a_half_plane_is_the_closed_form(device: str) -> None:
    """A1: lit = clamp(1/2 - x / w), w = L (z_r - z_b) / z_b, for an occluder that covers x > 0 at half height."""
    edge = small.box((10.0, 5.0, 0.0), (20.0, 1e-4, 40.0))
    scene = small.scene(
        [small.mesh("ground", small.plane(12.0), casts=False), small.mesh("half", edge, receives=False)],
        small.light("rectangle", (0.0, 10.0, 0.0), 2.0),
        small.camera((0.0, 4.0, 8.0)),
    )
    result = render(scene, device, "multi_shadow_map", samples=256, resolution=512)
    expected = np.clip(0.5 - result.world_position[..., 0] / 2.0, 0.0, 1.0)
    assert rmse(result.visibility, expected) < 0.008
    assert np.nanmax(np.abs(result.visibility - expected)) < 0.03


@pytest.mark.parametrize("lamp", [small.light("point"), replace(small.light("directional"), angle_deg=0.0)])
def test_a_light_without_area_needs_one_map(lamp: Light, device: str) -> None:
    scene = small.box_on_ground(lamp)
    ours = render(scene, device, "multi_shadow_map", samples=6, resolution=128)
    assert ("light depth maps", "the light has no area", 5) in ours.left_out
    everything = render(scene, device, "multi_shadow_map", {"skips": False}, samples=6, resolution=128)
    assert not everything.left_out
    np.testing.assert_array_equal(ours.visibility, everything.visibility)
    np.testing.assert_array_equal(ours.standard_error, everything.standard_error)
    np.testing.assert_array_equal(ours.visibility, render(scene, device, "shadow_map", resolution=128).visibility)
    assert 0.0 in ours.visibility and 1.0 in ours.visibility


def test_one_sample_has_no_standard_error(device: str) -> None:
    scene = small.box_on_ground(small.light("disc"))
    error = render(scene, device, "multi_shadow_map", samples=1, resolution=64).standard_error
    assert error is not None
    assert (error[np.isfinite(error)] == 1.0).all()


def kept_maps(result: FrameResult) -> int:
    return sum(count for what, _, count in result.left_out if what == "light depth map")


def test_maps_are_kept_while_casters_stand_still(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    still = small.box_on_ground(small.light("rectangle"), lambda i: small.camera((0.3 * i, 6.0, 8.0)))
    moving = small.moved(still, 1, lambda frame: 0.5 * frame)
    params: dict[str, Any] = {"options": {"size": (64, 48)}, "samples": 4, "resolution": 64}
    walks = {
        name: walk(scene, device, "multi_shadow_map", 3, **params)
        for name, scene in (("still", still), ("moving", moving))
    }
    assert [kept_maps(result) for result in walks["still"]] == [0, 4, 4]
    assert [kept_maps(result) for result in walks["moving"]] == [0, 0, 0]
    assert not np.array_equal(walks["moving"][1].visibility, walks["still"][1].visibility, equal_nan=True)

    monkeypatch.setattr(map_keeper, "MAP_BUDGET_BYTES", 2 * 64 * 64 * 4)
    again = walk(still, device, "multi_shadow_map", 3, **params)
    assert [kept_maps(result) for result in again] == [0, 2, 2]
    for kept, drawn in zip(walks["still"], again, strict=True):
        np.testing.assert_array_equal(kept.visibility, drawn.visibility)


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"samples": 0}, "samples"),
        ({"samples": 2.5}, "samples"),
        ({"sample_set": "halten"}, "halton"),
        ({"taps": 4}, "taps"),
    ],
)
def test_wrong_parameters_are_named(params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        find("multi_shadow_map").Params(**params)

"""pcf, pcss and vsm: their images against closed forms, their limits, products and skips."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
from filtering_sessions import INSIDE, TECHNIQUES, render, session, technique

from wkernels.scene.lights import (
    DirectionalLight,
    DiscLight,
    Light,
    LinearLight,
    RectangleLight,
    SphereLight,
)
from wkernels.scene.model import Camera, Mesh, Scene

# ---- whole images against closed forms ----------------------------------------------------------------------------------


def half_plane(lamp: Light, blocker_height: float = 5.0) -> Scene:
    """A caster over x > 0 and a ground that it shadows, the light about 10 above: the analytic scenes A1, A2."""
    ground = small.mesh("ground", small.plane(12.0))
    wide = np.array([(x, blocker_height, z) for x in (0.0, 40.0) for z in (-40.0, 40.0)])
    caster = Mesh("half plane", wide, np.array([[0, 1, 2], [2, 1, 3]], np.int32), receives=False)
    eye = np.array([0.0, min(4.5, 0.9 * blocker_height), 0.1])  # below the caster, which would hide the ground
    view = Camera(eye, np.zeros(3), np.array([0.0, 0.0, -1.0]), 45.0, 0.1, 100.0)
    return small.scene([ground, caster], lamp, view)


@pytest.mark.parametrize("height", [1.5, 0.4, -0.4, -1.5])
def test_pcss_knows_only_the_horizon_of_the_lights_centre(height: float) -> None:
    """Known artefact, without any caster: an upright light of height 4, of which a share is below the ground.

    Too light by that share while the centre is above, and too dark by the rest as soon as it is not.
    """
    edges = {"edge_u": np.array([4.0, 0.0, 0.0]), "edge_v": np.array([0.0, 4.0, 0.0])}
    lamp = RectangleLight(center=np.array([0.0, height, -8.0]), **edges)
    scene = small.scene([small.mesh("ground", small.plane(8.0))], lamp)
    error = render(scene, "pcss").visibility - render(scene, "reference_multisample", samples=256).visibility
    above = (2.0 + height) / 4.0
    expected = 1.0 - above if height > 0.0 else -above
    np.testing.assert_allclose(error[np.isfinite(error)], expected, atol=0.02)


def share_below(lamp: Light, limit: np.ndarray) -> np.ndarray:
    """Share of the light with x below ``limit``, for lights centred on x = 0 (closed form of the projected shape)."""
    if isinstance(lamp, (DiscLight, SphereLight)):
        h = np.clip(limit / lamp.radius, -1.0, 1.0)
        return 1.0 - (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi
    if isinstance(lamp, LinearLight):
        return np.clip(0.5 + limit / abs(lamp.b[0] - lamp.a[0]), 0.0, 1.0)
    assert isinstance(lamp, RectangleLight)
    u, v = sorted(np.abs([lamp.edge_u[0], lamp.edge_v[0]]))
    if u == 0.0:
        return np.clip(0.5 + limit / v, 0.0, 1.0)

    def twice_integrated(t: np.ndarray) -> np.ndarray:
        return 0.5 * np.maximum(t, 0.0) ** 2

    corners = ((u + v) / 2, 1), ((v - u) / 2, -1), ((u - v) / 2, -1), (-(u + v) / 2, 1)
    return sum(sign * twice_integrated(limit + shift) for shift, sign in corners) / (u * v)


def rectangle(width: float, depth: float, angle_deg: float = 0.0) -> RectangleLight:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return RectangleLight(
        center=np.array([0.0, 10.0, 0.0]),
        edge_u=width * np.array([c, 0.0, s]),
        edge_v=depth * np.array([-s, 0.0, c]),
    )


CLOSED_FORMS = {
    "square": (rectangle(2.0, 2.0), "box"),
    "narrow": (rectangle(0.7, 2.5), "box"),
    "wide": (rectangle(2.5, 0.7), "box"),
    "turned": (rectangle(2.0, 1.2, 30.0), "box"),
    "disc": (small.light("disc", size=2.0), "poisson"),
    "sphere": (small.light("sphere", size=2.0), "poisson"),
    "linear": (LinearLight(a=np.array([-1.0, 10.0, -0.5]), b=np.array([1.0, 10.0, 0.5])), "box"),
}


@pytest.mark.parametrize("case", CLOSED_FORMS)
def test_pcss_with_many_taps_meets_the_closed_form_of_a_half_plane(case: str) -> None:
    lamp, kernel = CLOSED_FORMS[case]
    count = 400
    result = render(half_plane(lamp), "pcss", kernel=kernel, blocker_taps=count, filter_taps=count, resolution=512)
    x = result.world_position[..., 0].astype(float)
    expected = share_below(lamp, -x * (10.0 - 5.0) / 5.0)
    error = result.visibility - expected
    texel = 2 * 6.1 / 512
    # a box of k x k taps has k levels along the edge, and the edge itself is known to half a texel
    width = 2.0 if case != "narrow" else 0.7
    assert np.abs(error).max() < 1.5 * (1.0 / np.sqrt(count) + texel / width)
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert 0.1 < np.mean((expected > 0.0) & (expected < 1.0)) < 0.9  # most of the penumbra is in the picture


def test_pcss_as_published_stays_near_the_ramp() -> None:
    result = render(half_plane(rectangle(2.0, 2.0)), "pcss")
    error = result.visibility - np.clip(0.5 - result.world_position[..., 0] / 2.0, 0.0, 1.0)
    assert np.sqrt(np.mean(error**2)) < 0.06 and abs(np.mean(error)) < 0.02
    assert len(np.unique(np.round(result.visibility * 16.0, 3))) <= 17  # the bands of 16 taps


@pytest.mark.parametrize("blocker_height", [1.0, 3.0, 7.0])
def test_the_sun_casts_penumbrae_as_wide_as_its_angle_says(blocker_height: float) -> None:
    sun = DirectionalLight(direction=np.array([0.0, -1.0, 0.0]), angle_deg=20.0)
    scene = half_plane(sun, blocker_height)
    result = render(scene, "pcss", blocker_taps=300, filter_taps=300, resolution=512)
    radius = np.tan(np.radians(10.0)) * blocker_height
    h = np.clip(-result.world_position[..., 0].astype(float) / radius, -1.0, 1.0)
    expected = 1.0 - (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi
    error = result.visibility - expected
    assert np.abs(error).max() < 0.06 + 0.024 / radius
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_a_sparse_search_loses_the_outer_penumbra() -> None:
    scene = half_plane(rectangle(2.0, 2.0))
    x = render(scene, "pcss").world_position[..., 0]
    sparse = render(scene, "pcss", blocker_taps=1).visibility
    dense = render(scene, "pcss", blocker_taps=64).visibility
    outer = (x < -0.15) & (x > -0.9)
    assert (sparse[outer] == 1.0).all() and dense[outer].mean() < 0.85


def test_wide_kernels_do_not_shadow_the_plane_that_they_lie_on() -> None:
    """A lamp close over the ground: towards the horizon one texel spans ever more depth than at the receiver."""
    chip = small.mesh("chip", small.box((0.0, 1.7, 0.0), (0.1, 0.05, 0.1)))
    lamp = SphereLight(center=np.array([0.0, 2.0, 0.0]), radius=0.15)
    scene = small.scene([small.mesh("ground", small.plane(12.0)), chip], lamp)
    truth = render(scene, "reference_multisample", samples=64, size=(128, 96)).visibility
    for params in ({}, {"width": "pcss"}):
        image = render(scene, "vsm" if params else "pcss", size=(128, 96), **params).visibility
        lit = truth == 1.0
        assert lit.sum() > 5000 and np.mean(image[lit] < 0.95) < 0.005


def test_turned_taps_are_noise_round_the_same_mean() -> None:
    scene = half_plane(rectangle(2.0, 2.0))
    plain, turned, again, other = (
        session(scene, seed=seed).render(technique("pcss", rotate=rotate)).visibility
        for rotate, seed in ((False, 1), (True, 1), (True, 1), (True, 2))
    )
    np.testing.assert_array_equal(turned, again)
    assert np.mean(turned != plain) > 0.1 and np.mean(turned != other) > 0.1
    assert np.mean(turned) == pytest.approx(np.mean(plain), abs=0.01)


@pytest.mark.parametrize("lamp", [rectangle(2.0, 2.0), rectangle(0.8, 2.5)], ids=["square", "narrow"])
def test_vsm_over_two_planes_gives_the_exact_ramp(lamp: RectangleLight) -> None:
    result = render(half_plane(lamp), "vsm", width="pcss", blocker_taps=100)
    expected = share_below(lamp, -result.world_position[..., 0].astype(float))
    np.testing.assert_allclose(result.visibility, expected, atol=0.02)


# ---- limits -------------------------------------------------------------------------------------------------------------


def lights_without_size() -> dict[str, Light]:
    out: dict[str, Light] = {kind: small.light(kind, size=1e-30) for kind in ("rectangle", "disc", "sphere", "linear")}
    return {**out, "point": INSIDE, "directional": DirectionalLight(direction=np.array([0.3, -1.0, 0.2]))}


@pytest.mark.parametrize("kind", lights_without_size())
@pytest.mark.parametrize("bias", ["none", "slope", "normal"])
def test_without_width_the_filters_are_the_hard_shadow_map(kind: str, bias: str) -> None:
    scene = small.cluttered(lights_without_size()[kind])
    hard = render(scene, "shadow_map", bias=bias, resolution=128).visibility
    assert 0.01 < np.nanmean(hard) < 0.99
    for name, params in (("pcf", {"radius": 0.0, "bilinear": False}), ("pcss", {}), ("pcss", {"kernel": "box"})):
        soft = render(scene, name, bias=bias, resolution=128, **params).visibility
        np.testing.assert_array_equal(soft, hard, err_msg=f"{name} {params}")


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
def test_six_faces_agree_with_rays_off_the_edges(name: str, params: dict[str, Any]) -> None:
    scene = small.cluttered(INSIDE)
    rays = render(scene, "ray_cast_point_shadow", size=(128, 96)).visibility
    image = render(scene, name, size=(128, 96), **params).visibility
    assert np.nanmean(np.abs(image - rays)) < 0.02


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
@pytest.mark.parametrize(
    "lamp",
    [
        SphereLight(center=np.array([0.3, 2.0, -0.2]), radius=0.3),  # inside the box
        SphereLight(center=np.array([0.0, 1.0, 3.0]), radius=5.0),  # reaches receivers
        DirectionalLight(direction=np.array([1.0, -0.02, 0.0]), angle_deg=60.0),  # grazing
        RectangleLight(center=np.array([0.0, 4.0, 0.0]), edge_u=np.array([90.0, 0, 0]), edge_v=np.array([0, 0, 1e-3])),
    ],
    ids=["inside a caster", "huge", "grazing", "sliver"],
)
def test_degenerate_lights_stay_within_bounds(name: str, params: dict[str, Any], lamp: Light) -> None:
    image = render(small.box_on_ground(lamp), name, resolution=64, **params).visibility
    seen = image[~np.isnan(image)]
    assert len(seen) > 500 and seen.min() >= 0.0 and seen.max() <= 1.0


# ---- products, skips, determinism ---------------------------------------------------------------------------------------


def moving_box(lamp: Light) -> Scene:
    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = 0.8 * frame
        return out

    box = Mesh("box", *small.box((-1.0, 1.5, 0.0), (1.5, 1.0, 1.5)), object_to_ws=pose, moving=True)
    return small.scene([small.mesh("ground", small.plane(12.0)), box], lamp)


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
@pytest.mark.parametrize("lamp", [small.light("disc"), INSIDE], ids=["disc", "six faces"])
def test_products_follow_a_moving_caster(name: str, params: dict[str, Any], lamp: Light) -> None:
    scene = moving_box(lamp)
    running, plugin = session(scene), technique(name, resolution=256, **params)
    images = []
    for frame in (0, 1, 1):
        running.begin(frame)
        images.append(running.render(plugin).visibility)
        running.advance()
    fresh = session(scene)
    fresh.begin(1)
    expected = fresh.render(plugin).visibility
    assert np.nanmax(np.abs(images[0] - expected)) > 0.5
    np.testing.assert_array_equal(images[1], expected)
    np.testing.assert_array_equal(images[2], expected)


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
def test_skips_and_threads_change_no_bit(name: str, params: dict[str, Any]) -> None:
    scene = small.cluttered(small.light("sphere"))
    plugin = technique(name, resolution=256, **params)
    images = []
    for options in ({}, {"skips": False}, {"threads": 1}, {"threads": 2}):
        running = session(scene, **options)
        for frame in (0, 1):
            running.begin(frame)
            result = running.render(plugin)
            running.advance()
        images.append(result.visibility)
        built = {label for label, _ in result.passes}
        kept = {what for what, _, _ in result.left_out}
        assert ("light depth map" in built) == ("light depth map" not in kept) == (options == {"skips": False})
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_vsm_keeps_its_filtered_moments_and_skips_an_empty_blur() -> None:
    scene = small.box_on_ground(small.light("rectangle"))
    for params, products in (
        ({"taps": 5}, {"moments", "blur of moments"}),
        ({"width": "pcss"}, {"moments", "summed-area tables", "nearest blocker"}),
    ):
        running = session(scene)
        for frame in (0, 1):
            running.begin(frame)
            result = running.render(technique("vsm", resolution=64, **params))
            running.advance()
        assert products <= {what for what, _, _ in result.left_out}
        assert not products & {label for label, _ in result.passes}
    one = session(scene).render(technique("vsm", taps=1))
    assert ("blur of moments", "its kernel has one tap", 1) in one.left_out
    full = session(scene, skips=False).render(technique("vsm", taps=1))
    np.testing.assert_array_equal(one.visibility, full.visibility)


@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
@pytest.mark.parametrize("skips", [True, False])
def test_nothing_casts_and_all_is_lit(name: str, params: dict[str, Any], skips: bool) -> None:
    scene = small.scene([small.mesh("ground", small.plane(12.0), casts=False)], small.light("rectangle"))
    result = session(scene, skips=skips).render(technique(name, **params))
    seen = result.visibility[~np.isnan(result.visibility)]
    assert len(seen) > 500 and (seen == 1.0).all()
    assert any("light depth map" in what for what, _, _ in result.left_out) == skips


def test_vsm_is_lighter_where_casters_overlap() -> None:
    low = small.mesh("low", small.plane(3.0, y=1.0), receives=False)
    high = small.mesh("high", small.plane(3.0, y=6.0, centre=(1.4, 0.0)), receives=False)
    scene = small.scene([small.mesh("ground", small.plane(12.0)), low, high], small.light("rectangle"))
    truth = render(scene, "reference_multisample", samples=64).visibility
    leaking = render(scene, "vsm", width="pcss").visibility - truth
    cut = render(scene, "vsm", width="pcss", bleeding=0.4).visibility - truth
    umbra = truth == 0.0
    assert np.mean(leaking[umbra]) > 0.005 and np.nanmean(leaking) > 0.0
    assert np.mean(cut[umbra]) < 0.2 * np.mean(leaking[umbra])

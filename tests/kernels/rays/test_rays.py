"""Shadow rays against brute force and closed forms; proofs must change nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import small_scenes
import warp as wp
from compare import assert_within_standard_errors

from algorithms.plugins import find
from wkernels.frame.session import FrameResult, Session
from wkernels.rays.single_rays import NO_RECEIVER, PROVEN_DARK, PROVEN_LIT, TRACED, binomial_standard_error, trace_point
from wkernels.scene.geometry import CASTS, RECEIVES, Geometry
from wkernels.scene.lights import DirectionalLight, DiscLight, Light, RectangleLight
from wkernels.scene.model import Mesh, Scene

WIDTH, HEIGHT = 64, 48
AREA_LIGHTS = ("directional", "rectangle", "disc", "sphere", "linear", "polygon")


def session_of(scene: Scene, device: str, *, skips: bool = True, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Session:
    return Session(Geometry(scene, device), width=size[0], height=size[1], device=device, skips=skips)


def reference(session: Session, samples: int, sample_set: str = "halton") -> FrameResult:
    technique = find("reference_multisample")
    return session.render(technique(technique.Params(samples=samples, sample_set=sample_set)))


# ---- one sample, brute force ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_hard_visibility_equals_brute_force(kind: str, device: str) -> None:
    scene = small_scenes.cluttered(small_scenes.light(kind, (3.0, 8.0, -2.0)))
    session = session_of(scene, device)
    gbuffer, casters = session.gbuffer(), session.caster_mesh()
    visibility = wp.zeros((HEIGHT, WIDTH), dtype=float, device=device)
    light = session.light.centre
    session.launch(trace_point, visibility.shape, [gbuffer, casters, wp.vec4(*light), session.reach], [visibility])
    got = visibility.numpy()

    geometry = session.geometry
    corners = geometry.points_ws.numpy().astype(float)[geometry.caster_indices.numpy().reshape(-1, 3)]
    flags = gbuffer.flags.numpy().ravel()
    receivers = np.flatnonzero((flags & RECEIVES) != 0)
    position = gbuffer.position_ws.numpy().reshape(-1, 3)[receivers].astype(float)
    normal = gbuffer.normal_ws.numpy().reshape(-1, 3)[receivers].astype(float)
    to_light = light[:3] - position * light[3]
    t, least = small_scenes.ray_hits(position, to_light, corners)
    own = gbuffer.triangle.numpy().ravel()[receivers]
    casting = (flags[receivers] & CASTS) != 0
    assert casting.all()
    t[np.arange(len(own)), own] = np.inf  # its own triangle is left to the sign of N.L
    limit = 1.0 if light[3] > 0.0 else np.inf
    lit = (np.einsum("ij,ij->i", normal, to_light) > 0.0) & ~((t > 0.0) & (t < limit)).any(axis=1)
    doubtful = ((np.abs(least) < 1e-3) & (np.arange(len(corners)) != own[:, None])).any(axis=1)
    assert doubtful.mean() < 0.25 and 0.2 < lit.mean() < 0.9
    np.testing.assert_array_equal(got.ravel()[receivers][~doubtful], lit[~doubtful])
    assert (got.ravel()[receivers] == lit).mean() > 0.99
    assert (got.ravel()[(flags & RECEIVES) == 0] == 1.0).all()


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0, 85.0, 89.0])
def test_a_plane_does_not_shadow_itself(tilt_deg: float, device: str) -> None:
    tilt = np.radians(tilt_deg)
    lamp = DirectionalLight(direction=np.array([np.sin(tilt), -np.cos(tilt), 0.0]), angle_deg=0.5)
    scene = small_scenes.scene([small_scenes.mesh("terrain", small_scenes.plane(12.0, cells=9))], lamp)
    for samples in (1, 16):
        visibility = reference(session_of(scene, device), samples).visibility
        assert np.isfinite(visibility).mean() > 0.5 and np.nanmin(visibility) == 1.0


def test_a_convex_body_shadows_exactly_its_turned_away_faces(device: str) -> None:
    lamp = DirectionalLight(direction=np.array([-1.0, -0.6, -0.4]))
    scene = small_scenes.scene([small_scenes.mesh("ball", small_scenes.sphere((0, 0, 0), 3.0, 200))], lamp)
    session = session_of(scene, device)
    technique = find("ray_cast_point_shadow")
    visibility = session.render(technique()).visibility
    gbuffer = session.gbuffer()
    facing = gbuffer.normal_ws.numpy() @ session.light.centre[:3]
    seen = np.isfinite(visibility)
    assert 0.2 < (facing[seen] > 0).mean() < 0.9
    # a ray that leaves a facet less than a hair above its neighbour may meet the edge they share
    clear = seen & (np.abs(facing) > 0.02)
    np.testing.assert_array_equal(visibility[clear], facing[clear] > 0.0)


# ---- many samples: proofs -------------------------------------------------------------------------------------------


def floating_slab(lamp: Light) -> Scene:
    meshes = [
        small_scenes.mesh("ground", small_scenes.plane(14.0)),
        small_scenes.mesh("slab", small_scenes.plane(5.0, y=2.5)),
    ]
    return small_scenes.scene(meshes, lamp)


def boxes(seed: int) -> Callable[[Light], Scene]:
    def build(lamp: Light) -> Scene:
        ground = small_scenes.mesh("ground", small_scenes.plane(14.0), casts=bool(seed % 2))
        return small_scenes.scene([ground, small_scenes.mesh("boxes", small_scenes.random_boxes(9, seed))], lamp)

    return build


def ball(lamp: Light) -> Scene:
    meshes = [
        small_scenes.mesh("ground", small_scenes.plane(14.0)),
        small_scenes.mesh("ball", small_scenes.sphere((0.0, 1.5, 0.0), 1.5, 400)),
    ]
    return small_scenes.scene(meshes, lamp)


def hills(lamp: Light) -> Scene:
    return small_scenes.scene([small_scenes.mesh("hills", small_scenes.terrain(14.0, 16, 2.5))], lamp)


SCENES = {
    "slab": floating_slab,
    "boxes 1": boxes(1),
    "boxes 2": boxes(2),
    "boxes 3": boxes(3),
    "ball": ball,
    "hills": hills,
}
LIGHT_CENTRES = {"high": (1.0, 9.0, -2.0), "low": (9.0, 2.0, 3.0), "amid": (0.5, 2.0, 0.5)}


@pytest.mark.parametrize("kind", AREA_LIGHTS)
@pytest.mark.parametrize("name", SCENES)
def test_proofs_change_no_bit(name: str, kind: str, device: str) -> None:
    for where, size in (("high", 1.5), ("low", 0.7), ("amid", 1.0)):
        scene = SCENES[name](small_scenes.light(kind, LIGHT_CENTRES[where], size))
        proven, plain = session_of(scene, device), session_of(scene, device, skips=False)
        with_proofs, without = reference(proven, 48), reference(plain, 48)
        np.testing.assert_array_equal(with_proofs.visibility, without.visibility, err_msg=f"{name}, {kind}, {where}")
        np.testing.assert_array_equal(with_proofs.standard_error, without.standard_error)


def test_proofs_settle_pixels_of_both_kinds(device: str) -> None:
    session = session_of(floating_slab(small_scenes.light("rectangle")), device)
    visibility = reference(session, 16).visibility
    proof = session.buffer("proof", visibility.shape, wp.int32).numpy()
    assert set(np.unique(proof)) <= {TRACED, PROVEN_LIT, PROVEN_DARK, NO_RECEIVER}
    np.testing.assert_array_equal(proof == NO_RECEIVER, np.isnan(visibility))
    assert (visibility[proof == PROVEN_LIT] == 1.0).all() and (visibility[proof == PROVEN_DARK] == 0.0).all()
    penumbra = (visibility > 0.0) & (visibility < 1.0)
    assert penumbra.any() and (proof[penumbra] == TRACED).all()
    for outcome in (PROVEN_LIT, PROVEN_DARK, TRACED):
        assert (proof == outcome).mean() > 0.03
    without = session_of(floating_slab(small_scenes.light("rectangle")), device, skips=False)
    reference(without, 16)
    proof = without.buffer("proof", visibility.shape, wp.int32).numpy()
    assert set(np.unique(proof)) <= {TRACED, NO_RECEIVER}


def test_visibility_is_the_weighted_mean_of_hard_ones(device: str) -> None:
    """A textured light: each sample's rays alone, weighted on the host."""
    texture = np.array([[0.0, 1.0, 4.0], [2.0, 0.5, 0.0]])
    lamp = RectangleLight(
        center=np.array([1.0, 9.0, -2.0]),
        edge_u=np.array([2.0, 0, 0]),
        edge_v=np.array([0, 0, 2.0]),
        texture=texture,
    )
    session = session_of(small_scenes.cluttered(lamp), device, size=(40, 30))
    soft = reference(session, 24)
    samples = session.light_samples(24)
    assert len(np.unique(samples.weights_host)) > 3
    expected = np.zeros((30, 40))
    hard = wp.zeros((30, 40), dtype=float, device=device)
    for light, weight in zip(samples.host, samples.weights_host, strict=True):
        session.launch(
            trace_point, hard.shape, [session.gbuffer(), session.caster_mesh(), wp.vec4(*light), session.reach], [hard]
        )
        expected += weight * hard.numpy()
    expected /= samples.weights_host.sum()
    seen = np.isfinite(soft.visibility)
    np.testing.assert_allclose(soft.visibility[seen], expected[seen], atol=1e-6)
    assert ((expected > 0.05) & (expected < 0.95)).any()


def test_standard_error_is_the_binomial_one(device: str) -> None:
    values = np.random.default_rng(0).random((20, 30)).astype(np.float32)
    values[0, :2] = (0.0, 1.0)
    visibility, error = wp.array(values, dtype=float, device=device), wp.zeros((20, 30), dtype=float, device=device)
    session = session_of(floating_slab(small_scenes.light("rectangle")), device)
    for count in (2, 7, 1024):
        session.launch(binomial_standard_error, error.shape, [visibility, float(count)], [error])
        v = values.astype(float)
        np.testing.assert_allclose(error.numpy(), np.sqrt(v * (1.0 - v) / (count - 1)), rtol=1e-5)
    session.launch(binomial_standard_error, error.shape, [visibility, 1.0], [error])
    assert (error.numpy() == 1.0).all(), "one sample says nothing about its own error"


# ---- closed forms ---------------------------------------------------------------------------------------------------

Z_LIGHT, Z_OCCLUDER = 10.0, 5.0  # heights over the receiver; the occluder is half-way
# below the occluder, which therefore does not hide the receiver
BELOW = small_scenes.camera((0.0, 4.5, 0.001), (0.0, 0.0, 0.0), fov_deg=80.0)


def closed_form_scene(occluder: small_scenes.Triangles, lamp: Light) -> Scene:
    meshes: list[Mesh] = [
        small_scenes.mesh("receiver", small_scenes.plane(40.0), casts=False),
        small_scenes.mesh("occluder", occluder, receives=False),
    ]
    return small_scenes.scene(meshes, lamp, BELOW)


def rectangle(x0: float, x1: float, z0: float, z1: float) -> small_scenes.Triangles:
    corners = np.array([(x0, Z_OCCLUDER, z0), (x0, Z_OCCLUDER, z1), (x1, Z_OCCLUDER, z1), (x1, Z_OCCLUDER, z0)])
    return corners, np.array([(0, 1, 2), (0, 2, 3)], dtype=np.int32)


def square_light(edge: float) -> RectangleLight:
    return RectangleLight(
        center=np.array([0.0, Z_LIGHT, 0.0]), edge_u=np.array([edge, 0.0, 0.0]), edge_v=np.array([0.0, 0.0, edge])
    )


def disc_light(radius: float) -> DiscLight:
    return DiscLight(center=np.array([0.0, Z_LIGHT, 0.0]), normal=np.array([0.0, -1.0, 0.0]), radius=radius)


def cut_disc(h: np.ndarray) -> np.ndarray:
    """Share of a unit disc on the side x > h of a line."""
    h = np.clip(h, -1.0, 1.0)
    return (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi


def lens(r: float, s: float, d: np.ndarray) -> np.ndarray:
    """Area that two circles of radii r and s at distance d have in common."""
    d = np.maximum(d, 1e-12)
    alpha = np.arccos(np.clip((d * d + r * r - s * s) / (2.0 * d * r), -1.0, 1.0))
    beta = np.arccos(np.clip((d * d + s * s - r * r) / (2.0 * d * s), -1.0, 1.0))
    return r * r * (alpha - 0.5 * np.sin(2.0 * alpha)) + s * s * (beta - 0.5 * np.sin(2.0 * beta))


def overlap(position: np.ndarray, low: float, high: float, edge: float) -> np.ndarray:
    """Share of the light's edge behind an occluder's edge [low, high], seen from a position half-way below."""
    a, b = 2.0 * low - position, 2.0 * high - position  # projected from the receiver to the light's plane
    return np.clip(np.minimum(b, 0.5 * edge) - np.maximum(a, -0.5 * edge), 0.0, None) / edge


def check_closed_form(
    occluder: small_scenes.Triangles, lamp: Light, truth: Callable[[np.ndarray, np.ndarray], np.ndarray], device: str
) -> None:
    session = session_of(closed_form_scene(occluder, lamp), device)
    result = reference(session, 1024)
    seen = np.isfinite(result.visibility)
    assert seen.all()
    x, z = (result.world_position[..., axis].astype(float) for axis in (0, 2))
    expected = truth(x, z)
    assert ((expected > 0.02) & (expected < 0.98)).mean() > 0.05, "the view must show the penumbra"
    assert_within_standard_errors(result.visibility, expected, 1024, errors=3.0, share=0.997)
    assert np.abs(result.visibility - expected).max() < 0.03
    error = np.sqrt(np.clip(result.visibility * (1.0 - result.visibility), 0.0, None) / 1023)
    np.testing.assert_allclose(result.standard_error, error, atol=1e-5)


def test_a1_half_plane_under_a_square_light(device: str) -> None:
    width = 2.0 * (Z_LIGHT - Z_OCCLUDER) / Z_OCCLUDER  # L (zr - zb) / zb
    check_closed_form(
        rectangle(0, 90, -90, 90), square_light(2.0), lambda x, z: np.clip(0.5 - x / width, 0.0, 1.0), device
    )


def test_a2_half_plane_under_a_disc_light(device: str) -> None:
    width = 2.0 * 1.2 * (Z_LIGHT - Z_OCCLUDER) / Z_OCCLUDER
    check_closed_form(rectangle(0, 90, -90, 90), disc_light(1.2), lambda x, z: cut_disc(2.0 * x / width), device)


@pytest.mark.parametrize(("rho", "radius"), [(1.0, 0.8), (0.5, 1.5)])
def test_a3_disc_under_a_coaxial_disc_light(rho: float, radius: float, device: str) -> None:
    """With an umbra, and without one where the light is the larger."""
    angle = 2.0 * np.pi * np.arange(512) / 512
    rim = np.stack([rho * np.cos(angle), np.full(512, Z_OCCLUDER), rho * np.sin(angle)], axis=1)
    faces = np.stack([np.zeros(510, int), np.arange(1, 511), np.arange(2, 512)], axis=1).astype(np.int32)
    area = np.pi * radius**2
    check_closed_form(
        (rim, faces), disc_light(radius), lambda x, z: 1.0 - lens(radius, 2.0 * rho, np.hypot(x, z)) / area, device
    )


def test_a4_rectangle_under_a_square_light(device: str) -> None:
    check_closed_form(
        rectangle(-0.8, 0.6, -0.3, 1.1),
        square_light(1.6),
        lambda x, z: 1.0 - overlap(x, -0.8, 0.6, 1.6) * overlap(z, -0.3, 1.1, 1.6),
        device,
    )

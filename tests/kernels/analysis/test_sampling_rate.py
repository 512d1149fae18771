"""Sampling rates per pixel: against the NumPy twin, finite differences of drawn texel positions, stiff cases."""

from __future__ import annotations

from typing import Any

import light_map_probe
import numpy as np
import pytest
import small_scenes
import warp as wp

from algorithms.projections.composition import compose
from wkernels.analysis.perspective_error import texels_per_pixel
from wkernels.analysis.sampling_rate import (
    LEAST_COSINE,
    SamplingRate,
    map_use,
    sampling_rate,
    unread_share,
    wasted_shares,
)
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import LightMap
from wkernels.projections.clipping import box_polyhedron
from wkernels.projections.light_views import perspective_aliasing
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight, Light
from wkernels.scene.model import Camera, Scene
from wkernels.scene.views import HostView, LayerChoice, ProjectiveView

SIZE = (96, 64)
TEXELS = 128
LIGHTS: dict[str, Light] = light_map_probe.LIGHTS  # type: ignore[assignment]
PROJECTIONS: dict[str, dict[str, Any]] = {
    "scene": {},
    "focused": {"fit": "focused"},
    "psm": {"fit": "focused", "warp": "psm"},
    "n_opt in splits": {"fit": "focused", "warp": "lispsm_nopt", "splits": 3},
    "best": {"fit": "focused", "splits": 3, "selection": "best"},
}


def session_of(scene: Scene, device: str, projection: dict[str, Any] | None = None) -> Session:
    views = compose(projection) if projection else None
    return Session(Geometry(scene, device), width=SIZE[0], height=SIZE[1], device=device, projection=views)


def measure(session: Session, texels: int = TEXELS) -> tuple[SamplingRate, LightMap, GBuffer]:
    light_map, gbuffer = session.light_map(texels).map, session.gbuffer()
    return sampling_rate(session, light_map, gbuffer), light_map, gbuffer


def twin(light_map: LightMap, gbuffer: GBuffer, eye: HostView, layer: np.ndarray) -> np.ndarray:
    """J of every pixel from ``texels_per_pixel`` with the drawn map's matrices, NaN where there is no layer."""
    position, normal = (image.numpy().astype(float) for image in (gbuffer.position_ws, gbuffer.normal_ws))
    out = np.full((*layer.shape, 2, 2), np.nan)
    for index, rows in enumerate(light_map.ws_to_ls.numpy().astype(float)):
        here = layer == index
        size = (eye.width, eye.height)
        out[here] = texels_per_pixel(rows, light_map.resolution, eye.ws_to_ss, size, position[here], normal[here])
    return out


@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_equals_the_numpy_twin(kind: str, projection: str, device: str) -> None:
    session = session_of(small_scenes.cluttered(LIGHTS[kind]), device, PROJECTIONS[projection])
    rate, light_map, gbuffer = measure(session)
    seen = gbuffer.mesh.numpy() >= 0
    np.testing.assert_array_equal(seen & (rate.layer < 0), seen & np.isnan(rate.m))
    assert (rate.layer >= 0).sum() > 2000 and (len(np.unique(rate.layer[rate.layer >= 0])) > 1) is (
        light_map.layers > 1
    )
    jacobian = twin(light_map, gbuffer, session.eye(), rate.layer)
    known = rate.layer >= 0
    j = jacobian[known]
    # surfaces nearly edge-on to the eye or the light lose digits of the float32 normals and positions that both start from
    values = np.linalg.svd(j, compute_uv=False)
    bulk = values[:, 1] > 1e-2 * values[:, 0]
    assert bulk.mean() > 0.9
    for found, expected in (
        (rate.det, np.abs(np.linalg.det(j))),
        (rate.x, np.linalg.norm(j[:, 0], axis=1)),
        (rate.y, np.linalg.norm(j[:, 1], axis=1)),
        (rate.m, 1.0 / values[:, 1]),
    ):
        assert np.isfinite(found[known]).all() and (found[known] > 0.0).all()
        np.testing.assert_allclose(found[known][bulk], expected[bulk], rtol=1e-3)
        assert np.median(np.abs(found[known] / expected - 1.0)) < 2e-6


@wp.kernel
def locate_pixels(first: int, light_map: LightMap, gbuffer: GBuffer, found_out: wp.array2d(dtype=wp.vec4)):
    row, column = wp.tid()
    i = first + row
    found_out[i, column] = light_map_probe.locate(light_map, gbuffer.position_ws[i, column])


@pytest.mark.parametrize("projection", ["scene", "psm", "n_opt in splits"])
def test_is_the_finite_difference_of_texel_positions_between_pixels(projection: str, device: str) -> None:
    """Between the two neighbours of a pixel that lie on its plane and layer, where techniques look them up."""
    session = session_of(small_scenes.cluttered(LIGHTS["directional"]), device, PROJECTIONS[projection])
    rate, light_map, gbuffer = measure(session)
    found = wp.zeros(gbuffer.depth.shape, dtype=wp.vec4, device=device)
    launch(locate_pixels, found.shape, [light_map, gbuffer], [found], device=device)
    texels, triangle = found.numpy().astype(float), gbuffer.triangle.numpy()
    layer = texels[..., 3]
    np.testing.assert_array_equal(np.where(triangle >= 0, layer, -1.0), rate.layer)
    read = rate.is_read
    column, row = np.floor(texels[..., 0]), np.floor(texels[..., 1])
    expected = (layer * TEXELS + row) * TEXELS + column
    # float32 and float64 may put a point on either side of a texel's border
    assert (rate.texel[read] == expected[read]).mean() > 0.999

    middle = np.s_[1:-1, 1:-1]
    around = [np.s_[1:-1, 2:], np.s_[1:-1, :-2], np.s_[2:, 1:-1], np.s_[:-2, 1:-1]]  # right, left, below, above
    same = (triangle[middle] >= 0) & (layer[middle] >= 0)
    for there in around:
        same &= (triangle[there] == triangle[middle]) & (layer[there] == layer[middle])
    right, left, below, above = (texels[there][same][:, :2] for there in around)
    j = np.stack([0.5 * (right - left), 0.5 * (below - above)], axis=2)  # [map axis, pixel axis]
    assert same.sum() > 1000
    # a central difference over two pixels is off by the square of a pixel's share of the depth
    np.testing.assert_allclose(rate.det[middle][same], np.abs(np.linalg.det(j)), rtol=0.02)
    np.testing.assert_allclose(rate.x[middle][same], np.linalg.norm(j[:, 0], axis=1), rtol=0.02)
    np.testing.assert_allclose(rate.y[middle][same], np.linalg.norm(j[:, 1], axis=1), rtol=0.02)
    np.testing.assert_allclose(rate.m[middle][same], 1.0 / np.linalg.svd(j, compute_uv=False)[:, 1], rtol=0.02)


@pytest.mark.parametrize("kind", ["directional", "perspective"])
@pytest.mark.parametrize("projection", ["scene", "psm", "n_opt in splits"])
def test_perspective_errors_are_those_along_the_view_vector(kind: str, projection: str, device: str) -> None:
    """At the pixel in the middle of an image with an odd number of them."""
    scene = small_scenes.scene(
        [small_scenes.mesh("ground", small_scenes.plane(12.0))], LIGHTS[kind], small_scenes.camera()
    )
    views = compose(PROJECTIONS[projection]) if PROJECTIONS[projection] else None
    session = Session(Geometry(scene, device), width=65, height=33, device=device, projection=views)
    rate, _, gbuffer = measure(session)
    host, sample = session.shown.views, session.shown.light_ws
    z, m_x, m_z = perspective_aliasing(host, sample, session.eye(), steps=4001)
    depth = gbuffer.depth.numpy()[16, 32]
    known = np.isfinite(m_x)
    # the curve has a sample every 0.2 %
    assert rate.m_x[16, 32] == pytest.approx(np.interp(depth, z[known], m_x[known]), rel=1e-3)
    assert rate.m_z[16, 32] == pytest.approx(np.interp(depth, z[known], m_z[known]), rel=1e-3)
    # the largest error has the cosines of the surface in it, so that it bounds m_x only where that faces the eye too
    assert 0.5 * rate.m_x[16, 32] < rate.m[16, 32]


def test_pixels_without_a_lookup(device: str) -> None:
    """Nothing seen, no layer, nothing receives, or turned away from the light."""
    meshes = [
        small_scenes.mesh("ground", small_scenes.plane(12.0)),
        small_scenes.mesh("lamp shade", small_scenes.sphere((-2.0, 1.0, 0.0), 0.8), receives=False),
        small_scenes.mesh("ball", small_scenes.sphere((2.0, 1.0, 0.0), 0.8)),
    ]
    # light from behind the ball: its near side is in its own shadow
    lamp = DirectionalLight(direction=np.array([0.0, -0.3, 1.0]))
    session = session_of(small_scenes.scene(meshes, lamp, small_scenes.camera((0.0, 2.0, 8.0))), device)
    rate, light_map, gbuffer = measure(session)
    mesh = np.array([session.geometry.meshes[i].name for i in range(3)])[gbuffer.mesh.numpy()]
    seen = gbuffer.mesh.numpy() >= 0
    assert np.isnan(rate.m[~seen]).all() and (rate.layer[~seen] == -1).all()
    assert rate.is_read[seen & (mesh == "ground")].all()
    assert not rate.is_read[seen & (mesh == "lamp shade")].any()
    facing = gbuffer.normal_ws.numpy() @ -np.asarray(lamp.direction) > 0.0
    np.testing.assert_array_equal(rate.is_read[seen & (mesh == "ball")], facing[seen & (mesh == "ball")])
    assert np.isfinite(rate.m[seen & (mesh == "ball")]).all()  # also where none looks
    read = {tuple(place) for place in np.argwhere(_texels_read(rate, light_map))}
    assert unread_share(rate, light_map) == pytest.approx(1.0 - len(read) / TEXELS**2)
    # without any receiver there is nothing to lay a map over, and it serves no pixel
    nothing = [small_scenes.mesh("ball", small_scenes.sphere((2.0, 1.0, 0.0), 0.8), receives=False)]
    session = session_of(small_scenes.scene(nothing, lamp), device)
    rate, light_map, _ = measure(session)
    assert not rate.is_read.any() and unread_share(rate, light_map) == 1.0
    use = map_use(session)
    assert use is not None and use.waste == 1.0


def _texels_read(rate: SamplingRate, light_map: LightMap) -> np.ndarray:
    out = np.zeros((light_map.layers * light_map.resolution, light_map.resolution), dtype=bool)
    for texel in rate.texel[rate.is_read]:
        out[texel // light_map.resolution, texel % light_map.resolution] = True
    return out


@pytest.mark.parametrize("warp", ["none", "psm", "lispsm_nopt"])
@pytest.mark.parametrize("gamma_deg", [0.0, 1e-3, 1.0, 45.0, 90.0, 179.999, 180.0])
def test_stiff_views_give_finite_errors(warp: str, gamma_deg: float, device: str) -> None:
    """f/n = 1e6 with a near plane of 1e-3, duelling frusta, a light that grazes the ground, a world offset of 1e6."""
    shift = np.array([1e6, -1e6, 1e6])
    gamma = np.radians(gamma_deg)
    lamp = DirectionalLight(direction=np.array([0.0, -np.sin(gamma), -np.cos(gamma)]))
    plane, box = small_scenes.plane(2000.0, -1e-3, cells=40), small_scenes.box((3.0, 0.0, -20.0), (2.0, 2.0, 2.0))
    wall = small_scenes.box((-1.5e-3, 0.0, -1.0), (1e-3, 1.0, 2.0))
    meshes = [small_scenes.mesh(f"{i}", (v + shift, f)) for i, (v, f) in enumerate([plane, box, wall])]
    camera = Camera(shift, shift - np.eye(3)[2], np.array([0.0, 1.0, 0.0]), 60.0, 1e-3, 1e3)
    session = session_of(small_scenes.scene(meshes, lamp, camera), device, {"fit": "focused", "warp": warp})
    rate, _, gbuffer = measure(session)
    seen = gbuffer.mesh.numpy() >= 0
    assert seen.mean() > 0.4 and gbuffer.depth.numpy()[seen].min() < 3e-3
    # nothing is seen that the fitted map does not hold, but for rounding at its border
    assert (rate.layer[seen] == 0).mean() > 0.999
    for values in (rate.m, rate.m_x, rate.m_z, rate.det, rate.x, rate.y):
        assert np.isfinite(values[rate.layer >= 0]).all() and (values[rate.layer >= 0] >= 0.0).all()
    # the wall is edge-on to the light, whose map does not move along x there; all other rates have a size
    assert (rate.det[rate.layer >= 0] > 0.0).all() and (rate.m[rate.layer >= 0] > 1e-3).all()
    use = map_use(session)
    assert use is not None and 0.0 <= use.waste < 1.0 and 0.0 < use.unread < 1.0


def test_a_surface_edge_on_to_the_light_is_as_coarse_as_its_normal_can_tell(device: str) -> None:
    """m grows with one over the cosine, to that of ``LEAST_COSINE`` on the wall that the light runs along."""
    wall = small_scenes.convex(np.array([(x, y, z) for x in (-3.0, 3.0) for y in (-3.0, 3.0) for z in (-0.1, 0.0)]))
    errors = {}
    for cosine in (1e-1, 1e-2, 0.0):
        lamp = DirectionalLight(direction=np.array([0.0, -np.sqrt(1.0 - cosine**2), -cosine]))

        def fixed(sample: np.ndarray, *rest: Any) -> list[HostView]:
            forward = -sample[:3]
            axes = (np.array([1.0, 0.0, 0.0]), np.cross(forward, [1.0, 0.0, 0.0]), forward)
            return [HostView(-10.0 * forward, *axes, (-4, 4, -4, 4), 0.0, 20.0, TEXELS, TEXELS, perspective=False)]

        meshes = [small_scenes.mesh("wall", wall, casts=False)]
        session = session_of(small_scenes.scene(meshes, lamp, small_scenes.camera((0.0, 0.0, 5.0))), device)
        session.projection = fixed
        rate, _, _ = measure(session)
        errors[cosine] = float(rate.m[SIZE[1] // 2, SIZE[0] // 2])
    assert errors[1e-2] / errors[1e-1] == pytest.approx(10.0, rel=1e-4)
    assert errors[0.0] / errors[1e-1] == pytest.approx(0.1 / LEAST_COSINE, rel=1e-4)


# ---- wasted area --------------------------------------------------------------------------------------------------------


def square_view(half: float, choice: Any = None) -> ProjectiveView:
    """A view along -Y that holds |x|, |z| <= half."""
    rows = np.zeros((4, 4))
    rows[0, 0], rows[1, 2], rows[2, 1], rows[2, 3], rows[3, 3] = 1.0 / half, 1.0 / half, -1.0, 10.0, 1.0
    axes = (np.array([0.0, 10.0, 0.0]), np.eye(3)[0], np.eye(3)[2], -np.eye(3)[1])
    return ProjectiveView(*axes, (-1, 1, -1, 1), 0.0, 20.0, 8, 8, False, rows, choice)


def test_wasted_area_is_what_the_body_leaves_of_the_map() -> None:
    body = box_polyhedron(np.array([-1.0, 0.0, -1.0]), np.array([1.0, 1.0, 3.0]))
    assert wasted_shares([square_view(2.0)], body) == [pytest.approx(1.0 - 2.0 * 3.0 / 16.0)]  # z beyond 2 is cut off
    flat = box_polyhedron(np.array([-1.0, 0.0, -2.0]), np.array([1.0, 0.0, 2.0]))
    assert wasted_shares([square_view(2.0)], flat) == [pytest.approx(0.5)]
    away = box_polyhedron(np.array([5.0, 0.0, 5.0]), np.array([6.0, 1.0, 6.0]))
    assert wasted_shares([square_view(2.0)], away) == [1.0]


def test_wasted_area_of_splits_counts_their_own_part() -> None:
    body = box_polyhedron(np.array([-2.0, 0.0, -2.0]), np.array([2.0, 1.0, 2.0]))
    row = (0.0, 0.0, 1.0, 2.0)  # eye depth: z + 2
    for rule, expected in (("depth", [0.75, 0.25]), ("best", [0.0, 0.0])):
        views = [square_view(2.0, LayerChoice(rule, row, far)) for far in (1.0, np.inf)]  # type: ignore[arg-type]
        assert wasted_shares(views, body) == pytest.approx(expected)  # type: ignore[arg-type]


def test_tight_maps_waste_less(device: str) -> None:
    waste = {}
    corner = small_scenes.camera((2.0, 2.5, 5.0), (3.0, 0.0, 3.0), fov_deg=30.0)
    for projection, settings in PROJECTIONS.items():
        session = session_of(small_scenes.cluttered(LIGHTS["directional"], corner), device, settings)
        assert map_use(session) is None  # no map yet
        session.light_map(TEXELS)
        use = map_use(session)
        assert use is not None
        waste[projection] = use.waste
        # a texel that a pixel falls into is not wasted; the margin of a texel is
        assert use.waste <= use.unread + 0.01
    assert waste["focused"] < 0.5 < 0.9 < waste["scene"] and waste["psm"] < waste["focused"]

"""Composed projections: what their matrices cover, their error against closed forms, duelling frusta, drawn shadows."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import small_scenes

from algorithms.composition import compose
from algorithms.plugins import load_all
from experiments.analysis import errors_of
from experiments.config.analysis import Curve
from wkernels.clipping import box_polyhedron, clip_polyhedron, frustum_planes
from wkernels.errors import InputError
from wkernels.focusing import light_body, seen_body
from wkernels.frame import Session
from wkernels.geometry import Bounds, Geometry
from wkernels.light_views import perspective_aliasing
from wkernels.lights import DirectionalLight, PointLight
from wkernels.perspective_error import TiltedFrustum, partitioned_errors
from wkernels.scene import Camera, Mesh
from wkernels.splits import split_borders
from wkernels.views import HostView, ProjectiveView

WARPS: dict[str, dict[str, Any]] = {
    "none": {},
    "psm": {},
    "lispsm_nopt": {},
    "lispsm_nrepar": {},
    "arbitrary": {"warp_distance": 0.3},
}
FOV = np.radians(60.0)
TEXELS = 512


def eye_at(
    position: tuple[float, ...], forward: tuple[float, ...] = (0, 0, 1), near: float = 1.0, far: float = 40.0
) -> HostView:
    ahead = np.array(forward, float) / np.linalg.norm(forward)
    guide = np.array([0.0, 1.0, 0.0]) if abs(ahead[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = np.cross(ahead, guide)
    right /= np.linalg.norm(right)
    tangent = float(np.tan(0.5 * FOV))
    window = (-tangent, tangent, -tangent, tangent)
    return HostView(np.array(position, float), right, np.cross(right, ahead), ahead, window, near, far, TEXELS, TEXELS)


def bounds(low: tuple[float, ...], high: tuple[float, ...]) -> Bounds:
    out = Bounds()
    out.add(np.array([low, high], float))
    return out


def towards(gamma_deg: float) -> np.ndarray:
    """A directional sample whose light comes from above and makes that angle with the view direction +Z."""
    gamma = np.radians(gamma_deg)
    return np.array([0.0, np.sin(gamma), -np.cos(gamma), 0.0])


def project(view: HostView, points: np.ndarray) -> np.ndarray:
    h = points @ view.ws_to_ss[:, :3].T + view.ws_to_ss[:, 3]
    return np.column_stack([h[:, :2] / h[:, 3:], h[:, 2:]])


SCENE = bounds((-60.0, -5.0, -60.0), (60.0, 30.0, 60.0))
EYES = {
    "inside": eye_at((0, 2, -20)),
    "outside": eye_at((0, 10, -80), far=400.0),
    "looking down": eye_at((0, 25, 0), (0.1, -1, 0.2)),
    "turned": eye_at((5, 3, 5), (1, -0.2, -0.6)),
}
LIGHTS = {
    "overhead": np.array([0.0, 1.0, 0.0, 0.0]),
    "slanted": np.array([0.4, 0.8, -0.3, 0.0]) / np.linalg.norm([0.4, 0.8, -0.3]),
    "point": np.array([10.0, 200.0, -30.0, 1.0]),
}


# ---- what is covered -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("warp", WARPS)
def test_a_map_holds_the_body_of_all_relevant_light_rays_and_nothing_more(warp: str, eye: str, light: str) -> None:
    views = compose({"fit": "focused", "warp": warp, **WARPS[warp]})(LIGHTS[light], SCENE, SCENE, TEXELS, EYES[eye])
    (view,) = views
    assert isinstance(view, ProjectiveView)
    body = light_body(seen_body(SCENE, EYES[eye]), SCENE, LIGHTS[light])
    corners = body.vertices
    if light == "point":  # the light is outside the scene's box, and so is not a corner of the body
        assert (np.linalg.norm(corners - LIGHTS[light][:3], axis=1) > 1.0).all()
    mapped = project(view, corners)
    assert (mapped[:, 3] > 0.0).all()
    limit = 1.0 - 2.0 / TEXELS + 1e-9  # a texel of margin
    assert np.abs(mapped[:, :2]).max() <= limit
    np.testing.assert_allclose(mapped[:, :2].max(axis=0), limit, rtol=1e-6)
    np.testing.assert_allclose(mapped[:, :2].min(axis=0), -limit, rtol=1e-6)
    assert (mapped[:, 2] >= view.near).all() and (mapped[:, 2] <= view.far * (1.0 + 1e-9)).all()


def test_the_covered_body_is_the_intersection_of_frustum_and_box() -> None:
    rng = np.random.default_rng(5)
    for eye in EYES.values():
        body = seen_body(SCENE, eye)
        points = rng.uniform(SCENE.low, SCENE.high, (4000, 3))
        planes = frustum_planes(eye.ws_to_ss, eye.near, eye.far)
        inside = (points @ planes[:, :3].T + planes[:, 3] > 0.0).all(axis=1)
        faces = [(f[0], np.cross(f[1] - f[0], f[2] - f[0])) for f in body.faces]
        held = np.array([all((p - a) @ n <= 0.0 for a, n in faces) for p in points])
        np.testing.assert_array_equal(held, inside)
        assert body.volume == pytest.approx(clip_polyhedron(box_polyhedron(SCENE.low, SCENE.high), planes).volume)


@pytest.mark.parametrize("selection", ["depth", "best"])
@pytest.mark.parametrize("warp", WARPS)
def test_every_receiver_seen_is_held_by_the_layer_its_depth_chooses(warp: str, selection: str) -> None:
    settings = {"fit": "focused", "warp": warp, "splits": 4, "selection": selection, **WARPS[warp]}
    rng = np.random.default_rng(2)
    for eye in EYES.values():
        views = compose(settings)(LIGHTS["slanted"], SCENE, SCENE, TEXELS, eye)
        points = rng.uniform(SCENE.low, SCENE.high, (4000, 3))
        planes = frustum_planes(eye.ws_to_ss, eye.near, eye.far)
        points = points[(points @ planes[:, :3].T + planes[:, 3] > 0.0).all(axis=1)]
        depth = (points - eye.eye_ws) @ eye.forward_ws
        ends = [view.choice.far for view in views]  # type: ignore[attr-defined]
        assert ends == sorted(ends) and ends[-1] == np.inf and len(points) > 20
        layer = np.searchsorted(ends, depth, side="right")
        for index, view in enumerate(views):
            mapped = project(view, points[layer == index])
            assert (mapped[:, 3] > 0.0).all() and (np.abs(mapped[:, :2]) <= 1.0).all()


# ---- errors --------------------------------------------------------------------------------------------------------

# The closed forms speak of the frustum alone: a scene that holds all of it, and a map whose margin is taken off.
ALL = bounds((-300.0, -300.0, -300.0), (300.0, 300.0, 300.0))
MARGIN = (TEXELS - 2.0) / TEXELS


@pytest.mark.parametrize("splits", [1, 4])
@pytest.mark.parametrize("gamma", [90.0, 60.0, 20.0, 130.0])
@pytest.mark.parametrize("warp", ["none", "psm", "lispsm_nopt", "lispsm_nrepar"])
def test_sampled_errors_equal_the_closed_forms(warp: str, gamma: float, splits: int) -> None:
    eye, light = eye_at((0, 0, 0)), towards(gamma)
    settings = {"fit": "focused", "warp": warp, "splits": splits, "scheme": "log"}
    views = compose(settings)(light, ALL, ALL, TEXELS, eye)
    z, m_x, m_z = perspective_aliasing(views, light, eye, steps=200)
    curve = Curve("c", warp, None, splits, "log", 0.5, 0.0, 0.0, 1.0, 40.0, gamma)
    errors = errors_of(curve, 60.0)
    part = np.clip(np.searchsorted(errors.borders, z, side="right") - 1, 0, splits - 1)
    for index in range(splits):
        own = (part == index) & (z > errors.borders[index]) & (z < errors.borders[index + 1])
        frustum = TiltedFrustum(*(float(b) for b in errors.borders[index : index + 2]), 0.5 * FOV, np.radians(gamma))
        expected = frustum.errors(z[own], errors.distances[index])
        for found, closed in zip((m_x[own], m_z[own]), expected, strict=True):
            # pixels and texels are as many, but a texel at each side of the map is margin
            np.testing.assert_allclose(found * MARGIN, closed, rtol=1e-6)


def test_focusing_alone_shrinks_the_errors_by_the_ratio_of_what_is_covered() -> None:
    """Stingl 2011, Fig 3.5: the curves keep their shape."""
    eye, light = eye_at((0, 0, 0)), towards(90.0)
    _, m_x, _ = perspective_aliasing(compose()(light, ALL, ALL, TEXELS, eye), light, eye)
    _, f_x, _ = perspective_aliasing(compose({"fit": "focused"})(light, ALL, ALL, TEXELS, eye), light, eye)
    np.testing.assert_allclose(f_x / m_x, 40.0 * np.tan(0.5 * FOV) / 300.0, rtol=1e-6)


def test_the_published_example_is_what_the_map_does() -> None:
    """n = 1, f = 40, th = 30, gamma = 90: 6.3246 and 5.3403 at near, 1 and 5.3403 at far, least m_z 2.5182."""
    eye, light = eye_at((0, 0, 0)), towards(90.0)
    views = compose({"fit": "focused", "warp": "lispsm_nopt"})(light, ALL, ALL, TEXELS, eye)
    _, m_x, m_z = perspective_aliasing(views, light, eye, steps=401)
    np.testing.assert_allclose(m_x[[0, -1]] * MARGIN, (6.32456, 1.0), rtol=1e-5)
    np.testing.assert_allclose(
        (m_z[0] * MARGIN, m_z[-1] * MARGIN, m_z.min() * MARGIN), (5.34029, 5.34029, 2.5182), rtol=2e-5
    )


def test_nopt_is_worse_than_uniform_below_theta_and_nrepar_is_not() -> None:
    """Stingl 2011, Fig 3.8, measured over the whole frustum: m_x of the maps in use."""
    eye, light = eye_at((0, 0, 0), far=100.0), towards(20.0)
    worst = {}
    for warp in ("none", "lispsm_nopt", "lispsm_nrepar"):
        (view,) = compose({"fit": "focused", "warp": warp})(light, ALL, ALL, TEXELS, eye)
        corners = seen_body(ALL, eye).vertices
        step = 1e-6 * np.array([1.0, 0.0, 0.0])
        texels = np.linalg.norm(project(view, corners + step)[:, :2] - project(view, corners - step)[:, :2], axis=1)
        pixels = 2e-6 / ((corners - eye.eye_ws) @ eye.forward_ws * 2.0 * np.tan(0.5 * FOV)) * TEXELS
        worst[warp] = float((pixels / (0.5 * texels * TEXELS)).max() * MARGIN)
    assert worst["none"] == pytest.approx(100.0, rel=1e-4)
    assert worst["lispsm_nopt"] == pytest.approx(200.0, rel=0.01)
    assert worst["lispsm_nrepar"] == pytest.approx(111.0, rel=0.01)


# ---- stiff cases ---------------------------------------------------------------------------------------------------

ANGLES = [0.0, 1e-3, 0.01, 0.5, 0.999, 1.001, 5.0, 30.0, 90.0, 150.0, 179.0, 179.9999, 180.0]


@pytest.mark.parametrize("splits", [1, 4, 16])
@pytest.mark.parametrize("warp", WARPS)
def test_no_direction_of_the_light_breaks_a_map(warp: str, splits: int) -> None:
    """Finite everywhere, and no error above the uniform map's by more than z_1 / z_0 <= f/n of a split allows."""
    for angle, (near, far) in itertools.product(ANGLES, [(1.0, 100.0), (1e-3, 1e3), (1.0, 1e6)]):
        eye, light = eye_at((0, 0, 0), near=near, far=far), towards(angle)
        box = bounds((-2 * far,) * 3, (2 * far,) * 3)
        settings = {"fit": "focused", "splits": splits, "scheme": "log", "selection": "depth"}
        views = compose({**settings, "warp": warp, **WARPS[warp]})(light, box, box, TEXELS, eye)
        assert all(np.isfinite(view.ws_to_ss).all() for view in views)
        assert all(np.isfinite(view.ws_to_ss.astype(np.float32)).all() for view in views)
        _, m_x, m_z = perspective_aliasing(views, light, eye, steps=64)
        assert np.isfinite(m_x).all() and np.isfinite(m_z).all(), (angle, near, far)
        _, u_x, u_z = perspective_aliasing(compose(settings)(light, box, box, TEXELS, eye), light, eye, steps=64)
        # 1 + d / n' of the warp whose n' is 0.3 d
        factor = {"none": 1.0, "lispsm_nrepar": 1.2, "arbitrary": 1.0 + 1.0 / 0.3}.get(
            warp, (far / near) ** (1.0 / splits)
        )
        if warp == "lispsm_nrepar" and 30.0 <= min(angle, 180.0 - angle):
            factor = (far / near) ** (0.5 / splits)
        assert (m_x <= u_x * factor * (1.0 + 1e-6)).all(), (angle, near, far, (m_x / u_x).max())
        if warp != "arbitrary":
            assert (m_z <= u_z * (far / near) ** (1.0 / splits) * (1.0 + 1e-6)).all()


@pytest.mark.parametrize("warp", ["none", "lispsm_nopt"])
def test_a_light_amid_what_is_seen_gets_six_faces(warp: str) -> None:
    for splits in (1, 4):
        views = compose({"fit": "focused", "warp": warp, "splits": splits})(
            np.array([0.0, 3.0, -10.0, 1.0]), SCENE, SCENE, 64, EYES["inside"]
        )
        assert len(views) == 6 and not any(isinstance(view, ProjectiveView) for view in views)


def test_nothing_seen_and_empty_splits() -> None:
    away = eye_at((0, 2, -80), (0, 0, -1))
    assert len(compose({"fit": "focused", "splits": 4})(LIGHTS["overhead"], SCENE, SCENE, 64, away)) == 1
    # an eye far outside: the depth range is fitted first, so that no split lies in empty space
    far_off = eye_at((0, 5, -1000), near=1.0, far=5000.0)
    views = compose({"fit": "focused", "splits": 4, "scheme": "uniform"})(LIGHTS["overhead"], SCENE, SCENE, 64, far_off)
    ends = [view.choice.far for view in views]  # type: ignore[attr-defined]
    np.testing.assert_allclose(ends, [970.0, 1000.0, 1030.0, np.inf])
    flat = bounds((-5.0, -5.0, 7.0), (5.0, 5.0, 7.0))  # across the view: no depth range to split
    for warp in WARPS:
        views = compose({"fit": "focused", "splits": 4, "warp": warp, **WARPS[warp]})(
            LIGHTS["slanted"], flat, flat, 64, eye_at((0, 0, 0))
        )
        assert views and all(np.isfinite(view.ws_to_ss).all() for view in views)


def test_the_centre_on_the_view_vector_moves_as_the_eye_does_and_the_corner_jumps() -> None:
    """Stingl 2011, section 4.1: |dC| <= k |d eye|; under overhead light the warp is symmetric in every split."""
    light = LIGHTS["overhead"]
    for splits in (1, 4):
        for view in compose({"fit": "focused", "warp": "lispsm_nopt", "splits": splits})(
            light, ALL, ALL, TEXELS, eye_at((0, 0, 0))
        ):
            np.testing.assert_allclose(
                project(view, np.array([[0.0, 0.0, z] for z in (2.0, 9.0, 30.0)]))[:, 0], 0.0, atol=1e-9
            )
    skew = compose({"fit": "focused", "warp": "lispsm_nopt", "splits": 4, "warp_centre": "vertex"})(
        light, ALL, ALL, TEXELS, eye_at((0, 0, 0))
    )
    assert abs(project(skew[2], np.array([[0.0, 0.0, 9.0]]))[0, 0]) > 0.01

    def centre_line(angle: float, centre: str) -> np.ndarray:
        eye = eye_at((0, 2, 0), (np.sin(angle), -0.1, np.cos(angle)))
        settings = {"fit": "focused", "warp": "lispsm_nopt", "warp_centre": centre}
        (view,) = compose(settings)(LIGHTS["slanted"], SCENE, SCENE, TEXELS, eye)
        rows = view.ws_to_ss
        # the map's centre of projection in the plane: where x, y and w vanish together, but for depth
        planes = np.stack([rows[0], rows[1], rows[3]])
        return np.linalg.lstsq(planes[:, :3], -planes[:, 3], rcond=None)[0]

    moved = np.array([centre_line(angle, "view_vector") for angle in np.linspace(0.0, 0.5, 201)])
    steps = np.linalg.norm(np.diff(moved, axis=0), axis=1)
    assert steps.max() < 5.0 * np.median(steps)


# ---- stabilisers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("splits", [1, 3])
@pytest.mark.parametrize("stabilise", ["exact", "approximate"])
def test_texels_stay_where_they_are_as_the_eye_moves(stabilise: str, splits: int) -> None:
    settings = {"fit": "focused", "splits": splits, "scheme": "log", "stabilise": stabilise}
    light, scene = LIGHTS["slanted"], bounds((-60.0, 0.0, -60.0), (60.0, 0.0, 60.0))
    sizes = []
    for step in range(12):
        eye = eye_at((0.013 * step, 5.0, 0.031 * step - 20.0), (0.0, -0.3, 1.0))
        views = compose(settings)(light, scene, scene, TEXELS, eye)
        assert splits - 1 <= len(views) <= splits  # the first may see no ground
        for view in views:
            rows = view.ws_to_ss
            scale = 0.5 * TEXELS * np.linalg.norm(rows[:2, :3], axis=1)  # texels per unit
            corner = project(view, np.zeros((1, 3)))[0, :2] * 0.5 * TEXELS
            np.testing.assert_allclose(corner, np.round(corner), atol=1e-6)
            sizes.append(1.0 / scale)
            assert (np.abs(project(view, seen_body(scene, eye).vertices)[:, :2]) <= 1.0 + 1e-9).all() or splits > 1
    distinct = len(np.unique(np.round(np.array(sizes), 9), axis=0))
    assert distinct == len(views) if stabilise == "exact" else distinct <= 4 * splits


def test_a_point_light_cannot_be_stabilised() -> None:
    with pytest.raises(InputError, match=r"projection.stabilise: needs a directional light"):
        compose({"fit": "focused", "stabilise": "exact"})(LIGHTS["point"], SCENE, SCENE, 64, EYES["inside"])


def test_exactly_stabilised_maps_do_not_depend_on_where_the_eye_turns() -> None:
    settings = {"fit": "focused", "stabilise": "exact"}
    flat = bounds((-60.0, 0.0, -60.0), (60.0, 0.0, 60.0))
    scales = set()
    for angle in np.linspace(0.0, 6.0, 13):
        eye = eye_at((0, 3, 0), (np.sin(angle), -0.2, np.cos(angle)))
        (view,) = compose(settings)(LIGHTS["slanted"], flat, flat, TEXELS, eye)
        scales.add(round(float(np.linalg.norm(view.ws_to_ss[0, :3])), 9))
    assert len(scales) == 1


# ---- drawn shadows -------------------------------------------------------------------------------------------------


def posts(offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[Mesh]:
    shift = np.array(offset)
    ground, faces = small_scenes.plane(160.0)
    meshes = [Mesh("ground", ground + shift, faces)]
    for i, (x, z) in enumerate(itertools.product((-5.0, -2.5, 0.0, 2.5), (-73.0, -70.0, -62.0, -45.0, 30.0))):
        vertices, faces = small_scenes.box((x + 0.1 * i, 1.0, z), (0.4, 2.0, 0.4))
        meshes.append(Mesh(f"post {i}", vertices + shift, faces))
    return meshes


def hard_error(
    projection: dict[str, Any], device: str, lamp: Any, offset=(0.0, 0.0, 0.0), technique="shadow_map"
) -> float:
    """Share of receiver pixels in the lower half of the picture, near the eye, that differ from the ray cast."""
    eye = np.array([0.0, 3.0, -76.0]) + offset
    camera = Camera(eye, eye + np.array([0.0, -0.35, 1.0]), np.array([0.0, 1.0, 0.0]), 60.0, 0.5, 400.0)
    geometry = Geometry(small_scenes.scene(posts(offset), lamp, camera), device)
    table = load_all()
    pictures = []
    for name in ("ray_cast_point_shadow", technique):
        params = {"resolution": 256} if name == technique else {}
        session = Session(geometry, width=160, height=120, device=device, projection=compose(projection))
        pictures.append(session.render(table[name](table[name].Params(**params))).visibility[60:])
    seen = np.isfinite(pictures[0])
    return float((np.abs(pictures[0] - pictures[1])[seen] > 0.5).mean())


SUN = DirectionalLight(direction=np.array([0.6, -1.0, 0.3]))
FINER = {
    "psm": {"fit": "focused", "warp": "psm"},
    "n_opt": {"fit": "focused", "warp": "lispsm_nopt"},
    "n_repar": {"fit": "focused", "warp": "lispsm_nrepar"},
    "pssm4": {"fit": "focused", "splits": 4},
    "pssm4 best": {"fit": "focused", "splits": 4, "selection": "best"},
    "log4 n_opt": {"fit": "focused", "splits": 4, "scheme": "log", "warp": "lispsm_nopt"},
    "exact": {"fit": "focused", "splits": 4, "scheme": "log", "stabilise": "exact"},
    "approximate": {"fit": "focused", "splits": 4, "scheme": "log", "stabilise": "approximate"},
}


@pytest.mark.parametrize("lamp", ["sun", "point"])
def test_hard_shadows_near_the_eye_are_better_than_those_of_a_uniform_map(device: str, lamp: str) -> None:
    light = SUN if lamp == "sun" else PointLight(position=np.array([-60.0, 90.0, -120.0]))
    names = [name for name in FINER if lamp == "sun" or name not in ("exact", "approximate")]
    uniform = hard_error({"fit": "scene"}, device, light)
    found = {name: hard_error(FINER[name], device, light) for name in names}
    assert uniform > 0.02
    for name in names:
        assert found[name] < 0.6 * uniform, (uniform, found)


def test_world_offset_costs_nothing(device: str) -> None:
    near, far_off = (hard_error(FINER["log4 n_opt"], device, SUN, (d, 0.0, d)) for d in (0.0, 1e6))
    assert far_off == pytest.approx(near, abs=0.003)  # positions of 1e6 are rounded to 1e-10 before they are rebased


def test_filters_and_soft_shadows_take_any_composition(device: str) -> None:
    for name in ("pcf", "vsm"):
        assert hard_error(FINER["log4 n_opt"], device, SUN, technique=name) < hard_error(
            {"fit": "scene"}, device, SUN, technique=name
        )


def test_errors_of_drawn_maps_are_logged() -> None:
    borders = split_borders(1.0, 40.0, 4, "log")
    _, m_x, _ = partitioned_errors(borders, 0.5 * FOV, [np.inf] * 4)
    views = compose({"fit": "focused", "splits": 4, "scheme": "log"})(
        towards(90.0), ALL, ALL, TEXELS, eye_at((0, 0, 0))
    )
    _, found, _ = perspective_aliasing(views, towards(90.0), eye_at((0, 0, 0)), steps=2000)
    assert np.nanmax(found) * MARGIN == pytest.approx(m_x.max(), rel=2e-3)  # samples fall a little behind the borders

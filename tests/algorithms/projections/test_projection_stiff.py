"""Duelling frusta, lights amid what is seen, nothing seen: what breaks projections elsewhere."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from projection_cases import ALL, EYES, LIGHTS, SCENE, TEXELS, WARPS, bounds, eye_at, project, towards

from algorithms.composition import compose
from wkernels.light_views import perspective_aliasing
from wkernels.views import ProjectiveView

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

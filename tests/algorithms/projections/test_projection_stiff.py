"""Duelling frusta, lights amid what is seen, nothing seen: what breaks projections elsewhere."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from projection_cases import ALL, EYES, LIGHTS, SCENE, TEXELS, WARPS, bounds, eye_at, project, towards

from algorithms.projections.composition import Fallback, compose
from wkernels.projections.light_views import perspective_aliasing
from wkernels.scene.views import ProjectiveView

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


NEW_KEYS: dict[str, dict[str, Any]] = {
    "faces": {"partition": "faces"},
    "unadjusted": {"adjust": False, "splits": 4, "scheme": "log"},
    "tight": {"depth": "tight", "splits": 4, "scheme": "log", "selection": "best"},
}


@pytest.mark.parametrize("keys", NEW_KEYS)
@pytest.mark.parametrize("warp", WARPS)
def test_no_direction_of_the_light_breaks_faces_ranges_and_clamps(warp: str, keys: str) -> None:
    """Finite, and against one uniform map m_x is no worse with faces, and m_z by f/n at most."""
    settings = {"fit": "focused", "warp": warp, **WARPS[warp], **NEW_KEYS[keys]}
    for angle, (near, far) in itertools.product(ANGLES[::2], [(1.0, 100.0), (1e-3, 1e3), (1.0, 1e6)]):
        eye, light = eye_at((0, 0, 0), near=near, far=far), towards(angle)
        box = bounds((-2 * far,) * 3, (2 * far,) * 3)
        views = compose(settings)(light, box, box, TEXELS, eye)
        assert all(np.isfinite(view.ws_to_ss.astype(np.float32)).all() for view in views)
        _, m_x, m_z = perspective_aliasing(views, light, eye, steps=64)
        assert np.isfinite(m_x).all() and np.isfinite(m_z).all(), (angle, near, far)
        _, u_x, u_z = perspective_aliasing(compose({"fit": "focused"})(light, box, box, TEXELS, eye), light, eye, 64)
        # faces turn their warps away from the view vector; 1 + d / n' of the warp whose n' is 0.3 d
        allowed = 1.0 if keys == "faces" else 1.0 + 1.0 / 0.3 if warp == "arbitrary" else (far / near) ** 0.25
        assert (m_x <= u_x * allowed * (1.0 + 1e-6)).all(), (angle, near, far, (m_x / u_x).max())
        assert (m_z <= u_z * far / near * 1.01).all(), (angle, near, far, (m_z / u_z).max())


@pytest.mark.parametrize("keys", NEW_KEYS)
def test_new_keys_take_what_is_degenerate(keys: str) -> None:
    settings = {"fit": "focused", "warp": "lispsm_nopt", **NEW_KEYS[keys]}
    amid = compose(settings)
    views = amid(np.array([0.0, 3.0, -10.0, 1.0]), SCENE, SCENE, 64, EYES["inside"])
    assert len(views) == 6 and amid.left_out == [Fallback.TOO_WIDE]  # type: ignore[attr-defined]
    away = compose(settings)
    assert len(away(LIGHTS["overhead"], SCENE, SCENE, 64, eye_at((0, 2, -80), (0, 0, -1)))) == 1
    assert away.left_out == [Fallback.NOTHING_SEEN]  # type: ignore[attr-defined]
    flat = bounds((-5.0, -5.0, 7.0), (5.0, 5.0, 7.0))
    for eye, box in [(eye_at((0, 0, 0)), flat), *((eye, SCENE) for eye in EYES.values())]:
        for light in LIGHTS.values():
            views = compose(settings)(light, box, box, 64, eye)
            assert views and all(np.isfinite(view.ws_to_ss).all() for view in views)
    closed = eye_at((0, 2, -20), near=40.0, far=40.0)  # an automatic near plane at the far one
    assert compose(settings)(LIGHTS["slanted"], SCENE, SCENE, 64, closed)


def test_what_cannot_be_done_is_told() -> None:
    duel = compose({"fit": "focused", "warp": "lispsm_nopt", "splits": 2})
    duel(towards(0.5), ALL, ALL, TEXELS, eye_at((0, 0, 0)))
    assert duel.left_out == [Fallback.DUELLING] * 2  # type: ignore[attr-defined]
    duel(towards(1.5), ALL, ALL, TEXELS, eye_at((0, 0, 0)))
    assert duel.left_out == [], "of the last call alone"  # type: ignore[attr-defined]
    flat = bounds((-5.0, -5.0, 7.0), (5.0, 5.0, 7.0))
    split = compose({"fit": "focused", "splits": 4})
    split(LIGHTS["slanted"], flat, flat, 64, eye_at((0, 0, 0)))
    assert split.left_out == [Fallback.NO_DEPTH]  # type: ignore[attr-defined]


def test_without_adjustment_splits_lie_in_empty_space() -> None:
    """Stingl 2011, Fig 3.11."""
    far_off = eye_at((0, 5, -1000), near=1.0, far=5000.0)  # sees the scene between the depths 940 and 1060
    found = {}
    for adjust in (True, False):
        composed = compose({"fit": "focused", "splits": 4, "scheme": "uniform", "adjust": adjust})
        views = composed(LIGHTS["overhead"], SCENE, SCENE, 64, far_off)
        found[adjust] = len(views), len(composed.left_out)  # type: ignore[attr-defined]
        assert views[-1].choice.far == (np.inf if adjust else 1250.75)  # type: ignore[attr-defined]
    assert found == {True: (4, 0), False: (1, 3)}


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

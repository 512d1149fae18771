"""The sampling errors of composed projections against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from projection_cases import ALL, FOV, MARGIN, TEXELS, eye_at, project, towards

from algorithms.projections.composition import compose
from experiments.kinds.analysis.config import Curve
from experiments.kinds.analysis.run import errors_of
from wkernels.analysis.perspective_error import TiltedFrustum, partitioned_errors
from wkernels.projections.focusing import seen_body
from wkernels.projections.light_views import perspective_aliasing
from wkernels.projections.splits import split_borders


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


def test_errors_of_drawn_maps_are_logged() -> None:
    borders = split_borders(1.0, 40.0, 4, "log")
    _, m_x, _ = partitioned_errors(borders, 0.5 * FOV, [np.inf] * 4)
    views = compose({"fit": "focused", "splits": 4, "scheme": "log"})(
        towards(90.0), ALL, ALL, TEXELS, eye_at((0, 0, 0))
    )
    _, found, _ = perspective_aliasing(views, towards(90.0), eye_at((0, 0, 0)), steps=2000)
    assert np.nanmax(found) * MARGIN == pytest.approx(m_x.max(), rel=2e-3)  # samples fall a little behind the borders

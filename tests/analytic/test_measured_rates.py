"""Stingl 2011, Fig 3.8, in sampling rates of real pixels instead of formulas: warps under light from before or behind."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes

from algorithms.projections.composition import compose
from algorithms.projections.projection import WarpShape
from algorithms.projections.table import warps
from wkernels.analysis.perspective_error import TiltedFrustum
from wkernels.analysis.sampling_rate import SamplingRate, sampling_rate
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight
from wkernels.scene.model import Camera, Scene

THETA = np.radians(30.0)
NEAR, FAR = 1.0, 100.0
WARPS = ("none", "lispsm_nopt", "lispsm_nrepar")


def slats(gamma_deg: float) -> Scene:
    """Plates at all depths of a frustum of 60 degrees, in a box that holds all of it, under light from behind the eye."""
    rng = np.random.default_rng(1)
    shapes = [small_scenes.box((0.0, 0.0, -50.0), (130.0, 130.0, 110.0))]
    for z in np.geomspace(1.05, 99.0, 60):
        for x, y in rng.uniform(-0.98, 0.98, (3, 2)) * z * np.tan(THETA):
            shapes.append(small_scenes.box((x, y, -z), (0.12 * z, 0.12 * z, 0.01 * z)))
    meshes = [small_scenes.mesh(str(i), shape, casts=False) for i, shape in enumerate(shapes)]
    gamma = np.radians(gamma_deg)
    lamp = DirectionalLight(direction=np.array([0.0, -np.sin(gamma), -np.cos(gamma)]))
    eye = Camera(np.zeros(3), np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]), 60.0, NEAR, FAR)
    return small_scenes.scene(meshes, lamp, eye)


def measured(gamma_deg: float, device: str) -> dict[str, tuple[SamplingRate, np.ndarray]]:
    """Per warp: rates, and which pixels show a plate's face towards the eye."""
    geometry, out = Geometry(slats(gamma_deg), device), {}
    for warp in WARPS:
        projection = compose({"fit": "focused", "warp": warp})
        session = Session(geometry, width=96, height=96, device=device, projection=projection)
        gbuffer = session.gbuffer()
        facing = gbuffer.normal_ws.numpy()[..., 2] > 0.99
        out[warp] = sampling_rate(session, session.light_map(512).map, gbuffer), facing
    return out


def predicted(warp: str, gamma_deg: float) -> float:
    """Greatest m_x of a square frustum over that of the uniform map, from the closed form."""
    frustum = TiltedFrustum(NEAR, FAR, THETA, np.radians(gamma_deg))
    shape = WarpShape(NEAR, FAR, *frustum.end_depths, frustum.extent, THETA, frustum.gamma)
    distance = warps()[warp]().distance(shape)
    return frustum.max_m_x(distance) / frustum.max_m_x()


@pytest.mark.parametrize("gamma_deg", [5.0, 10.0, 15.0, 20.0, 25.0, 30.0])
def test_nopt_is_coarser_than_uniform_in_x_below_theta_and_nrepar_is_not(gamma_deg: float, device: str) -> None:
    rates = measured(gamma_deg, device)
    uniform = rates["none"][0]
    seen = uniform.layer >= 0
    assert seen.mean() > 0.8
    ratios = {}
    for warp, (rate, facing) in rates.items():
        ratios[warp] = float(rate.m_x[seen].max() / uniform.m_x[seen].max())
        # the coarsest pixel is one of the nearest plate's, which is nearly the frustum's coarsest point
        assert ratios[warp] == pytest.approx(predicted(warp, gamma_deg), rel=0.03)
        # plates that face the eye: texels per pixel along the map's x say the same, without any formula of m
        least = float(rate.x[facing].min() / uniform.x[facing].min())
        assert least == pytest.approx(1.0 / ratios[warp], rel=0.03)
    assert ratios["lispsm_nopt"] > (1.5 if gamma_deg < 27.0 else 1.03)
    # its eta gives up some of x from a third of theta on (Stingl 2011, equation 3.4)
    assert ratios["lispsm_nrepar"] <= (1.0 + 1e-6 if gamma_deg <= 10.0 else 1.13)
    assert ratios["lispsm_nrepar"] < ratios["lispsm_nopt"]


@pytest.mark.parametrize("gamma_deg", [45.0, 90.0])
def test_both_warps_refine_x_above_theta(gamma_deg: float, device: str) -> None:
    rates = measured(gamma_deg, device)
    seen = rates["none"][0].layer >= 0
    for warp in ("lispsm_nopt", "lispsm_nrepar"):
        assert rates[warp][0].m_x[seen].max() < 0.5 * rates["none"][0].m_x[seen].max()

"""pcf_poisson: the ramp of a straight edge, its lanes against the plain kernel, and the taps that it takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
from filtering_sessions import render

from wkernels.scene.lights import PointLight
from wkernels.scene.model import Camera, Scene

FILTERS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("pcf_poisson", {}),
    ("pcf_poisson", {"taps": 16, "bias": "constant"}),
    ("pcf_blocker_skip", {}),
    ("pcf_blocker_skip", {"search": "disc", "search_taps": 4, "taps": 16, "radius": 5.0}),
    ("pcf_blocker_skip", {"bilinear": False, "bias": "normal"}),
)


def half_plane() -> Scene:
    """A caster over x > 0 halfway between a point light and the ground: the hard edge lies on x = 0."""
    ground = small.mesh("ground", small.plane(12.0), casts=False)
    caster = small.mesh("half plane", small.plane(20.0, y=5.0, centre=(10.0, 0.0)), receives=False)
    eye = Camera(np.array([0.0, 4.5, 0.1]), np.zeros(3), np.array([0.0, 0.0, -1.0]), 60.0, 0.1, 100.0)
    return small.scene([ground, caster], PointLight(position=np.array([0.0, 10.0, 0.0])), eye)


@pytest.mark.parametrize("name", ["pcf_poisson", "pcf_blocker_skip"])
@pytest.mark.parametrize("radius", [2.0, 6.0])
def test_a_straight_edge_becomes_the_ramp_of_a_disc(name: str, radius: float) -> None:
    """The share of the disc on the lit side, 1 - (acos h - h sqrt(1 - h^2)) / pi, of constant width."""
    result = render(half_plane(), name, radius=radius, resolution=256, taps=64, size=(192, 144))
    x = result.world_position[..., 0].astype(float)
    texel = 12.6 / 256  # of the ground, whose box the map fits with 5 % to spare
    h = np.clip(-x / (radius * texel), -1.0, 1.0)
    expected = 1.0 - (np.arccos(h) - h * np.sqrt(1.0 - h * h)) / np.pi
    error = result.visibility - expected
    # the edge is known to half a texel, of which the ramp spans 2 radius, and a search of 9 drops 2 %
    assert np.abs(error).max() < 0.6 / radius + 0.03
    assert np.sqrt(np.mean(error**2)) < 0.15 / radius
    levels = np.unique(result.visibility)
    assert len(levels) > 65, "bilinear taps have more levels than there are taps"


def test_64_taps_hide_the_staircase_that_4_leave() -> None:
    """Along a slanted edge the filtered image deviates less from its own smooth version."""
    scene = half_plane()
    turned = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    pose = np.eye(4)
    pose[:3, :3] = turned
    caster = scene.meshes[1]
    scene = small.scene(
        [scene.meshes[0], small.mesh("turned", (caster.vertices @ turned.T, caster.faces), receives=False)],
        scene.lights[0],
        scene.camera(0),
    )
    rough = {}
    for taps in (4, 64):
        result = render(scene, "pcf_poisson", taps=taps, resolution=64, radius=2.0, size=(192, 144))
        along = result.world_position.astype(float) @ turned  # the edge lies on x = 0 of the caster's axes
        steps = np.round(along[..., 0] / 0.02).astype(int)
        spread = [result.visibility[steps == k].std() for k in range(-20, 20)]
        rough[taps] = float(np.mean(spread))
    assert rough[64] < 0.75 * rough[4] and rough[64] < 0.05, rough

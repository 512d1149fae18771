"""projection_aliasing_mitigation: it hides the steps on steep walls, bleeds where it is told to, and touches no more."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small
from compare import rmse
from filtering_sessions import render, technique

from wkernels.scene.lights import DirectionalLight
from wkernels.scene.model import Camera, Mesh, Scene

NAME = "projection_aliasing_mitigation"


def steep_wall(cosine: float) -> Scene:
    """A wall that the light meets at this cosine, with the slanted shadow of a bar on it."""
    wall = Mesh(
        "wall",
        np.array([(0.0, y, z) for y in (-3.0, 3.0) for z in (-3.0, 3.0)]),
        np.array([[0, 2, 1], [1, 2, 3]], np.int32),
        casts=False,
    )
    tilt = np.sqrt(1.0 - cosine**2)
    sun = DirectionalLight(direction=np.array([-cosine, -0.8 * tilt, 0.6 * tilt]))
    bar = small.mesh("bar", small.box((0.05, 2.5, -1.0), (0.05, 0.3, 1.5)), receives=False)
    view = Camera(np.array([7.0, 0.0, 0.1]), np.array([0.0, 0.0, 0.1]), np.array([0.0, 1.0, 0.0]), 45.0, 0.1, 100.0)
    return small.scene([wall, bar], sun, view)


def test_steps_on_a_steep_wall_are_hidden() -> None:
    """Nearer to the ray cast than the map alone, until the filter is wider than the steps and blurs the edge itself."""
    scene = steep_wall(0.04)
    size = (160, 120)
    rays = render(scene, "ray_cast_point_shadow", size=size).visibility
    error = {}
    for width in (0.0, 2.0, 4.0):
        image = render(scene, NAME, resolution=64, half_width=width, taps=32, size=size).visibility
        error[width] = rmse(image, rays)
    assert error[0.0] > 0.05 and error[2.0] < 0.92 * error[0.0] and error[4.0] > error[2.0], error


def test_only_steep_surfaces_are_smoothed_where_a_cosine_says_so() -> None:
    scene = small.cluttered(small.light("point", (3.0, 7.0, 2.0)))
    size = (128, 96)
    plain = render(scene, "shadow_map", resolution=256, size=size)
    some = render(scene, NAME, resolution=256, size=size, cosine=0.3).visibility
    everything = render(scene, NAME, resolution=256, size=size).visibility
    changed = [np.nan_to_num(image) != np.nan_to_num(plain.visibility) for image in (some, everything)]
    assert 0.0 < np.mean(changed[0]) < 0.5 * np.mean(changed[1])
    assert not (changed[0] & ~changed[1]).any()
    none = render(scene, NAME, resolution=256, size=size, cosine=0.0).visibility
    np.testing.assert_array_equal(none, plain.visibility)


def test_shadows_bleed_over_outlines_unless_depth_counts() -> None:
    """Expected artefact: the box's top is lit, its shadow on the ground lies beside it in the picture."""
    sun = DirectionalLight(direction=np.array([0.8, -1.0, 0.0]))
    ground = small.mesh("ground", small.plane(12.0), casts=False)
    box = small.mesh("box", small.box((0.0, 1.0, 0.0), (1.5, 0.4, 1.5)))
    view = Camera(np.array([0.0, 9.0, 0.1]), np.zeros(3), np.array([0.0, 0.0, -1.0]), 45.0, 0.1, 100.0)
    scene = small.scene([ground, box], sun, view)
    lost = {}
    for aware in (True, False):
        result = render(scene, NAME, half_width=6.0, depth_aware=aware, size=(128, 96))
        top = np.abs(result.world_position[..., 1] - 1.2) < 1e-3
        lost[aware] = float(np.mean(1.0 - result.visibility[top]))
    assert top.sum() > 300 and lost[True] < 1e-3 and lost[False] > 0.02, lost


def test_it_smooths_what_the_shadow_map_says() -> None:
    """A twin of the filter on a picture without depth edges: the mean of the pixel and its rounded taps."""
    from wkernels.filters.neighbourhood_filter import opposite_taps

    ground = small.mesh("ground", small.plane(40.0), casts=False)
    box = small.mesh("box", small.box((0.0, 9.0, 0.0), (1.0, 0.3, 1.0)), receives=False)
    view = Camera(np.array([0.0, 6.0, 0.1]), np.zeros(3), np.array([0.0, 0.0, -1.0]), 45.0, 0.1, 100.0)
    scene = small.scene([ground, box], small.light("point", (0.0, 12.0, 0.0)), view)
    size = (64, 48)
    plain = render(scene, "shadow_map", resolution=256, size=size).visibility.astype(float)
    image = render(scene, NAME, resolution=256, half_width=3.0, taps=8, size=size).visibility
    assert 0.05 < np.mean(plain) < 0.95
    total, count = plain.copy(), np.ones_like(plain)
    for dx, dy in opposite_taps(8).astype(np.float32):
        y, x = np.indices(plain.shape)
        x, y = np.rint(x + 3.0 * dx).astype(int), np.rint(y + 3.0 * dy).astype(int)
        inside = (x >= 0) & (y >= 0) & (x < size[0]) & (y < size[1])
        total[inside] += plain[y[inside], x[inside]]
        count += inside
    np.testing.assert_allclose(image, total / count, atol=1e-6)


def test_odd_tap_counts_are_refused() -> None:
    with pytest.raises(ValueError, match="multiple of 2"):
        technique(NAME, taps=3)

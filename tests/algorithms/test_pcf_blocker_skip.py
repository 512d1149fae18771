"""pcf_blocker_skip: what its search settles, what it misses, and what it leaves out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
from filtering_sessions import INSIDE, render, session, technique

from wkernels.errors import InputError
from wkernels.filters.searched_filter import rim_taps
from wkernels.scene.lights import Light, PointLight
from wkernels.scene.model import Camera, Scene


def unfiltered(result: Any) -> int:
    return sum(count for what, _, count in result.left_out if what == "filter of pixels")


@pytest.mark.parametrize("count", [1, 2, 9, 33])
def test_the_rim_bounds_what_a_straight_edge_can_hide(count: int) -> None:
    taps = rim_taps(count)
    assert taps.shape == (count, 2) and (taps[0] == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(taps[1:], axis=1), 1.0, rtol=1e-12)
    if count < 9:
        return
    angle = 2.0 * np.pi / (count - 1)
    for direction in np.linspace(0.0, 2.0 * np.pi, 97):
        reach = (taps @ [np.cos(direction), np.sin(direction)]).max()
        segment = (2.0 * np.arccos(reach) - np.sin(2.0 * np.arccos(reach))) / (2.0 * np.pi)
        assert segment <= (angle - np.sin(angle)) / (2.0 * np.pi) + 1e-12


def test_a_search_needs_a_tap() -> None:
    with pytest.raises(InputError, match="at least 1 tap"):
        rim_taps(0)


MISSES = {
    # (search, taps): largest share of pixels off by more than 0.01, and largest mean of what is lost
    ("rim", 9): (0.02, 0.0015),
    ("rim", 33): (0.006, 0.0006),
    ("disc", 9): (0.08, 0.005),
    ("disc", 256): (0.002, 0.0002),
}


@pytest.mark.parametrize(("search", "taps"), MISSES)
@pytest.mark.parametrize("lamp", [small.light("rectangle"), small.light("directional"), INSIDE])
def test_miss_rate_against_the_full_filter(search: str, taps: int, lamp: Light) -> None:
    scene = small.cluttered(lamp)
    full = render(scene, "pcf_poisson", resolution=512, size=(160, 120)).visibility
    result = render(scene, "pcf_blocker_skip", resolution=512, size=(160, 120), search=search, search_taps=taps)
    error = np.abs(result.visibility - full)
    rate, mean = MISSES[search, taps]
    assert np.nanmean(error > 0.01) <= rate and np.nanmean(error) <= mean


def test_the_rim_misses_less_than_as_many_taps_all_over_the_disc() -> None:
    scene = small.cluttered(small.light("rectangle"))
    full = render(scene, "pcf_poisson", resolution=512, size=(160, 120)).visibility
    rate = {
        search: np.nanmean(
            np.abs(render(scene, "pcf_blocker_skip", resolution=512, size=(160, 120), search=search).visibility - full)
            > 0.01
        )
        for search in ("rim", "disc")
    }
    assert rate["rim"] < 0.5 * rate["disc"], rate


def speck(width: float) -> Scene:
    """A square of this width halfway between a point light and the ground."""
    ground = small.mesh("ground", small.plane(12.0), casts=False)
    square = small.mesh("speck", small.box((0.013, 5.0, 0.017), (width, 0.01, width)), receives=False)
    eye = Camera(np.array([0.0, 1.2, 0.1]), np.zeros(3), np.array([0.0, 0.0, -1.0]), 60.0, 0.1, 100.0)
    return small.scene([ground, square], PointLight(position=np.array([0.0, 10.0, 0.0])), eye)


def test_a_sparse_search_drops_small_shadows() -> None:
    """Expected artefact, lighter: a shadow of 3 texels passes between the taps of a search that is 16 texels wide."""
    params = {"radius": 8.0, "resolution": 256, "size": (96, 72)}
    full = render(speck(0.075), "pcf_poisson", **params).visibility
    shadow = float(np.mean(1.0 - full))
    lost = {}
    for search, taps in (("rim", 9), ("disc", 9), ("disc", 256)):
        image = render(speck(0.075), "pcf_blocker_skip", search=search, search_taps=taps, **params).visibility
        lost[search, taps] = float(np.mean(image - full)) / shadow
    assert shadow > 0.005
    assert lost["rim", 9] > 0.3 and lost["disc", 9] > 0.1 and abs(lost["disc", 256]) < 0.02, lost


def test_what_is_left_out_is_recorded_and_shows_in_no_bit() -> None:
    scene = small.box_on_ground(small.light("rectangle"))
    made = technique("pcf_blocker_skip")
    skipping = session(scene, size=(256, 96)).render(made)
    honest = session(scene, size=(256, 96), skips=False).render(made)
    np.testing.assert_array_equal(skipping.visibility, honest.visibility)
    receivers = np.isfinite(skipping.visibility).sum()
    assert 0.2 * receivers < unfiltered(skipping) < receivers and unfiltered(honest) == 0
    decided = (skipping.visibility == 0.0) | (skipping.visibility == 1.0)
    assert unfiltered(skipping) <= decided.sum(), "a pixel that was not filtered is lit or dark"


def test_all_dark_and_all_lit_need_no_filter() -> None:
    ground = small.mesh("ground", small.plane(12.0), casts=False)
    roof = small.mesh("roof", small.box((0.0, 7.5, 0.0), (60.0, 0.5, 60.0)), receives=False)
    speck = small.mesh("speck", small.box((0.0, -0.5, 0.0), (0.1, 0.1, 0.1)), receives=False)
    for caster, expected in ((roof, 0.0), (speck, 1.0)):
        scene = small.scene([ground, caster], PointLight(position=np.array([0.0, 10.0, 0.0])))
        result = session(scene).render(technique("pcf_blocker_skip"))
        seen = np.isfinite(result.visibility)
        assert (result.visibility[seen] == expected).all() and unfiltered(result) == seen.sum()

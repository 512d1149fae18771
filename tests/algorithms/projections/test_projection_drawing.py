"""Shadows drawn through composed projections, against the ray cast."""

from __future__ import annotations

import numpy as np
import pytest
from projection_cases import FINER, SUN, hard_error

from wkernels.scene.lights import PointLight


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

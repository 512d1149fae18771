"""Texels that stay where they are."""

from __future__ import annotations

import numpy as np
import pytest
from projection_cases import EYES, LIGHTS, SCENE, TEXELS, bounds, eye_at, project

from algorithms.projections.composition import compose
from wkernels.errors import InputError
from wkernels.projections.focusing import seen_body


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

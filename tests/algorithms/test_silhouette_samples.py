"""silhouette_samples: closed forms, cut-outs, threads; conformance and ``test_edge_rays`` compare it with rays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_scenes as small
from sessions import open_session, render, technique, walk

from experiments import render_visibility
from experiments.scenes import analytic
from wkernels.scene.cutouts import Mask

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
PENUMBRAE = ("a1_half_plane", "a2_half_plane_disc", "a3_coaxial_discs", "a4_rectangle", "a5_two_occluders")


@pytest.mark.parametrize("name", [*PENUMBRAE, "a6_empty", "a7_full_occluder", "a8_box", "a9_tilted_plane"])
def test_closed_forms(name: str) -> None:
    """Within three standard errors, those of the scenes without a penumbra exactly, as rays are."""
    result = render_visibility(SCENES / f"{name}.yaml", "silhouette_samples", {"samples": 256}, width=120, height=90)
    rays = render_visibility(SCENES / f"{name}.yaml", "reference_multisample", {"samples": 256}, width=120, height=90)
    seen = np.isfinite(result.visibility)
    assert np.mean(np.abs(result.visibility[seen] - rays.visibility[seen])) < 1e-4
    if name in analytic.CLOSED_FORMS:
        expected = analytic.CLOSED_FORMS[name](result.world_position[seen].astype(np.float64))
        error = np.abs(result.visibility[seen] - expected)
        allowed = 3.0 * result.standard_error[seen] + 2.0 / 256 if name in PENUMBRAE else 1e-6
        assert np.mean(error <= allowed) >= 0.997


def test_threads_change_no_bit(device: str) -> None:
    scene = small.cluttered(small.light("sphere", (2.0, 8.0, -1.0)))
    one, two = (
        walk(scene, device, "silhouette_samples", 2, {"threads": threads}, samples=64)[1].visibility
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one, two)


def test_cut_out_casters_take_rays_and_that_is_told(device: str) -> None:
    scene = small.cluttered(small.light("rectangle", (2.0, 8.0, -1.0)))
    uv = np.random.default_rng(1).random((len(scene.meshes[1].vertices), 2))
    mask = Mask(uv, np.random.default_rng(2).random((8, 8)))
    cut = replace(scene, meshes=(scene.meshes[0], replace(scene.meshes[1], mask=mask), scene.meshes[2]))
    result = render(cut, device, "silhouette_samples", samples=32)
    np.testing.assert_array_equal(
        result.visibility, render(cut, device, "reference_multisample", samples=32).visibility
    )
    reason = "a texture cuts a caster out, and every sample gets its ray"
    assert any(reason in key for key in result.left_out)
    assert not any(reason in key for key in render(scene, device, "silhouette_samples", samples=32).left_out)


def test_edges_are_classed_once_for_a_still_light(device: str) -> None:
    session = open_session(small.cluttered(small.light("disc", (2.0, 8.0, -1.0))), device)
    made = technique("silhouette_samples", samples=16)
    names = []
    for frame in range(2):
        session.begin(frame)
        names.append({name for name, _ in session.render(made).passes})
        session.advance()
    assert "potential silhouettes" in names[0]
    assert "potential silhouettes" not in names[1] and "silhouettes" in names[1]

"""What the matrices of composed projections cover."""

from __future__ import annotations

import numpy as np
import pytest
from projection_cases import EYES, LIGHTS, SCENE, TEXELS, WARPS, project

from algorithms.projections.composition import compose
from wkernels.projections.clipping import box_polyhedron, clip_polyhedron, frustum_planes
from wkernels.projections.focusing import light_body, seen_body
from wkernels.scene.views import ProjectiveView


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("warp", WARPS)
def test_a_map_holds_the_body_of_all_relevant_light_rays_and_nothing_more(warp: str, eye: str, light: str) -> None:
    views = compose({"fit": "focused", "warp": warp, **WARPS[warp]})(LIGHTS[light], SCENE, SCENE, TEXELS, EYES[eye])
    (view,) = views
    assert isinstance(view, ProjectiveView)
    body = light_body(seen_body(SCENE, EYES[eye]), SCENE, LIGHTS[light])
    corners = body.vertices
    if light == "point":  # the light is outside the scene's box, and so is not a corner of the body
        assert (np.linalg.norm(corners - LIGHTS[light][:3], axis=1) > 1.0).all()
    mapped = project(view, corners)
    assert (mapped[:, 3] > 0.0).all()
    limit = 1.0 - 2.0 / TEXELS + 1e-9  # a texel of margin
    assert np.abs(mapped[:, :2]).max() <= limit
    np.testing.assert_allclose(mapped[:, :2].max(axis=0), limit, rtol=1e-6)
    np.testing.assert_allclose(mapped[:, :2].min(axis=0), -limit, rtol=1e-6)
    assert (mapped[:, 2] >= view.near).all() and (mapped[:, 2] <= view.far * (1.0 + 1e-9)).all()


def test_the_covered_body_is_the_intersection_of_frustum_and_box() -> None:
    rng = np.random.default_rng(5)
    for eye in EYES.values():
        body = seen_body(SCENE, eye)
        points = rng.uniform(SCENE.low, SCENE.high, (4000, 3))
        planes = frustum_planes(eye.ws_to_ss, eye.near, eye.far)
        inside = (points @ planes[:, :3].T + planes[:, 3] > 0.0).all(axis=1)
        faces = [(f[0], np.cross(f[1] - f[0], f[2] - f[0])) for f in body.faces]
        held = np.array([all((p - a) @ n <= 0.0 for a, n in faces) for p in points])
        np.testing.assert_array_equal(held, inside)
        assert body.volume == pytest.approx(clip_polyhedron(box_polyhedron(SCENE.low, SCENE.high), planes).volume)


@pytest.mark.parametrize("selection", ["depth", "best"])
@pytest.mark.parametrize("warp", WARPS)
def test_every_receiver_seen_is_held_by_the_layer_its_depth_chooses(warp: str, selection: str) -> None:
    settings = {"fit": "focused", "warp": warp, "splits": 4, "selection": selection, **WARPS[warp]}
    rng = np.random.default_rng(2)
    for eye in EYES.values():
        views = compose(settings)(LIGHTS["slanted"], SCENE, SCENE, TEXELS, eye)
        points = rng.uniform(SCENE.low, SCENE.high, (4000, 3))
        planes = frustum_planes(eye.ws_to_ss, eye.near, eye.far)
        points = points[(points @ planes[:, :3].T + planes[:, 3] > 0.0).all(axis=1)]
        depth = (points - eye.eye_ws) @ eye.forward_ws
        ends = [view.choice.far for view in views]  # type: ignore[attr-defined]
        assert ends == sorted(ends) and ends[-1] == np.inf and len(points) > 20
        layer = np.searchsorted(ends, depth, side="right")
        for index, view in enumerate(views):
            mapped = project(view, points[layer == index])
            assert (mapped[:, 3] > 0.0).all() and (np.abs(mapped[:, :2]) <= 1.0).all()

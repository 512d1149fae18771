"""Jittered light views: where they move what they see, that they still hold it, under every projection."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small

from algorithms.projections.composition import compose
from wkernels.frame.session import Session
from wkernels.projections.jitter import Jitter, frame_jitter, jittered_view
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight, PointLight
from wkernels.scene.views import HostView

TEXELS = 64
LIGHTS = {
    "directional": DirectionalLight(direction=np.array([-2.0, -5.0, -1.0])),
    "point": PointLight(position=np.array([1.0, 12.0, 2.0])),
    "cube": PointLight(position=np.array([0.2, 1.9, 1.5])),
}
PROJECTIONS: dict[str, dict[str, Any]] = {
    "scene": {},
    "focused": {"fit": "focused"},
    "warped": {"fit": "focused", "warp": "lispsm_nopt"},
    "split and warped": {"fit": "focused", "warp": "lispsm_nrepar", "splits": 4},
}


def views_of(light: str, projection: str) -> tuple[list[HostView], np.ndarray]:
    """Views of a light, and points of the ground that the eye sees."""
    session = Session(Geometry(small.box_on_ground(LIGHTS[light]), "cpu"), width=64, height=48)
    views = compose(PROJECTIONS[projection]) if PROJECTIONS[projection] else None
    receivers, casters = (session.geometry.bounds(**{kind: True}) for kind in ("receivers", "casters"))
    sample = session.light.centre
    if views is None:
        return scene_views(sample, receivers, casters, TEXELS), points_of(session)
    return views(sample, receivers, casters, TEXELS, session.eye()), points_of(session)


def points_of(session: Session) -> np.ndarray:
    gbuffer = session.gbuffer()
    return gbuffer.position_ws.numpy()[gbuffer.mesh.numpy() == 0].astype(float)


def texels(view: HostView, points: np.ndarray) -> np.ndarray:
    """Map positions (n, 2), texels from the middle, y up; NaN behind the light."""
    h = points @ view.ws_to_ss[:, :3].T + view.ws_to_ss[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(h[:, 3:] > 0.0, 0.5 * TEXELS * h[:, :2] / h[:, 3:], np.nan)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_a_jitter_is_a_shift_and_a_turn_in_the_map(light: str, projection: str) -> None:
    views, points = views_of(light, projection)
    jitter = Jitter(0.4, -0.3, 0.5)
    cosine, sine = np.cos(0.5), np.sin(0.5)
    turn = np.array([[cosine, -sine], [sine, cosine]]) / (cosine + sine)
    for view in views:
        before, after = texels(view, points), texels(jittered_view(view, jitter), points)
        near = np.abs(before).max(axis=1) < TEXELS  # float64 loses the far ones of a cube's faces
        np.testing.assert_allclose(after[near], before[near] @ turn.T + [0.4, -0.3], atol=1e-9)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_jittered_views_hold_what_they_held(light: str, projection: str) -> None:
    views, points = views_of(light, projection)
    assert len(views) == 6 or (light, projection) != ("cube", "scene")
    for corner in np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]):
        for angle in (0.0, 0.3, -0.7):
            jittered = [jittered_view(view, Jitter(*corner, angle)) for view in views]
            inside = [np.abs(texels(view, points)).max(axis=1) <= 0.5 * TEXELS for view in jittered]
            assert np.any(inside, axis=0).all()


def test_axes_turn_with_the_map() -> None:
    """A step along ``right_ws`` moves right in the map, one along ``up_ws`` up."""
    view = jittered_view(views_of("directional", "scene")[0][0], Jitter(0.0, 0.0, 0.6))
    right, up = texels(view, np.stack([view.right_ws, view.up_ws])) - texels(view, np.zeros((1, 3)))
    assert abs(right[1]) < 1e-9 < right[0] and abs(up[0]) < 1e-9 < up[1]


def test_what_a_view_knows_is_kept() -> None:
    views, _ = views_of("directional", "split and warped")
    for view in views:
        jittered = jittered_view(view, Jitter(0.2, 0.1, 0.0))
        assert jittered.choice == view.choice and jittered.choice is not None  # type: ignore[attr-defined]
        assert (jittered.near, jittered.far, jittered.width) == (view.near, view.far, view.width)
        np.testing.assert_array_equal(jittered.ws_to_ss[2:], view.ws_to_ss[2:])


def test_shifts_fill_the_texel_evenly() -> None:
    shifts = np.array([frame_jitter("r2", i, 1.0, 0.0)[:2] for i in range(256)])
    assert np.abs(shifts).max() < 0.5
    counts, _, _ = np.histogram2d(*shifts.T, bins=4, range=[[-0.5, 0.5]] * 2)
    assert counts.std() < 2.5  # 16 each; random points have 4
    assert frame_jitter("r2", 0, 1.0, 1.0) == Jitter(0.0, 0.0, 0.0)
    turned = np.array([frame_jitter("halton", i, 0.5, np.pi / 2) for i in range(64)])
    assert np.abs(turned[:, :2]).max() <= 0.25 and 0.7 < np.abs(turned[:, 2]).max() <= np.pi / 4


def test_a_map_is_drawn_anew_only_where_its_jitter_changes(device: str) -> None:
    session = Session(Geometry(small.box_on_ground(LIGHTS["directional"]), device), width=8, height=8, device=device)
    first = session.light_map(TEXELS, jitter=Jitter(0.1, 0.2, 0.0)).map
    depth = first.depth.numpy().copy()
    assert session.light_map(TEXELS, jitter=Jitter(0.1, 0.2, 0.0)).map is first
    moved = session.light_map(TEXELS, jitter=Jitter(0.45, 0.2, 0.0)).map
    assert moved is not first and not np.array_equal(moved.depth.numpy(), depth)
    assert not np.array_equal(
        moved.ws_to_ls.numpy()[0, 0], session.light_map(TEXELS, slot="b").map.ws_to_ls.numpy()[0, 0]
    )

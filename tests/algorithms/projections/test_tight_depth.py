"""Key ``depth: tight``: a near plane at what is seen, casters before it clamped onto it (Brabec et al. 2002)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes
from projection_cases import LIGHTS, SUN, WARPS, bounds, posts

from algorithms.plugins import load_all
from algorithms.projections.composition import compose
from wkernels.frame.session import Session
from wkernels.light_maps.map_look import views_stamp
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import PointLight
from wkernels.scene.model import Camera, Scene
from wkernels.scene.views import ProjectiveView, eye_view

LAMPS = {"sun": SUN, "point": PointLight(position=np.array([-60.0, 90.0, -120.0]))}
EYE = np.array([0.0, 3.0, -76.0])
CAMERA = Camera(EYE, EYE + np.array([0.0, -0.35, 1.0]), np.array([0.0, 1.0, 0.0]), 60.0, 0.5, 15.0)
EYE_VIEW = eye_view(CAMERA, 160, 120, np.zeros(3))


def roofed(lamp: str) -> Scene:
    """The posts under a slab that casts from far before all that is seen."""
    height, towards = 60.0, np.array([-0.6, 1.0, -0.3])
    if lamp == "point":
        towards = LAMPS["point"].position - (0.0, 0.0, -70.0)  # type: ignore[attr-defined]
    x, _, z = np.array([0.0, 0.0, -70.0]) + height * towards / towards[1]
    slab = small_scenes.mesh("slab", small_scenes.box((float(x), height, float(z)), (3.0, 0.5, 3.0)), receives=False)
    return small_scenes.scene([*posts(), slab], LAMPS[lamp], CAMERA)


def render(scene: Scene, device: str, settings: dict[str, Any], name: str = "shadow_map") -> tuple[np.ndarray, Session]:
    projection = compose({"fit": "focused", **settings})
    frame = Session(Geometry(scene, device), width=160, height=120, device=device, projection=projection)
    technique = load_all()[name]
    return frame.render(technique(technique.Params(resolution=256))).visibility, frame


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("partition", [{}, {"splits": 4}, {"splits": 4, "selection": "best"}, {"partition": "faces"}])
@pytest.mark.parametrize("warp", WARPS)
def test_clamped_casters_still_cast(warp: str, partition: dict[str, Any], lamp: str, device: str) -> None:
    """The same bits as with the whole scene's depth, warped or not: depth is linear and no warp touches it."""
    settings = {"warp": warp, **WARPS[warp], **partition}
    scene = roofed(lamp)
    plain, _ = render(scene, device, settings)
    tight, frame = render(scene, device, {**settings, "depth": "tight"})
    np.testing.assert_array_equal(plain, tight)
    light_map = frame.light_map(256).map
    clamps = [view.clamped_before for view in frame.shown.views]  # type: ignore[index, union-attr]
    for layer, clamp in enumerate(clamps):
        assert clamp > 0.0 and light_map.depth.numpy()[layer].min() >= np.float32(clamp)
    assert np.isclose(light_map.depth.numpy(), clamps[0], rtol=1e-6).any(), "the slab lies on the plane"
    assert light_map.near == pytest.approx(clamps[0])


@pytest.mark.parametrize("lamp", LAMPS)
def test_without_the_clamp_their_shadows_are_lost(lamp: str, device: str) -> None:
    """What the clamp is for: the same near plane that clips leaves the slab out."""
    scene = roofed(lamp)

    def clipped(*args: Any) -> list[Any]:
        views = compose({"fit": "focused", "depth": "tight"})(*args)
        return [replace(view, near=view.clamped_before, clamped_before=0.0) for view in views]  # type: ignore[call-arg]

    frame = Session(Geometry(scene, device), width=160, height=120, device=device, projection=clipped)
    technique = load_all()["shadow_map"]
    lost = frame.render(technique(technique.Params(resolution=256))).visibility
    plain, _ = render(scene, device, {})
    assert np.nanmean(lost - plain) > 0.01 and np.nanmin(lost - plain) == -0.0


def test_a_clamp_is_part_of_what_a_map_depends_on() -> None:
    box = bounds((-1.0, 0.0, -72.0), (1.0, 2.0, -68.0))
    (view,) = compose({"fit": "focused"})(LIGHTS["slanted"], box, box, 64, EYE_VIEW)
    assert isinstance(view, ProjectiveView)
    stamps = [views_stamp([replace(view, clamped_before=c)]) for c in (0.0, 1.0)]
    assert stamps[0] != stamps[1]


def test_nothing_is_clamped_where_no_caster_lies_before() -> None:
    box = bounds((-1.0, 0.0, -72.0), (1.0, 2.0, -68.0))
    (view,) = compose({"fit": "focused", "depth": "tight"})(LIGHTS["slanted"], box, box, 64, EYE_VIEW)
    assert isinstance(view, ProjectiveView) and view.clamped_before == 0.0

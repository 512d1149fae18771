"""Maps that no caster lies in the view of, against maps that are drawn all the same."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp

from wkernels.frame.empty_maps import EmptyMaps, light_front, may_see, nothing_hides
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import depths_on_host
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import CASTS, RECEIVES, Bounds, Geometry
from wkernels.scene.model import Scene


def scene_with_box(centre: tuple[float, float, float], kind: str = "point") -> Scene:
    """A bumpy ground, which casts only upon itself by being turned away, and a box somewhere."""
    return small_scenes.scene(
        [
            small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False),
            small_scenes.mesh("box", small_scenes.box(centre, (1.0, 1.0, 1.0))),
        ],
        small_scenes.light(kind, (2.0, 8.0, 1.0)),
    )


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_what_may_not_be_seen_is_not_drawn(kind: str, device: str) -> None:
    """Over many places of a box: where ``may_see`` says no, drawing finds nothing, and it says so often enough."""
    rng = np.random.default_rng(5)
    unseen = drawn = 0
    for _ in range(60):
        scene = scene_with_box(tuple(rng.uniform((-8.0, -1.0, -8.0), (8.0, 10.0, 8.0))), kind)
        ground = scene.meshes[0]
        session = Session(Geometry(scene, device), width=8, height=8, device=device, skips=False)
        # the box receives too, but the views are those of the ground alone
        receivers = Bounds()
        receivers.add(ground.vertices - session.geometry.origin_ws)
        casters = session.geometry.bounds(casters=True)
        views = scene_views(session.light.centre, receivers, casters, 32)
        session.projection = lambda *_, views=views: views
        depth = depths_on_host(session.light_map(32).map)
        if not may_see(views, casters):
            unseen += 1
            assert np.isinf(depth).all()
        drawn += np.isfinite(depth).any()
    assert unseen >= 10 and drawn >= 10


def test_boxes_across_a_border_may_be_seen(device: str) -> None:
    views = scene_views(
        np.array([0.0, 1.0, 0.0, 0.0]), _box((-1, 0, -1), (1, 0.1, 1)), _box((-1, 0, -1), (1, 1, 1)), 16
    )
    assert may_see(views, _box((0.5, 0.5, 0.5), (3.0, 0.6, 3.0)))
    assert may_see(views, _box((-9.0, 0.2, -9.0), (9.0, 0.4, 9.0))), "no corner lies within the view"
    assert not may_see(views, _box((5.0, 0.5, 5.0), (6.0, 0.6, 6.0)))
    both = _box((5.0, 0.5, 5.0), (6.0, 0.6, 6.0))
    both.add(np.array([[-6.0, 0.5, -6.0], [-5.0, 0.6, -5.0]]))
    assert not may_see(views, both), "the box round both would be in view"
    assert not may_see(views, Bounds()), "nothing at all"


def _box(low: tuple[float, ...], high: tuple[float, ...]) -> Bounds:
    out = Bounds()
    out.add(np.array([low, high], float))
    return out


def test_light_front_against_numpy(device: str) -> None:
    scene = small_scenes.cluttered(small_scenes.light("point", (3.0, 4.0, -5.0)))
    session = Session(Geometry(scene, device), width=40, height=30, device=device)
    gbuffer = session.gbuffer()
    out = wp.empty(gbuffer.depth.shape, dtype=float, device=device)
    session.launch(light_front, out.shape, [gbuffer, wp.vec4(*session.light.centre)], [out])
    way = session.light.centre[:3] - gbuffer.position_ws.numpy()
    facing = np.einsum("hwi,hwi->hw", gbuffer.normal_ws.numpy(), way)
    both = RECEIVES | CASTS
    expected = np.where(((gbuffer.flags.numpy() & both) == both) & (facing <= 0.0), 0.0, 1.0)
    clear = np.abs(facing) > 1e-4  # elsewhere rounding decides
    np.testing.assert_array_equal(out.numpy()[clear], expected[clear])
    assert 0.05 < 1.0 - expected.mean() < 0.5


def test_an_empty_map_is_neither_drawn_nor_compared_with(device: str) -> None:
    scene = scene_with_box((0.0, 30.0, 0.0))
    scene = small_scenes.scene(
        [
            scene.meshes[0],
            small_scenes.mesh("box", small_scenes.box((0.0, 30.0, 0.0), (1.0, 1.0, 1.0)), receives=False),
        ],
        scene.lights[0],
    )
    for anyway in ((), (EmptyMaps.UNCOMPARED.pair,), (EmptyMaps.UNDRAWN.pair,)):
        session = Session(Geometry(scene, device), width=16, height=12, device=device, done_anyway=anyway)
        gbuffer, visibility = session.gbuffer(), session.visibility_buffer(session.gbuffer())
        light_map = session.light_map(16)
        assert light_map.empty == (anyway != (EmptyMaps.UNDRAWN.pair,))
        assert np.isinf(depths_on_host(light_map.map)).all()
        assert nothing_hides(session, gbuffer, light_map, visibility) == (not anyway)
        assert ((EmptyMaps.UNDRAWN.pair in session.left_out), (EmptyMaps.UNCOMPARED.pair in session.left_out)) == (
            anyway != (EmptyMaps.UNDRAWN.pair,),
            not anyway,
        )
    near = Session(Geometry(scene_with_box((0.0, 2.0, 0.0)), device), width=16, height=12, device=device)
    light_map = near.light_map(16)
    assert not light_map.empty and np.isfinite(depths_on_host(light_map.map)).any()


def test_a_caster_that_comes_into_view_is_drawn(device: str) -> None:
    def pose(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[1, 3] = -28.0 * (frame == 1)
        return out

    box = small_scenes.mesh("box", small_scenes.box((0.0, 30.0, 0.0), (1.0, 1.0, 1.0)), receives=False, moving=True)
    box = type(box)(**{**vars(box), "object_to_ws": pose})
    ground = small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False)
    scene = small_scenes.scene([ground, box], small_scenes.light("point"))
    session = Session(Geometry(scene, device), width=16, height=12, device=device)
    seen = []
    for frame in (0, 1, 2, 1):
        session.begin(frame)
        light_map = session.light_map(16)
        seen.append((light_map.empty, bool(np.isfinite(depths_on_host(light_map.map)).any())))
        session.advance()
    assert seen == [(True, False), (False, True), (True, False), (False, True)]

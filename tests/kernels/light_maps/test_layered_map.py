"""Layers of depth against every hit of every texel's ray, and against the plain twin; storages, faces, what is lost."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from drawing import SUB, draw, flat_view, from_pixels, pixel_rays, triangle_soup, view_of
from map_cases import INSIDE, MAPS, SUN, session

from algorithms.projections.composition import compose
from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.drawing import Drawing, draw_light_map
from wkernels.light_maps.layered import (
    BACK_FACE,
    FRONT_FACE,
    NO_FACE,
    LayeredMap,
    count_lost,
    draw_layered_map,
    peel_depth,
)
from wkernels.light_maps.light_map import depths_on_host, layout_of
from wkernels.light_maps.storage import PLACES, MapOptions, layers_on_host
from wkernels.raster import CULL_BACK, CULL_FRONT, CULL_NONE, Rasteriser
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import HostView, ProjectiveView


def peel(
    points: np.ndarray,
    faces: np.ndarray,
    view: HostView,
    peels: int,
    device: str,
    rasteriser: Rasteriser,
    cull: int = CULL_NONE,
) -> tuple[np.ndarray, np.ndarray]:
    """Depths and triangles (peels, H, W)."""
    shape = (view.height, view.width)
    depths = [wp.full(shape, -5.0, dtype=float, device=device) for _ in range(peels)]
    owners = [wp.full(shape, -5, dtype=int, device=device) for _ in range(peels)]
    on_device = wp.array(points.astype(np.float32), dtype=wp.vec3, device=device)
    indices = wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device)
    rasteriser.peel(on_device, indices, view.to_device(), depths, owners, cull)
    return np.stack([d.numpy() for d in depths]), np.stack([o.numpy() for o in owners])


def hits_in_order(view: HostView, corners: np.ndarray, dx: float, dy: float) -> tuple[np.ndarray, np.ndarray]:
    """All hits of each pixel's ray within [near, far], nearest first: depth, +inf behind the last, and triangle."""
    t, _ = small.ray_hits(*pixel_rays(view, dx, dy), corners)
    t = np.where((t >= view.near) & (t <= view.far), t, np.inf)
    order = np.argsort(t, axis=1)
    depth = np.take_along_axis(t, order, axis=1)
    return depth, np.where(np.isfinite(depth), order, -1)


@pytest.mark.parametrize("path", ["lanes", "tiles"])
@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("cull", [CULL_NONE, CULL_BACK, CULL_FRONT])
def test_layers_are_the_hits_of_a_ray_in_order(path: str, perspective: bool, cull: int, device: str) -> None:
    """Where rays moved by a little more than the snapping agree on all triangles, so must the rasteriser."""
    points, faces = triangle_soup(np.random.default_rng(3), 300, 8.0)
    points = points.astype(np.float32).astype(float)
    view, corners, peels = view_of(perspective, 72, 50), points[faces], 6
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = np.einsum("ij,ij->i", normal, -corners[:, 0] if perspective else np.tile([0.0, 0.0, 1.0], (300, 1))) > 0
    kept = {CULL_NONE: towards | True, CULL_BACK: towards, CULL_FRONT: ~towards}[cull]
    names, corners = np.flatnonzero(kept), corners[kept]
    depth, owner = hits_in_order(view, corners, 0.0, 0.0)
    with np.errstate(invalid="ignore"):
        sure = ~((np.diff(depth, axis=1) < 1e-4 * depth[:, :-1]).any(axis=1))
    lowest, highest, step = depth.copy(), depth.copy(), 2.0 / SUB
    for dx, dy in ((-step, -step), (step, -step), (-step, step), (step, step)):
        near, same = hits_in_order(view, corners, dx, dy)
        sure &= (same == owner).all(axis=1)
        lowest, highest = np.minimum(lowest, near), np.maximum(highest, near)
    found, triangle = (
        images.reshape(peels, -1).T
        for images in peel(points, faces, view, peels, device, Rasteriser(device, 2, path), cull)  # type: ignore[arg-type]
    )
    assert sure.mean() > 0.5 and (np.isfinite(depth).sum(axis=1)[sure] > peels).any()
    names = np.append(names, -1)
    np.testing.assert_array_equal(triangle[sure], names[owner[sure, :peels]])
    hit = np.isfinite(depth[sure, :peels])
    np.testing.assert_array_equal(np.isfinite(found[sure]), hit)
    slack = 1e-5 * depth[sure, :peels][hit]
    assert (found[sure][hit] >= lowest[sure, :peels][hit] - slack).all()
    assert (found[sure][hit] <= highest[sure, :peels][hit] + slack).all()


def assert_layers(depth: np.ndarray, first: np.ndarray) -> None:
    """The first layer is what is drawn without peeling; depths rise, strictly, until there are no more."""
    np.testing.assert_array_equal(depth[0], first)
    hit = np.isfinite(depth)
    assert (hit[:-1] | ~hit[1:]).all()
    assert (depth[1:][hit[1:]] > depth[:-1][hit[1:]]).all()


@pytest.mark.parametrize("path", ["lanes", "tiles"])
@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("size", [0.5, 4.0, 60.0])
@pytest.mark.parametrize("shape", [(200, 150), (517, 131), (5, 3)])
def test_as_many_layers_as_faces_cover_a_pixel(
    path: str, perspective: bool, size: float, shape: tuple[int, int], device: str
) -> None:
    rng = np.random.default_rng(int(10 * size) + shape[0])
    points, faces = triangle_soup(rng, 60 if size > 10 else 600, size)
    view, rasteriser = view_of(perspective, *shape, far=1e9), Rasteriser(device, 3, path)  # type: ignore[arg-type]
    depth, owner = peel(points, faces, view, 40, device, rasteriser)
    drawn = draw(points, faces, view, device, rasteriser=rasteriser)
    assert_layers(depth, drawn[0])
    np.testing.assert_array_equal(owner[0], drawn[1])
    np.testing.assert_array_equal(owner >= 0, np.isfinite(depth))
    count = wp.zeros(shape[::-1], dtype=int, device=device)
    indices = wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device)
    on_device = wp.array(points.astype(np.float32), dtype=wp.vec3, device=device)
    rasteriser.count(on_device, indices, view.to_device(), None, count, 0, front=1, back=1)
    layers = np.isfinite(depth).sum(axis=0)
    assert layers.max() < 40 and (layers.max() > 2 or shape == (5, 3) or size < 1.0)
    assert (layers <= count.numpy()).all()
    assert (layers != count.numpy()).mean() < 2e-4  # equally deep to the last bit, where triangles meet


@pytest.mark.parametrize("case", MAPS)
def test_lanes_peel_what_the_plain_twin_peels(case: str) -> None:
    """Orthographic, perspective and warped views; surfaces equally deep to rounding may change places."""
    light, projection = MAPS[case]
    running = session(light, "cpu", **projection)
    views, geometry = running.light_map(120).views, running.geometry
    points, faces = geometry.points_ws.numpy(), geometry.caster_indices.numpy().reshape(-1, 3)
    for view in views:
        lanes, tiles = (peel(points, faces, view, 5, "cpu", Rasteriser("cpu", 2, path)) for path in ("lanes", "tiles"))  # type: ignore[arg-type]
        same = (np.isfinite(lanes[0]) == np.isfinite(tiles[0])).all(axis=0)
        assert same.mean() > 0.999
        both = np.isfinite(lanes[0]) & same
        np.testing.assert_allclose(lanes[0][both], tiles[0][both], rtol=1e-4)
        assert (lanes[1] != tiles[1]).mean() < 1e-3
    assert np.isfinite(lanes[0][3]).any() or case == "six faces"


def test_surfaces_at_one_depth_are_one_layer(device: str) -> None:
    square = np.array([(2, 2), (12, 2), (12, 12), (2, 12)], float)
    points = np.concatenate([from_pixels(square[:, 0], square[:, 1], depth) for depth in (3.0, 3.0, 7.0)])
    faces = (np.array([(0, 1, 2), (0, 2, 3)]) + 4 * np.arange(3)[:, None, None]).reshape(-1, 3)
    depth, owner = peel(points, faces, flat_view(16, 16), 3, device, Rasteriser(device))
    assert set(np.unique(owner[0])) == {-1, 0, 1} and set(np.unique(owner[1])) == {-1, 4, 5}
    np.testing.assert_array_equal(depth[:2, 5, 5], (3.0, 7.0))
    assert np.isposinf(depth[2]).all() and (owner[2] == -1).all()


# ---- layered light maps ---------------------------------------------------------------------------------------------


def drawing_of(running: Session, storage: str = "separate", cull: int = CULL_NONE) -> Drawing:
    options = MapOptions(storage=storage)
    return Drawing(geometry=running.geometry, rasteriser=running.rasteriser, cull=cull, options=options)


def roofed(device: str) -> Session:
    """Casters far before what the eye sees, moved up to the near plane of tight views."""
    roofs = [small.mesh(f"roof {y}", small.box((0.0, y, 0.0), (3.0, 0.5, 3.0)), receives=False) for y in (60.0, 40.0)]
    scene = small.scene([small.mesh("ground", small.plane(14.0)), *roofs], SUN)
    tight = compose({"fit": "focused", "splits": 2, "scheme": "log", "depth": "tight"})
    return Session(Geometry(scene, device), width=60, height=40, device=device, projection=tight)


def on_host(layered: LayeredMap) -> np.ndarray:
    """Depths (peels, layers, R, R)."""
    layout = layout_of(layered.map)
    return np.stack([layers_on_host(layered.depth[i], layout) for i in range(layered.peels)])


@pytest.mark.parametrize("storage", PLACES)
@pytest.mark.parametrize("case", [*MAPS, "clamped"])
def test_layered_maps_in_every_storage(case: str, storage: str, device: str) -> None:
    running = roofed(device) if case == "clamped" else session(MAPS[case][0], device, **MAPS[case][1])
    look = running.light_map(40)
    drawing = drawing_of(running, storage)
    layered = draw_layered_map(drawing, look.views, look.light_ws, 4)
    assert layered.depth.shape[1] % 1024 == 0 and layered.depth.shape[1] >= layout_of(layered.map).texels
    depths = on_host(layered)
    single, _ = draw_light_map(drawing, look.views, look.light_ws)
    np.testing.assert_array_equal(depths[0], depths_on_host(single))
    np.testing.assert_array_equal(depths_on_host(layered.map), depths[0])
    if case == "clamped":
        before = [view.clamped_before for view in look.views if isinstance(view, ProjectiveView)]
        assert len(before) == len(look.views) and min(before) > 0.0
        assert (depths >= np.array(before, np.float32)[:, None, None]).all() and (depths[1] == depths[0])[
            np.isfinite(depths[0])
        ].any()
    else:
        assert_layers(depths, depths_on_host(look.map))
    apart = draw_layered_map(drawing_of(running), look.views, look.light_ws, 4)
    np.testing.assert_array_equal(on_host(apart), depths)
    again = draw_layered_map(drawing, look.views, look.light_ws, 4, old=layered)
    assert again.depth.ptr == layered.depth.ptr
    np.testing.assert_array_equal(on_host(again), depths)


@wp.kernel
def ask_peels(first: int, layered: LayeredMap, layer: int, margin: int, depth_out: wp.array3d(dtype=float)):
    row, x, p = wp.tid()
    y = first + row
    depth_out[y, x, p] = peel_depth(layered, p, layer, x - margin, y - margin)


def test_kernels_read_peels_as_they_lie(device: str) -> None:
    running = session(INSIDE, device)
    look = running.light_map(20)
    layered = draw_layered_map(drawing_of(running, "atlas9"), look.views, look.light_ws, 3)
    for layer in range(6):
        out = wp.zeros((24, 24, 3), dtype=float, device=device)
        launch(ask_peels, (24, 24, 3), [layered, layer, 2], [out], device=device)
        expected = np.pad(on_host(layered)[:, layer], ((0, 0), (2, 2), (2, 2)), constant_values=np.inf)
        np.testing.assert_array_equal(np.moveaxis(out.numpy(), 2, 0), expected)


@pytest.mark.parametrize("light", [SUN, small.light("point")], ids=["sun", "lamp"])
def test_faces_of_closed_casters_take_turns(light: object, device: str) -> None:
    """Rays enter and leave: fronts at even places, backs at odd ones, but where the snapped outline is grazed."""
    scene = small.scene([small.mesh("boxes", small.random_boxes(1, 7)), small.mesh("ball", small.sphere((2, 5, 1), 0.7))],
                        light)  # fmt: skip
    running = Session(Geometry(scene, device), width=8, height=8, device=device)
    look = running.light_map(90)
    for cull, even, odd in ((CULL_NONE, FRONT_FACE, BACK_FACE), (CULL_BACK, FRONT_FACE, FRONT_FACE)):
        layered = draw_layered_map(drawing_of(running, "separate", cull), look.views, look.light_ws, 4, faces=True)
        layout = layout_of(layered.map)
        face = np.stack([layers_on_host(layered.face[i], layout) for i in range(4)])
        np.testing.assert_array_equal(face == int(NO_FACE), np.isposinf(on_host(layered)))
        assert (face[0] != int(NO_FACE)).mean() > 0.02
        for i in range(4):
            hit = face[i] != int(NO_FACE)
            assert not hit.any() or (face[i][hit] == int(odd if i % 2 else even)).mean() > 0.97
    assert draw_layered_map(drawing_of(running), look.views, look.light_ws, 2).face.shape == (1, 1)


@pytest.mark.parametrize("case", MAPS)
@pytest.mark.parametrize("cull", [CULL_NONE, CULL_BACK])
def test_lost_layers_are_counted(case: str, cull: int, device: str) -> None:
    light, projection = MAPS[case]
    running = session(light, device, **projection)
    look = running.light_map(40)
    drawing = drawing_of(running, cull=cull)
    layers = np.isfinite(on_host(draw_layered_map(drawing, look.views, look.light_ws, 16))).sum(axis=0)
    for peels in (1, 2, 3, 16):
        lost = count_lost(drawing, look.views, peels)
        assert lost.most == layers.max()
        beyond = np.maximum(layers - peels, 0)
        # surfaces that meet at a texel's centre are one layer and two that cover it
        assert 0 <= lost.texels - (beyond > 0).sum() <= 2e-4 * layers.size
        assert 0 <= lost.surfaces - beyond.sum() <= 4e-4 * layers.size
    assert count_lost(drawing, look.views, 1).surfaces > 20 and lost.texels == lost.surfaces == 0


def test_a_frame_gives_a_layered_map_and_keeps_it_while_nothing_moves() -> None:
    running = session(INSIDE, "cpu")
    plain = depths_on_host(running.light_map(32).map)
    layered = running.layered_map(32, 3, faces=True)
    np.testing.assert_array_equal(depths_on_host(layered.map), plain)
    assert layered.peels == 3 and len(np.unique(layered.face.numpy())) > 1
    assert running.layered_map(32, 3, faces=True) is layered and running.layered_map(32, 2) is not layered
    assert running.shown is not None and running.shown.from_centre

"""Many views drawn at once, and blocks of triangles left out of views that they lie beside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from drawing import cube_faces, on_device, sun_samples

import wkernels.raster as raster
from algorithms.projections.composition import compose
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import depths_on_host
from wkernels.light_maps.storage import DRAWINGS
from wkernels.projections.focusing import fitted_view, light_space
from wkernels.raster import CULL_BACK, CULL_NONE, Rasteriser, TriangleBlocks
from wkernels.raster.blocks import MAX_VIEWS
from wkernels.raster.lane_culling import MESH_LANES
from wkernels.raster.lane_lists import CLIP_RUNS
from wkernels.raster.plain_splits import draw_splits_plainly
from wkernels.raster.scratch import Scratch
from wkernels.scene.geometry import Bounds, Geometry
from wkernels.scene.views import HostView

PATHS = ["lanes", "tiles"]
LIGHTS = {"sun": np.array([0.3, 0.8, 0.2, 0.0]), "lamp": np.array([2.0, 90.0, 1.0, 1.0])}


def soup(boxes: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Boxes over a ground, in an order in which neighbours lie together."""
    points, faces = small.random_boxes(boxes, seed=seed)
    faces = faces[np.lexsort((faces[:, 0], points[faces[:, 0] // 8 * 8, 0]))]  # eight corners each, from left to right
    ground, ground_faces = small.plane(60.0)
    return np.concatenate([points, ground]), np.concatenate([faces, ground_faces + len(points)])


def narrow_views(light: str, warped: bool, count: int = 5, side: int = 40) -> list[HostView]:
    """Views of parts of the scene, most triangles beside them, large ones beyond the guard band."""
    light_ws = LIGHTS[light] / (np.linalg.norm(LIGHTS[light]) if light == "sun" else 1.0)
    scene = Bounds()
    scene.add(np.array([(-30.0, -4.0, -30.0), (30.0, 4.0, 30.0)]))
    eye = Session(Geometry(small.cluttered(small.light("directional"))), width=8, height=8).eye()
    space = light_space(light_ws, scene.corners, scene, eye)
    assert space is not None
    rng = np.random.default_rng(count)
    out: list[HostView] = []
    for i in range(count):
        middle, half = rng.uniform(-3.0, 3.0, 3), 2.0 ** (i - 3)
        out.append(
            fitted_view(space, middle + half * small.box((0, 0, 0), (1, 1, 1))[0], side, 1.0 if warped else np.inf)
        )
    return out


VIEWS: dict[str, list[HostView]] = {
    "cube faces": cube_faces(45),
    "one": sun_samples(7, 33)[:1],
    "sun samples": sun_samples(40, 24),  # more than a mask has bits
    "narrow": narrow_views("sun", False),
    "narrow, warped": narrow_views("sun", True),
    "narrow, lamp": narrow_views("lamp", False),
    "narrow, lamp, warped": narrow_views("lamp", True),
}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("views", VIEWS)
@pytest.mark.parametrize("drawing", DRAWINGS)
def test_any_way_of_drawing_makes_the_same_bits(
    drawing: str, views: str, path: Any, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raster, "WORTH_LEAVING_OUT", 0.0)
    points, faces = soup(150)
    points_ws, indices = on_device(points, faces, device)
    device_views = [view.to_device() for view in VIEWS[views]]
    shape = (len(device_views), device_views[0].height, device_views[0].width)
    blocks = TriangleBlocks(points_ws, indices, device, threads=3)
    single, many = Rasteriser(device, 1, path), Rasteriser(device, 3, path)
    for cull in (CULL_NONE, CULL_BACK):
        made = []
        for rasteriser, options in (
            (single, {}),
            (many, {"blocks": blocks, "drawing": drawing}),
            (many, {"blocks": blocks, "drawing": drawing, "everything": True}),
        ):
            images = [wp.full(shape, value=-7, dtype=kind, device=device) for kind in (float, int)]
            order: list[int] = []
            left_out = rasteriser.draw_many(
                points_ws, indices, device_views, *images, cull, drawn=order.append, **options
            )
            made.append((*(image.numpy() for image in images), left_out))
            assert order == list(range(len(device_views)))
        for depth, owner, _ in made[1:]:
            np.testing.assert_array_equal(depth, made[0][0])
            np.testing.assert_array_equal(owner, made[0][1])
        assert made[0][2] == made[2][2] == 0 and np.isfinite(made[0][0]).any()
        assert made[1][2] > 0 or not views.startswith("narrow")


def test_more_clipped_triangles_than_there_is_room_for(device: str) -> None:
    """Many large triangles in a narrow view: all of them leave its guard band."""
    rng = np.random.default_rng(1)
    count = int(CLIP_RUNS) * int(MESH_LANES) // 8 + 300
    points = rng.uniform(-1.0, 1.0, (3 * count, 3)) * (4000.0, 3.0, 4000.0)
    points_ws, indices = on_device(points, np.arange(3 * count), device)
    views = [view.to_device() for view in narrow_views("sun", False, side=200)]
    blocks = TriangleBlocks(points_ws, indices, device)
    made = []
    for drawing in (None, *DRAWINGS):
        image = wp.zeros((len(views), 200, 200), dtype=float, device=device)
        options: dict[str, Any] = {"blocks": blocks, "drawing": drawing} if drawing else {}
        Rasteriser(device).draw_many(points_ws, indices, views, image, **options)
        made.append(image.numpy())
    for found in made[1:]:
        np.testing.assert_array_equal(found, made[0])
    assert np.isfinite(made[0]).all(axis=(1, 2)).any()


# ---- blocks ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("views", ["narrow", "narrow, lamp, warped", "cube faces"])
@pytest.mark.parametrize("ranges", [False, True])
def test_masks_agree_with_numpy(views: str, ranges: bool, device: str) -> None:
    points, faces = soup(200)
    points_ws, indices = on_device(points, faces, device)
    blocks = TriangleBlocks(points_ws, indices, device, threads=2)
    seen = blocks.seen_by([view.to_device() for view in VIEWS[views]], ranges=ranges)
    lanes, count = int(MESH_LANES), len(VIEWS[views])
    expected = np.zeros((blocks.blocks, count), dtype=bool)
    for i, view in enumerate(VIEWS[views]):
        rows = view.ws_to_ss
        sides = np.stack([rows[3] + rows[0], rows[3] - rows[0], rows[3] + rows[1], rows[3] - rows[1]])
        for b in range(blocks.blocks):
            corners = points[faces[lanes * b : lanes * (b + 1)]].reshape(-1, 3)
            low, high = corners.min(axis=0), corners.max(axis=0)
            box = small.box(tuple(0.5 * (low + high)), tuple(high - low))[0]
            distance = box @ sides[:, :3].T + sides[:, 3]
            expected[b, i] = not (distance.max(axis=0) < -1e-3 * np.abs(distance).max()).any()
    if ranges:
        expected = np.maximum.accumulate(expected, axis=1) & np.maximum.accumulate(expected[:, ::-1], axis=1)[:, ::-1]
    bits = (seen.block.numpy()[:, None] >> np.arange(count)) & 1
    # a box that only just lies beside a view may be kept, and none may be lost
    assert ((bits == 1) >= expected).all() or not ranges
    assert (bits == expected).mean() > 0.97
    assert seen.pairs == bits.size and seen.beside == bits.size - bits.sum() and 0 < bits.sum()
    runs = (seen.run.numpy()[:, None] >> np.arange(count)) & 1
    for run in range(blocks.runs):
        uses = np.unique(np.flatnonzero((faces // lanes == run).any(axis=1)) // lanes)
        np.testing.assert_array_equal(runs[run], bits[uses].max(axis=0, initial=0))


def test_passes_take_all_blocks_where_few_could_be_left_out(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    points_ws, indices = on_device(*soup(150), device)
    views = [view.to_device() for view in VIEWS["narrow"]]
    blocks = TriangleBlocks(points_ws, indices, device)
    seen = blocks.seen_by(views)
    share = seen.beside / seen.pairs
    assert 0.0 < share < 1.0
    made = []
    for least, left_out in ((0.9 * share, seen.beside), (1.1 * share, 0)):
        monkeypatch.setattr(raster, "WORTH_LEAVING_OUT", least)
        image = wp.zeros((len(views), 40, 40), dtype=float, device=device)
        assert Rasteriser(device).draw_many(points_ws, indices, views, image, blocks=blocks) == left_out
        made.append(image.numpy())
    np.testing.assert_array_equal(made[0], made[1])


@pytest.mark.parametrize("drawing", DRAWINGS)
@pytest.mark.parametrize("views", VIEWS)
def test_the_stripes_of_cuda_draw_many_views_too(views: str, drawing: str) -> None:
    """On one thread, where atomics are none; against the tiles, which take the same depths."""
    points, faces = soup(150)
    points_ws, indices = on_device(points, faces, "cpu")
    device_views = [view.to_device() for view in VIEWS[views][:MAX_VIEWS]]
    shape = (len(device_views), device_views[0].height, device_views[0].width)
    blocks = TriangleBlocks(points_ws, indices)
    made = []
    for stripes in (False, True):
        images = [wp.full(shape, value=-7, dtype=kind, device="cpu") for kind in (float, int)]
        seen = blocks.seen_by(device_views, ranges=drawing != "passes")
        draw_splits_plainly(
            Scratch("cpu", 1),
            points_ws,
            indices,
            device_views,
            seen,
            drawing,
            int(CULL_NONE),
            lambda i, images=images: (images[0][i], images[1][i]),
            lambda i: None,
            stripes=stripes,
        )
        made.append([image.numpy() for image in images])
    np.testing.assert_array_equal(made[1][0], made[0][0])
    np.testing.assert_array_equal(made[1][1], made[0][1])


def test_blocks_follow_what_moves_and_keep_what_is_not_finite(device: str) -> None:
    points, faces = soup(100)
    points_ws, indices = on_device(points, faces, device)
    view = [narrow_views("sun", False)[0].to_device()]
    blocks = TriangleBlocks(points_ws, indices, device)
    before = blocks.seen_by(view).block.numpy().copy()
    lanes = int(MESH_LANES)
    hidden = int(np.flatnonzero(before == 0)[0])
    moved = points.copy()
    moved[faces[hidden * lanes]] = 0.0
    moved[faces[hidden * lanes, 0]] = np.nan
    wp.copy(points_ws, wp.array(moved.astype(np.float32), dtype=wp.vec3, device=device))
    np.testing.assert_array_equal(blocks.seen_by(view).block.numpy(), before)
    blocks.update([(hidden * lanes + 3, hidden * lanes + 5)])
    after = blocks.seen_by(view).block.numpy()
    assert after[hidden] == 1
    np.testing.assert_array_equal(np.delete(after, hidden), np.delete(before, hidden))


# ---- light maps -----------------------------------------------------------------------------------------------------


def session(device: str, skips: bool = True, **projection: Any) -> Session:
    boxes = small.mesh("boxes", small.random_boxes(40, 2), moving=True)
    ground = small.mesh("ground", small.plane(14.0))
    still = small.mesh("still", small.random_boxes(60, 9))
    geometry = Geometry(small.scene([ground, boxes, still], small.light("directional")), device)
    return Session(geometry, width=64, height=48, device=device, projection=compose(projection), skips=skips)


@pytest.mark.parametrize("drawing", DRAWINGS)
@pytest.mark.parametrize("storage", ["separate", "atlas9"])
@pytest.mark.parametrize("tagged", [False, True])
def test_maps_do_not_depend_on_how_they_are_drawn(tagged: bool, storage: str, drawing: str, device: str) -> None:
    split = {"fit": "focused", "splits": 8, "scheme": "log", "warp": "lispsm_nopt", "storage": storage}
    plain = session(device, skips=False, **split)
    for skips in (True, False):
        running = session(device, skips=skips, drawing=drawing, **split)
        for frame in (0, 1, 2):
            plain.begin(frame)
            running.begin(frame)
            expected = depths_on_host(plain.light_map(64, tag_moving_casters=tagged).map)
            found = depths_on_host(running.light_map(64, tag_moving_casters=tagged).map)
            np.testing.assert_array_equal(found, expected)
        assert not tagged or (found < 0.0).any()
        beside = [n for (what, _), n in running.left_out.items() if what == "blocks of casters in light views"]
        assert bool(beside) == skips

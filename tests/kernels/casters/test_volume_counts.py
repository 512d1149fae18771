"""Counting triangles that reach to infinity: against homogeneous coordinates in float64, and against rays to the light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes
import warp as wp
from caster_meshes import apart, fan, silhouettes, torus
from drawing import draw, view_of

from wkernels.casters.extrusion import Volumes, sweep_volumes
from wkernels.casters.pulls import pull_silhouettes, pull_volumes
from wkernels.raster import COUNT_ALL, COUNT_FARTHER, COUNT_NEARER, Rasteriser
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import HostView, eye_view
from wkernels.workspace.workspace import Workspace

EDGE = 1.0 / 64.0  # pixels: vertices snap by 1/512, and float32 places one by as much at the guard band


def count(
    points: np.ndarray | wp.array,
    faces: np.ndarray | wp.array,
    view: HostView,
    rasteriser: Rasteriser,
    seen: np.ndarray | None = None,
    test: int = COUNT_ALL,
    front: int = 1,
    back: int = 1,
    slack: float = 0.0,
) -> np.ndarray:
    device = rasteriser.device
    if isinstance(points, np.ndarray):
        points = wp.array(points.astype(np.float32), dtype=wp.vec4, device=device)
    if isinstance(faces, np.ndarray):
        faces = wp.array(faces.astype(np.int32).ravel(), dtype=int, device=device)
    out = wp.full((view.height, view.width), value=12345, dtype=int, device=device)
    depth = None if seen is None else wp.array(seen.astype(np.float32), dtype=float, device=device)
    rasteriser.count(points, faces, view.to_device(), depth, out, test, front, back, slack)
    return np.array(out.numpy())


def rasterisers(device: str) -> list[Rasteriser]:
    return [Rasteriser(device, 2, path) for path in ("lanes", "tiles")] if device == "cpu" else [Rasteriser(device)]


def twin(points: np.ndarray, faces: np.ndarray, view: HostView, seen: np.ndarray) -> tuple[np.ndarray, ...]:
    """Front and back faces before ``seen``, and behind it, per pixel (4, H, W), and where rounding may decide (H, W).

    A pixel's ray meets a triangle where weights of one sign bring x - px w and y - py w to 0 (Olano and Greer 1997).
    """
    rows = view.ws_to_ss.astype(np.float32).astype(float)
    points = np.column_stack([points[:, :3], np.maximum(points[:, 3], 1e-20)])
    clip = points.astype(np.float32).astype(float) @ rows.T
    x, y = 0.5 * (clip[:, 0] + clip[:, 3]) * view.width, 0.5 * (clip[:, 3] - clip[:, 1]) * view.height
    columns, lines = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    out, unsure = np.zeros((4, view.height, view.width), int), np.zeros(seen.shape, bool)
    for face in faces:
        own, w, depth = points[face, 3], clip[face, 3], clip[face, 2]
        states = []
        for dx, dy in ((0, 0), (-EDGE, -EDGE), (EDGE, -EDGE), (-EDGE, EDGE), (EDGE, EDGE)):
            px, py = columns + dx, lines + dy
            at = x[face] - px[..., None] * w, y[face] - py[..., None] * w
            weights = np.cross(*at)
            front, back = (weights < 0).all(axis=-1), (weights > 0).all(axis=-1)
            weights = np.abs(weights)
            total, own_total = weights @ depth, weights @ own
            covered = (front | back) & (total - view.near * own_total >= 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                nearer = total / own_total < seen
            states.append(np.where(covered, 1 + 2 * front + nearer, 0))
        unsure |= (np.array(states) != states[0]).any(axis=0)
        for kind, state in enumerate((4, 2, 3, 1)):  # front nearer, back nearer, front farther, back farther
            out[kind] += states[0] == state
    return (*out, unsure)


def directions(rng: np.random.Generator, points: np.ndarray, share: float) -> np.ndarray:
    """Homogeneous points, some of them directions."""
    infinite = rng.random(len(points)) < share
    out = np.column_stack([points, ~infinite])
    out[infinite, :3] = rng.normal(size=(infinite.sum(), 3))
    return out


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("shape", [(60, 40), (37, 21)])
def test_counts_are_those_of_homogeneous_triangles(
    share: float, perspective: bool, shape: tuple[int, int], device: str
) -> None:
    rng = np.random.default_rng(int(10 * share) + shape[0])
    points = directions(rng, rng.uniform((-9, -9, -20), (9, 9, 4), (90, 3)), share)
    faces, view = np.arange(90).reshape(-1, 3), view_of(perspective, *shape)
    seen = rng.uniform(1.0, 40.0, shape[::-1])
    seen[rng.random(seen.shape) < 0.1] = np.inf
    front_near, back_near, front_far, back_far, unsure = twin(points, faces, view, seen)
    assert unsure.mean() < 0.4
    finite = np.isfinite(seen)  # +inf lies behind all that is infinitely far away
    assert (front_near + back_near)[finite].any() == (share < 1.0) and (front_far + back_far)[finite].any()
    assert not (front_far + back_far)[~finite].any()
    for rasteriser in rasterisers(device):
        for test, want in ((COUNT_NEARER, (front_near, back_near)), (COUNT_FARTHER, (front_far, back_far))):
            for weights in ((1, 0), (0, 1), (1, -1), (1, 4096)):
                got = count(points, faces, view, rasteriser, seen, test, *weights)
                np.testing.assert_array_equal(
                    got[~unsure],
                    (weights[0] * want[0] + weights[1] * want[1])[~unsure],
                    f"{rasteriser.path}, {weights}",
                )


def test_finite_points_are_counted_as_three_numbers_are(device: str) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform((-9, -9, -30), (9, 9, 4), (900, 3))
    faces, view = np.arange(900).reshape(-1, 3), view_of(True, 200, 150)
    seen = rng.uniform(1.0, 40.0, (150, 200))
    for rasteriser in rasterisers(device):
        for test in (COUNT_ALL, COUNT_NEARER):
            short = wp.array(points.astype(np.float32), dtype=wp.vec3, device=device)
            want = count(short, faces, view, rasteriser, seen, test)
            np.testing.assert_array_equal(
                count(np.insert(points, 3, 1.0, 1), faces, view, rasteriser, seen, test), want
            )
            assert want.max() > 5


def test_what_is_no_position_is_not_counted(device: str) -> None:
    """Points that are no numbers, nothing at all, or behind infinity; the triangle beside them is."""
    good = [(-1.0, -1.0, -3.0, 1.0), (1.0, -1.0, -3.0, 1.0), (0.0, 1.0, -1.0, 0.0)]
    bad = [
        (np.nan, 0, -2, 1),
        (0, np.inf, -2, 1),
        (0, 0, -2, np.nan),
        (0, 0, 0, 0),
        (0.1, 0.2, 3.0, -1.0),
        (0, 0, -1, -9),
    ]
    points, view = np.array(good + bad), view_of(True, 40, 30)
    for rasteriser in rasterisers(device):
        alone = count(points, np.array([(0, 1, 2)]), view, rasteriser)
        assert alone.any()
        for k in range(3, len(points)):
            np.testing.assert_array_equal(count(points, np.array([(0, 1, k), (k, 1, 2)]), view, rasteriser), 0)
            np.testing.assert_array_equal(count(points, np.array([(0, 1, 2), (k, 1, 0)]), view, rasteriser), alone)


def test_slack_moves_faces_on_what_is_seen_behind_it(device: str) -> None:
    points, faces = small_scenes.plane(20.0, cells=3)
    view = eye_view(small_scenes.camera((0.4, 3.0, 5.0), (0, 0, 0), near=0.1), 45, 33, np.zeros(3))
    depth, _ = draw(points, faces, view, device)
    hit = np.isfinite(depth)
    for rasteriser in rasterisers(device):
        for slack, seen, nearer in (
            (1e-3, depth * 1.0005, False),
            (0.0, depth * 1.0005, True),
            (1e-3, depth * 1.002, True),
        ):
            got = count(np.insert(points, 3, 1.0, 1), faces, view, rasteriser, seen, COUNT_NEARER, slack=slack)
            np.testing.assert_array_equal(got[hit], int(nearer))


def test_drawing_goes_on_after_counting(device: str) -> None:
    """Both keep the corners of what they had last; and a volume may be written into the arrays of the one before."""
    view = view_of(True, 64, 48)
    shape, other = small_scenes.sphere((0.5, 0.2, -5.0), 1.0), small_scenes.box((0, 0, -4.0), (2.0, 2.0, 2.0))
    rasteriser = Rasteriser(device, 2)
    points = wp.array(shape[0].astype(np.float32), dtype=wp.vec3, device=device)
    indices = wp.array(shape[1].ravel(), dtype=int, device=device)
    depth = [wp.empty((48, 64), dtype=float, device=device) for _ in range(2)]
    rasteriser.draw(points, indices, view.to_device(), depth[0])
    count(np.insert(other[0], 3, 1.0, 1), other[1], view, rasteriser)
    rasteriser.draw(points, indices, view.to_device(), depth[1])
    np.testing.assert_array_equal(depth[1].numpy(), depth[0].numpy())
    whole = count(points, indices, view, rasteriser)
    indices.zero_()
    assert whole.any() and not count(points, indices, view, rasteriser).any()


LIGHTS = {"point": (1.0, 6.0, 2.0, 1.0), "direction": (0.2, 0.9, 0.35, 0.0), "slanting": (5.0, 5.0, 1.0, 1.0)}
MESHES = {
    "box": small_scenes.box((0.0, 1.5, 0.0), (1.5, 1.0, 1.2)),
    "torus": (torus()[0] + np.array([0.0, 1.5, 0.0]), torus()[1]),
    "boxes": small_scenes.random_boxes(6, seed=2),
    "leaf": (small_scenes.plane(2.0, cells=3)[0] + np.array([0.0, 1.5, 0.0]), small_scenes.plane(2.0, cells=3)[1]),
    "fan of five": (fan(5)[0] + np.array([0.0, 1.0, 0.0]), fan(5)[1]),
}


def volumes_of(
    mesh: tuple[np.ndarray, np.ndarray], light: tuple[float, ...], closed: str, device: str
) -> tuple[Volumes, np.ndarray]:
    """The volumes, and the faces that they begin at, (n, 3, 3)."""
    adjacency, found = silhouettes(*mesh, light, closed)
    points = wp.array(mesh[0].astype(np.float32), dtype=wp.vec3, device=device)
    out = sweep_volumes(Workspace(device, 2), points, adjacency, found, np.array(light))
    return out, mesh[0].astype(np.float32).astype(float)[adjacency.faces[np.flatnonzero(found.turns)]]


def all_faces(volumes: Volumes) -> np.ndarray:
    return np.concatenate([part.numpy() for part in (volumes.sides, volumes.near_caps, volumes.far_caps)]).reshape(
        -1, 3
    )


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("closed", ["lit", "unlit", "both"])
def test_volumes_close_to_the_last_pixel(name: str, light: str, closed: str, device: str) -> None:
    """As many faces turn to an eye outside as away from it, in every pixel, without any tolerance."""
    volumes, _ = volumes_of(apart(MESHES[name]), LIGHTS[light], closed, device)
    eye = small_scenes.camera((-9.0, 14.0, 12.0), (0, 0, 0), near=0.01)  # above what is between light and ground
    perspective = eye_view(eye, 230, 170, np.zeros(3))
    parallel = replace(perspective, window=(-6.0, 6.0, -4.5, 4.5), perspective=False)
    faces = all_faces(volumes)
    assert volumes.points_ws.dtype is wp.vec4 and (len(volumes.far_caps) == 0) == (light == "direction")
    for view in (perspective, parallel):
        for rasteriser in rasterisers(device):
            np.testing.assert_array_equal(count(volumes.points_ws, faces, view, rasteriser, front=1, back=-1), 0)
            assert count(volumes.points_ws, faces, view, rasteriser).mean() > 0.02
            assert count(volumes.points_ws, faces[::2], view, rasteriser, front=1, back=-1).any()


def crossings(points: np.ndarray, light: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles between each point and the light, and the least distance of a decision from falling otherwise."""
    way = light[:3] - points * light[3]
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    q = np.cross(way[:, None], v[None])
    det = np.einsum("pfj,fj->pf", q, u)
    off = points[:, None] - a[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.einsum("pfj,pfj->pf", off, q) / det
        r = np.cross(off, np.broadcast_to(u, off.shape))
        t = np.einsum("pj,pfj->pf", way, r) / det
        along = np.einsum("pfj,fj->pf", r, v) / det
        margins = np.stack([s, t, 1.0 - s - t, along, *([1.0 - along] if light[3] else [])])
    hit = (margins > 0).all(axis=0)
    return hit.sum(axis=1), np.abs(np.nan_to_num(margins, nan=0.0)).min(axis=0).min(axis=1)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("closed", ["lit", "both"])
@pytest.mark.parametrize("eye", ["lit", "in the shadow"])
def test_points_lie_in_as_many_volumes_as_faces_hide_the_light(
    name: str, light: str, closed: str, eye: str, device: str
) -> None:
    """Counted behind the ground that is seen, wherever the eye is; before it only for an eye that is lit."""
    mesh, light_ws = MESHES[name], np.array(LIGHTS[light])
    volumes, corners = volumes_of(mesh, LIGHTS[light], closed, device)
    middle = np.array([0.03, 1.5, 0.05])
    away = -(light_ws[:3] - middle * light_ws[3])
    away /= np.linalg.norm(away)
    where, target = (np.array([-3.0, 5.0, 6.0]), np.array([0.4, 0.0, -0.3]))
    if eye == "in the shadow":  # below the casters' middle, and looking on along the light's way
        where, target = middle + 0.9 * away, middle + 2.0 * away
    hidden, _ = crossings(where[None], light_ws, corners)
    assert (eye == "lit") == (hidden[0] == 0) or name in ("torus", "boxes", "fan of five")  # which have holes
    view = eye_view(small_scenes.camera(tuple(where), tuple(target), near=0.02), 71, 53, np.zeros(3))
    ground = small_scenes.plane(30.0)
    depth, _ = draw(*ground, view, device)
    left, right, bottom, top = view.window
    x, y = np.meshgrid(np.arange(71) + 0.5, np.arange(53) + 0.5)
    across = (left + (right - left) * x / 71)[..., None] * view.right_ws
    ways = across + (top + (bottom - top) * y / 53)[..., None] * view.up_ws + view.forward_ws
    points = view.eye_ws + depth[..., None] * ways
    hit = np.isfinite(depth)
    want, margin = np.zeros(depth.shape, int), np.zeros(depth.shape)
    want[hit], margin[hit] = crossings(points[hit], light_ws, corners)
    sure = hit & (margin > 3e-3)
    assert sure.mean() > 0.3 and (want[sure] > 0).any()
    for rasteriser in rasterisers(device):
        got = count(volumes.points_ws, all_faces(volumes), view, rasteriser, depth, COUNT_FARTHER, -1, 1)
        np.testing.assert_array_equal(got[sure], want[sure])
        if eye == "lit":
            before = count(volumes.points_ws, volumes.sides, view, rasteriser, depth, COUNT_NEARER, 1, -1)
            caps = count(volumes.points_ws, volumes.near_caps, view, rasteriser, depth, COUNT_NEARER, 1, -1)
            np.testing.assert_array_equal((before + caps)[sure], want[sure])


def test_frames_keep_volumes_with_their_silhouettes() -> None:
    still = small_scenes.scene([small_scenes.mesh("box", MESHES["box"])], small_scenes.light("point"))
    geometry = Geometry(small_scenes.moved(still, 0, lambda frame: float(frame > 1)), "cpu", 2)
    work, light = Workspace("cpu", 2), np.array(LIGHTS["point"])

    def pull() -> Any:
        return pull_volumes(work, geometry, pull_silhouettes(work, geometry, light), light)

    first = pull()
    geometry.set_frame(1)
    assert pull() is first
    geometry.set_frame(2)
    points = pull().points_ws.numpy()
    assert set(map(tuple, points[points[:, 3] == 1.0][:, :3])) <= set(map(tuple, geometry.points_ws.numpy()))


def test_nothing_casts_nothing_is_swept() -> None:
    volumes, _ = volumes_of((np.zeros((0, 3)), np.zeros((0, 3), np.int32)), LIGHTS["point"], "lit", "cpu")
    assert len(all_faces(volumes)) == 0
    assert not count(volumes.points_ws, all_faces(volumes), view_of(True, 20, 10), Rasteriser("cpu", 2)).any()

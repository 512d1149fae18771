from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

from wkernels.device.launch import launch
from wkernels.projections import clipping
from wkernels.projections.clipping import ConvexBody, HomogeneousPolygon, box_polyhedron, clip_polyhedron, convex_hull
from wkernels.scene.views import HostView

UNIT_CUBE = box_polyhedron(np.zeros(3), np.ones(3))


def random_axes(rng: np.random.Generator) -> np.ndarray:
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return axes * np.sign(np.linalg.det(axes))


def random_view(rng: np.random.Generator, perspective: bool) -> HostView:
    right, up, backward = random_axes(rng)
    window = (-rng.uniform(0.2, 1.2), rng.uniform(0.1, 0.8), -rng.uniform(0.1, 0.9), rng.uniform(0.3, 1.1))
    eye = rng.uniform(-1.0, 2.0, 3)
    near = rng.uniform(0.05, 0.5)
    return HostView(eye, right, up, -backward, window, near, near + rng.uniform(0.5, 3.0), 64, 48, perspective)


def halfspace_volume(planes: np.ndarray) -> float:
    """Volume of an intersection of half-spaces by a route without polygons: dual hull about the Chebyshev centre."""
    norm = np.linalg.norm(planes[:, :3], axis=1)
    result = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([-planes[:, :3], norm]),
        b_ub=planes[:, 3],
        bounds=[(None, None)] * 3 + [(None, None)],
    )
    if result.x[3] <= 1e-9:
        return 0.0
    return float(ConvexHull(HalfspaceIntersection(-planes, result.x[:3]).intersections).volume)


def box_planes(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    return np.concatenate([np.column_stack([np.eye(3), -lo]), np.column_stack([-np.eye(3), hi])])


def assert_closed(body: ConvexBody) -> None:
    """Area vectors of a closed surface cancel; every face looks away from the middle and is planar."""
    areas = np.array([clipping._area_vector(face) for face in body.faces])
    size = float(np.abs(body.vertices).max())
    np.testing.assert_allclose(areas.sum(axis=0), 0.0, atol=1e-9 * size * size)
    middle = body.vertices.mean(axis=0)
    for face, area in zip(body.faces, areas, strict=True):
        assert len(face) >= 3
        assert np.dot(face[0] - middle, area) >= -1e-12 * size**3
        assert np.abs((face - face[0]) @ area).max() <= 1e-9 * size * np.linalg.norm(area)


def test_clip_polygon_cuts_a_square() -> None:
    square = np.array([[0, 0, 5], [2, 0, 5], [2, 2, 5], [0, 2, 5]], float)
    half = clipping.clip_polygon(square, np.array([[3.0, 0.0, 0.0, -1.5]]))  # x >= 1/2, plane of length 3
    assert half.shape == (4, 3)
    assert {tuple(p) for p in half} == {(0.5, 0, 5), (2, 0, 5), (2, 2, 5), (0.5, 2, 5)}
    assert clipping._area_vector(half)[2] == pytest.approx(3.0)  # order kept
    corner = clipping.clip_polygon(square, np.array([[-1.0, -1.0, 0.0, 1.0]]))
    np.testing.assert_allclose(clipping._area_vector(corner), [0, 0, 0.5])
    for plane in ([1.0, 0, 0, -2.0], [-1.0, 0, 0, 0.0], [1.0, 1, 0, -4.0], [0, 0, -1.0, 4.0]):
        assert clipping.clip_polygon(square, np.array([plane])).shape == (0, 3)
    np.testing.assert_array_equal(clipping.clip_polygon(square, np.array([[0, 0, 1.0, -5.0]])), square)
    assert clipping.clip_polygon(np.zeros((0, 3)), np.array([[1.0, 0, 0, 0]])).shape == (0, 3)


def test_box_and_view_polyhedra() -> None:
    box = box_polyhedron(np.array([-1, 0, 2]), np.array([1, 3, 2.5]))
    assert box.volume == pytest.approx(3.0)
    assert box.vertices.shape == (8, 3)
    assert_closed(box)
    rng = np.random.default_rng(1)
    for perspective in (True, False):
        view = random_view(rng, perspective)
        body = clipping.view_polyhedron(view)
        assert_closed(body)
        assert body.volume > 0.0
        h = np.column_stack([body.vertices, np.ones(8)]) @ view.ws_to_ss.T
        np.testing.assert_allclose(np.abs(h[:, :2] / h[:, 3:]), 1.0, atol=1e-12)
        np.testing.assert_allclose(np.sort(h[:, 2]), [view.near] * 4 + [view.far] * 4, atol=1e-12)


@pytest.mark.parametrize("perspective", [True, False])
def test_clipping_by_frustum_planes_gives_the_view_volume(perspective: bool) -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        view = random_view(rng, perspective)
        expected = clipping.view_polyhedron(view)
        planes = clipping.frustum_planes(view.ws_to_ss, view.near, view.far)
        np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
        clipped = clip_polyhedron(box_polyhedron(np.full(3, -50.0), np.full(3, 50.0)), planes)
        assert_closed(clipped)
        assert clipped.volume == pytest.approx(expected.volume, rel=1e-9)
        np.testing.assert_allclose(
            sorted(map(tuple, clipped.vertices)), sorted(map(tuple, expected.vertices)), atol=1e-9
        )


def test_random_bodies_have_the_volume_of_the_half_space_intersection() -> None:
    rng = np.random.default_rng(3)
    seen = {"empty": 0, "solid": 0}
    for i in range(60):
        view = random_view(rng, bool(i % 2))
        lo, hi = np.sort(rng.uniform(-1.5, 2.5, (2, 3)), axis=0)
        planes = clipping.frustum_planes(view.ws_to_ss, view.near, view.far)
        body = clip_polyhedron(box_polyhedron(lo, hi), planes)
        expected = halfspace_volume(np.concatenate([planes, box_planes(lo, hi)]))
        assert body.volume == pytest.approx(expected, rel=1e-7, abs=1e-9)
        assert body.is_empty == (expected == 0.0)
        seen["empty" if body.is_empty else "solid"] += 1
        if not body.is_empty:
            assert_closed(body)
            points = np.column_stack([body.vertices, np.ones(len(body.vertices))])
            assert (points @ planes.T).min() > -1e-9
    assert min(seen.values()) >= 5


def test_planes_through_corners_and_edges() -> None:
    for plane, volume in (
        ([1.0, -1.0, 0.0, 0.0], 0.5),  # through two edges
        ([-1.0, -1.0, -1.0, 1.0], 1.0 / 6.0),  # through three corners
        ([1.0, 1.0, 1.0, -1.0], 5.0 / 6.0),
        ([0.0, 2.0, -1.0, 0.0], 0.75),  # through one edge
        ([1.0, 0.0, 0.0, 0.0], 1.0),  # along a face, body inside
        ([0.0, 0.0, -3.0, 3.0], 1.0),
    ):
        body = clip_polyhedron(UNIT_CUBE, np.array([plane]))
        assert body.volume == pytest.approx(volume, abs=1e-12)
        assert_closed(body)
        again = clip_polyhedron(body, np.array([plane]))
        assert again is body  # nothing left to cut: no second cap


def test_bodies_that_only_touch_are_empty() -> None:
    for plane in ([-1.0, 0, 0, 0], [1.0, 1, 0, -2], [1.0, 1, 1, -3], [1.0, 0, 0, -1.5]):
        body = clip_polyhedron(UNIT_CUBE, np.array([plane]))
        assert body.is_empty and body.volume == 0.0 and body.vertices.shape == (0, 3)
        assert clip_polyhedron(body, np.array([[1.0, 0, 0, 9.0]])).is_empty


def test_faces_can_be_given_as_a_list() -> None:
    body = clip_polyhedron(list(UNIT_CUBE.faces), np.array([[-1.0, 0, 0, 0.25]]))
    assert body.volume == pytest.approx(0.25)


def test_flat_bodies_are_clipped_like_polygons() -> None:
    floor = box_polyhedron(np.array([0.0, 0.0, 0.0]), np.array([2.0, 0.0, 2.0]))
    cut = clip_polyhedron(floor, np.array([[1.0, 0, 0, -1.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, -1.0, 3.0]]))
    assert cut.volume == 0.0
    assert {tuple(np.round(p, 12)) for p in cut.vertices} == {(1, 0, 0), (2, 0, 0), (2, 0, 1), (1, 0, 2)}
    assert clip_polyhedron(floor, np.array([[0.0, 1.0, 0.0, -0.1]])).is_empty


def test_convex_hull() -> None:
    rng = np.random.default_rng(4)
    points = np.concatenate([UNIT_CUBE.vertices, rng.random((50, 3))]) * 1e-3 + 7.0
    hull = convex_hull(points)
    assert hull.volume == pytest.approx(1e-9, rel=1e-6)
    assert_closed(hull)
    np.testing.assert_allclose(hull.vertices.min(axis=0), 7.0)
    axes = random_axes(rng)
    flat = convex_hull(np.column_stack([rng.random((30, 2)), np.zeros(30)]) @ axes + 2.0)
    assert len(flat.faces) == 2 and flat.volume == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(clipping._area_vector(flat.faces[0]), -clipping._area_vector(flat.faces[1]))
    for degenerate in (np.zeros((0, 3)), np.ones((2, 3)), np.ones((9, 3)), np.outer(np.arange(9.0), [1, 2, 3])):
        assert convex_hull(degenerate).is_empty


def test_extrusion_towards_a_light() -> None:
    body = clipping.extrude_towards(UNIT_CUBE.vertices, np.array([0.0, 5.0, 0.0]), 2.0)
    assert body.volume == pytest.approx(3.0)
    np.testing.assert_allclose(body.vertices.max(axis=0), [1, 3, 1])
    slanted = clipping.extrude_towards(UNIT_CUBE.vertices, np.array([1.0, 1.0, 1.0]), np.sqrt(3.0))
    assert slanted.volume == pytest.approx(1.0 + 3.0)  # cube + its three far faces swept through volume 1 each


def test_focus_body_holds_every_occluder_of_what_is_seen() -> None:
    """B = hull(V and S and light) and S, Stingl 2011, section 3.1: from a seen point to the light all is inside."""
    rng = np.random.default_rng(5)
    view = random_view(rng, True)
    lo, hi = np.full(3, -2.0), np.full(3, 2.5)
    seen = clip_polyhedron(clipping.view_polyhedron(view), box_planes(lo, hi))
    light = np.array([0.5, 2.2, -0.3])
    focus = clip_polyhedron(convex_hull(np.concatenate([seen.vertices, [light]])), box_planes(lo, hi))
    assert_closed(focus)
    assert seen.volume < focus.volume
    weights = rng.dirichlet(np.ones(len(seen.vertices)), 200)
    receivers = weights @ seen.vertices
    t = rng.random((200, 1))
    segments = receivers + t * (light - receivers)
    for face in focus.faces:
        outwards = clipping._area_vector(face)
        assert ((segments - face[0]) @ outwards).max() <= 1e-9


# --- kernels ---


@wp.kernel
def measure_polygons(
    first: int, corners: wp.array2d[wp.vec3], count: wp.array[int], lo: wp.array[wp.vec2], hi: wp.array[wp.vec2],
    area_out: wp.array[float], corners_out: wp.array[int], least_w_out: wp.array[float],
):  # fmt: skip
    i = first + wp.tid()
    polygon = HomogeneousPolygon()
    for k in range(count[i]):
        polygon.corners[k] = corners[i, k]
    polygon.count = count[i]
    area_out[i] = clipping.polygon_area_in_rect(polygon, lo[i], hi[i])
    clipped = clipping.clip_to_rect(polygon, lo[i], hi[i])
    corners_out[i] = clipped.count
    least = float(1.0e9)
    for k in range(clipped.count):
        least = wp.min(least, clipped.corners[k, 2])
    least_w_out[i] = least


def measured(polygons: list[np.ndarray], lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = len(polygons)
    corners = np.zeros((n, 8, 3), np.float32)
    for i, polygon in enumerate(polygons):
        corners[i, : len(polygon)] = polygon
    inputs = [
        wp.array(corners, dtype=wp.vec3),
        wp.array([len(p) for p in polygons], dtype=int),
        wp.array(lo, dtype=wp.vec2),
        wp.array(hi, dtype=wp.vec2),
    ]
    outputs = [wp.empty(n, dtype=float), wp.empty(n, dtype=int), wp.empty(n, dtype=float)]
    launch(measure_polygons, n, inputs, outputs, threads=2)
    area, count, least_w = (out.numpy() for out in outputs)
    return area, count, least_w


def area_twin(polygon: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> float:
    """Sutherland-Hodgman in float64 through the host clipper: a line through w is a plane through the origin."""
    planes = np.array([[1, 0, -lo[0], 0], [-1, 0, hi[0], 0], [0, 1, -lo[1], 0], [0, -1, hi[1], 0]], float)
    clipped = clipping.clip_polygon(polygon, planes)
    if len(clipped) < 3:
        return 0.0
    x, y = (clipped[:, :2] / clipped[:, 2:]).T
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def grid_area(polygon: np.ndarray, lo: np.ndarray, hi: np.ndarray, side: int = 300) -> float:
    """Brute force: the share of grid points whose ray from the centre lies in the cone over the polygon."""
    t = (np.arange(side) + 0.5) / side
    x, y = np.meshgrid(lo[0] + t * (hi[0] - lo[0]), lo[1] + t * (hi[1] - lo[1]))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    sides = rays @ np.cross(polygon, np.roll(polygon, -1, axis=0)).T
    ahead = polygon.mean(axis=0) @ clipping._area_vector(polygon)  # which side of the cone's walls is the inside
    inside = (sides * np.sign(ahead) >= 0.0).all(axis=-1)
    return float(inside.mean() * np.prod(hi - lo))


def random_polygons(n: int, behind: bool) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Convex polygons in random planes of space; ``behind`` lets them reach past the centre's plane w = 0."""
    rng = np.random.default_rng(10 + behind)
    polygons = []
    for _ in range(n):
        corners = int(rng.integers(3, 9))
        angle = np.sort(rng.random(corners)) * 2.0 * np.pi
        axes = random_axes(rng)[:2] * rng.uniform(0.3, 2.0, (2, 1))
        centre = np.append(rng.normal(size=2), rng.uniform(-0.6, 1.5) if behind else rng.uniform(2.2, 4.0))
        polygons.append(
            (centre + np.column_stack([np.cos(angle), np.sin(angle)]) @ axes).astype(np.float32).astype(float)
        )
    lo = rng.uniform(-1.5, 0.5, (n, 2)).astype(np.float32)
    hi = lo + rng.uniform(0.1, 2.0, (n, 2)).astype(np.float32)
    return polygons, lo, hi


@pytest.mark.parametrize("behind", [False, True])
def test_polygon_area_in_rectangle(behind: bool) -> None:
    polygons, lo, hi = random_polygons(3000, behind)
    area, count, least_w = measured(polygons, lo, hi)
    lo, hi = lo.astype(float), hi.astype(float)
    twin = np.array([area_twin(*arguments) for arguments in zip(polygons, lo, hi, strict=True)])
    whole = (hi - lo).prod(axis=1)
    # Polygons all but edge-on are ill-conditioned: there a corner's rounding moves the outline far.
    distance = np.array(
        [abs(p[0] @ clipping._area_vector(p)) / (np.linalg.norm(clipping._area_vector(p)) + 1e-30) for p in polygons]
    )
    sound = distance > 0.02
    assert sound.mean() > 0.9
    np.testing.assert_allclose(area[sound] / whole[sound], twin[sound] / whole[sound], atol=2e-4)
    assert (area >= 0.0).all() and (area <= whole * (1.0 + 1e-5)).all()
    assert count.max() <= clipping.MAX_CORNERS
    assert least_w.min() > -1e-5
    partial = (twin > 0.05 * whole) & (twin < 0.95 * whole)
    assert partial.sum() > 300  # the test must see real cuts
    if behind:
        crossing = np.array([p[:, 2].min() < 0.0 < p[:, 2].max() for p in polygons])
        assert (crossing & partial).sum() > 100
    for i in np.flatnonzero(partial & sound)[:60]:
        assert area[i] == pytest.approx(grid_area(polygons[i], lo[i], hi[i]), abs=0.01 * whole[i])


def test_orientation_and_degenerate_polygons() -> None:
    square = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
    cases = [
        (square, 0.25),
        (square[::-1], 0.25),
        (square * 7.0, 0.25),  # homogeneous: a factor changes nothing
        (-square, 0.0),  # the mirror image behind the centre
        (square + np.array([5, 0, 0]), 0.0),
        (square * np.array([100, 100, 1]) - np.array([50, 50, 0]), 1.0),
        (np.array([[-1, 0.3, 0], [1, 0.3, 0], [1, 0.3, 1], [-1, 0.3, 1]], float), 1.0),  # see below
        (np.array([[0.2, 0.2, 1], [0.4, 0.4, 1], [0.9, 0.9, 1]], float), 0.0),  # no area
        (np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 2], [-1, 0, 2]], float), 0.0),  # edge-on through the centre
    ]
    lo, hi = np.tile([0.5, 0.5], (len(cases), 1)), np.tile([1.5, 1.5], (len(cases), 1))
    area = measured([polygon for polygon, _ in cases], lo, hi)[0]
    expected = np.array([value for _, value in cases])
    # The strip y = 0.3, w from 0 to 1, projects to y >= 0.3 and |x| <= y / 0.3: all of the square.
    assert grid_area(cases[6][0], lo[0], hi[0], 1000) == pytest.approx(1.0)
    np.testing.assert_allclose(area, expected, atol=1e-5)


@pytest.mark.parametrize("around_centre", [False, True])
def test_edge_on_polygons(around_centre: bool) -> None:
    """Planes through the centre, up to rounding: clipping leaves corners whose w is rounding error of either sign.

    Seen from beside it such a polygon is a line. From within it is a half-plane or nothing, as the last bit decides,
    and all that can be asked is a finite answer within the rectangle.
    """
    rng = np.random.default_rng(14)
    polygons = []
    for _ in range(4000):
        u, v = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        angle = np.sort(rng.random(6)) * 2.0 * np.pi
        centre = rng.uniform(-0.5, 0.5) if around_centre else rng.uniform(1.5, 3.0)
        polygons.append(rng.uniform(1.0, 50.0) * (np.outer(np.cos(angle) + centre, u) + np.outer(np.sin(angle), v)))
    lo, hi = np.full((4000, 2), -1.0), np.full((4000, 2), 1.0)
    area, _, least_w = measured(polygons, lo, hi)
    assert (area >= 0.0).all() and (area <= 4.0).all()  # false for NaN
    if around_centre:
        assert least_w.min() < 0.0  # the hard case does occur
    else:
        assert area.max() < 1e-3


@wp.kernel
def clip_edges(
    first: int, a: wp.array[wp.vec3], b: wp.array[wp.vec3], line: wp.array[wp.vec3],
    start_out: wp.array[wp.vec3], end_out: wp.array[wp.vec3], visible_out: wp.array[int],
):  # fmt: skip
    i = first + wp.tid()
    start, end, visible = clipping.clip_edge(a[i], b[i], line[i])
    start_out[i] = start
    end_out[i] = end
    visible_out[i] = wp.where(visible, 1, 0)


def test_clip_edge_equals_its_twin() -> None:
    rng = np.random.default_rng(12)
    n = 2000
    a, b, line = rng.normal(size=(3, n, 3)).astype(np.float32)
    outputs = [wp.empty(n, dtype=wp.vec3), wp.empty(n, dtype=wp.vec3), wp.empty(n, dtype=int)]
    launch(clip_edges, n, [wp.array(v, dtype=wp.vec3) for v in (a, b, line)], outputs)
    start, end, visible = (out.numpy() for out in outputs)
    a, b, line = a.astype(float), b.astype(float), line.astype(float)
    side_a, side_b = (a * line).sum(axis=1), (b * line).sum(axis=1)
    np.testing.assert_array_equal(visible, (side_a >= 0.0) | (side_b >= 0.0))
    cut = a + np.where(side_a * side_b < 0.0, side_a / (side_a - side_b), 0.0)[:, None] * (b - a)
    expected_start, expected_end = np.where(side_a[:, None] >= 0.0, a, cut), np.where(side_b[:, None] >= 0.0, b, cut)
    seen = visible == 1
    assert 0.6 < seen.mean() < 0.9
    np.testing.assert_allclose(start[seen], expected_start[seen], atol=2e-5)
    np.testing.assert_allclose(end[seen], expected_end[seen], atol=2e-5)


@wp.kernel
def overlap_rects(first: int, rects: wp.array2d[wp.vec2], area_out: wp.array[float]):
    i = first + wp.tid()
    area_out[i] = clipping.rect_overlap_area(rects[i, 0], rects[i, 1], rects[i, 2], rects[i, 3])


def test_rectangle_overlap_equals_the_polygon_clip() -> None:
    rng = np.random.default_rng(13)
    n = 1000
    lo = rng.uniform(-1.0, 1.0, (n, 2, 2))
    hi = lo + rng.uniform(0.0, 1.5, (n, 2, 2))
    rects = np.stack([lo[:, 0], hi[:, 0], lo[:, 1], hi[:, 1]], axis=1).astype(np.float32)
    out = wp.empty(n, dtype=float)
    launch(overlap_rects, n, [wp.array(rects, dtype=wp.vec2)], [out])
    (x0, y0), (x1, y1) = rects[:, 0].T, rects[:, 1].T
    one = np.ones(n)
    corners = np.stack(
        [np.stack(c, axis=1) for c in ((x0, y0, one), (x1, y0, one), (x1, y1, one), (x0, y1, one))], axis=1
    )
    expected = [area_twin(c, r[2], r[3]) for c, r in zip(corners.astype(float), rects.astype(float), strict=True)]
    np.testing.assert_allclose(out.numpy(), expected, atol=2e-6)
    assert 0.2 < (out.numpy() > 0.0).mean() < 0.8

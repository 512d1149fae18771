"""The drawing behind the views: lines with depth, bodies of glass, the free camera, texel grids and colours."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes

from experiments.schema.models import ThirdPerson
from experiments.views.bodies import box_of, edges, fill, pixel_rays, spans
from experiments.views.free_camera import free_camera
from experiments.views.lines import clip_segment, draw_lines, project, to_pixels
from experiments.views.sheet import Bar, Chips, Panel, Sheet, composed, wrapped
from experiments.views.space import _smaller
from experiments.views.texels import STOP_COLORS, STOPS, grid_lines, rate_colors, sampling_rate
from wkernels.projections.clipping import ConvexBody, box_polyhedron, convex_hull
from wkernels.scene.views import HostView, eye_view

RED = (1.0, 0.0, 0.0)


def camera(width: int = 80, height: int = 60) -> HostView:
    return eye_view(small_scenes.camera((0.0, 0.0, 5.0), fov_deg=60.0, near=0.1, far=50.0), width, height, np.zeros(3))


def is_red(image: np.ndarray) -> np.ndarray:
    return (image[..., 0] > 0.6) & (image[..., 1] < 0.4)


# ---- lines ----


def test_a_line_goes_through_the_pixels_between_its_projected_ends() -> None:
    view, image = camera(), np.zeros((60, 80, 3))
    segment = np.array([[[-1.0, -0.7, 0.0], [1.2, 0.9, -1.0]]])
    draw_lines(image, view, segment, RED, width=2.0)
    points = segment[0, 0] + np.linspace(0.0, 1.0, 40)[:, None] * (segment[0, 1] - segment[0, 0])
    places = np.floor(to_pixels(view, project(view, points))).astype(int)
    assert is_red(image)[places[:, 1], places[:, 0]].all()
    rows, columns = np.nonzero(is_red(image))
    a, b = to_pixels(view, project(view, segment[0]))
    way = (b - a) / np.linalg.norm(b - a)
    distance = np.abs((columns + 0.5 - a[0]) * way[1] - (rows + 0.5 - a[1]) * way[0])
    assert distance.max() < 1.5  # half the width and half a pixel


def test_what_lies_behind_a_surface_is_dashed_or_left_out() -> None:
    view = camera()
    segment = np.array([[[-2.0, 0.01, -2.0], [2.0, 0.01, -2.0]]])  # at depth 7
    depth = np.full((60, 80), np.inf)
    depth[:, 40:] = 3.0
    shown = {}
    for hidden in (0.0, 1.0):
        image = np.zeros((60, 80, 3))
        draw_lines(image, view, segment, RED, depth=depth, hidden=hidden, width=2.0, halo=False)
        shown[hidden] = is_red(image).any(axis=0)
    a, b = to_pixels(view, project(view, segment[0]))[:, 0]
    columns = np.arange(80)
    before = (columns > a + 1) & (columns < 40)
    behind = (columns >= 40) & (columns < b - 1)
    assert shown[0.0][before].all() and not shown[0.0][behind].any()
    assert 0.3 < shown[1.0][behind].mean() < 0.9  # dashes


def test_depth_along_a_line_is_that_of_the_world_not_of_the_screen() -> None:
    # from depth 1 to depth 20: half-way across the screen the line is at depth 1.9, not 10.5
    view = camera()
    segment = np.array([[[-0.4, 0.01, 4.0], [8.0, 0.01, -15.0]]])
    image = np.zeros((60, 80, 3))
    draw_lines(image, view, segment, RED, depth=np.full((60, 80), 2.5), hidden=0.0, width=2.0)
    last = int(np.nonzero(is_red(image).any(axis=0))[0].max())
    t = (2.5 - 1.0) / 19.0
    point = segment[0, 0] + t * (segment[0, 1] - segment[0, 0])
    assert abs(last - to_pixels(view, project(view, point[None]))[0, 0]) < 1.5


def test_lines_behind_the_camera_and_beside_the_picture_draw_nothing() -> None:
    image = np.zeros((60, 80, 3))
    draw_lines(image, camera(), np.array([[[0, 0, 6.0], [1, 0, 9.0]], [[90.0, 0, 0], [95.0, 1, 0]]]), RED)
    assert not image.any()
    draw_lines(image, camera(), np.array([[[0.0, -0.5, 9.0], [0.0, -0.5, 0.0]]]), RED)  # from behind into the picture
    assert is_red(image)[:, 39:41].any() and not is_red(image)[:30].any()


def test_a_segment_is_cut_where_it_leaves_the_picture() -> None:
    cut = clip_segment(np.array([-3.0, 0, 1, 1]), np.array([1.0, 0, 1, 1]), 1e-4)
    assert cut is not None
    np.testing.assert_allclose([cut[0][0], cut[1][0]], [-1.0, 1.0])


# ---- bodies ----


def test_edges_of_a_box_and_of_a_triangulated_one() -> None:
    box = box_polyhedron(np.zeros(3), np.array([1.0, 2.0, 3.0]))
    assert len(edges(box)) == 12
    lengths = np.sort(np.linalg.norm(np.diff(edges(convex_hull(box.vertices)), axis=1)[:, 0], axis=1))
    np.testing.assert_allclose(lengths, [1.0] * 4 + [2.0] * 4 + [3.0] * 4)  # no diagonals
    assert edges(ConvexBody()).shape == (0, 2, 3)


def test_rays_enter_and_leave_a_box_where_slabs_say() -> None:
    view = camera()
    low, high = np.array([-0.8, -0.5, -1.0]), np.array([0.3, 0.9, 1.2])
    enter, leave, by = spans(view, box_polyhedron(low, high))
    base, along = pixel_rays(view)
    with np.errstate(divide="ignore"):
        t = np.stack([(low - base) / along, (high - base) / along])
    first, last = t.min(axis=0).max(axis=-1), t.max(axis=0).min(axis=-1)
    hit = first < last
    np.testing.assert_array_equal(enter < leave, hit)
    np.testing.assert_allclose(enter[hit], first[hit], rtol=1e-12)
    np.testing.assert_allclose(leave[hit], last[hit], rtol=1e-12)
    assert hit.any() and not hit.all() and (by[hit] >= 0).all()


def test_a_body_tints_what_it_is_in_front_of_and_around() -> None:
    view, box = camera(), box_polyhedron(-0.5 * np.ones(3), 0.5 * np.ones(3))  # depths 4.5 to 5.5
    tints = []
    for depth in (4.0, 5.0, np.inf):
        image = np.ones((60, 80, 3))
        fill(image, view, box, RED, np.full((60, 80), depth), 0.25)
        assert (image[0] == 1.0).all()
        tints.append(1.0 - image[30, 40, 1])
    assert tints[0] == 0.0
    assert tints[1] == pytest.approx(0.25) and tints[2] > 0.35  # one side, both sides


def test_the_box_of_a_body_is_its_bounding_box() -> None:
    points = np.random.default_rng(1).normal(size=(20, 3))
    corners = box_of(convex_hull(points)).vertices
    np.testing.assert_array_equal([corners.min(0), corners.max(0)], [points.min(0), points.max(0)])


# ---- the free camera ----


@pytest.mark.parametrize("given", [{}, {"azimuth_deg": -120.0, "elevation_deg": 10.0}, {"elevation_deg": 80.0}])
def test_everything_that_the_eye_sees_is_in_the_picture(given: dict) -> None:
    eye = camera()
    points = np.random.default_rng(2).uniform((-3, -1, -9), (3, 2, 4), (30, 3))
    chosen = free_camera(ThirdPerson.model_validate(given), eye, np.array([0.0, 1.0, 0.0]), points, 20.0, 1.5)
    view = eye_view(chosen, 150, 100, np.zeros(3))
    h = project(view, np.vstack([points, eye.eye_ws[None]]))
    reach = np.abs(h[:, :2] / h[:, 3:]).max()
    assert 0.85 < reach < 1.0 and (h[:, 2] > view.near).all() and (h[:, 2] < view.far).all()


def test_azimuth_and_elevation_are_about_the_eye() -> None:
    eye, up = camera(), np.array([0.0, 1.0, 0.0])  # it looks along -z
    points = np.array([[-1.0, -1, -6], [1, 1, 4]])
    for azimuth, towards in ((0.0, (0, 0, 1)), (90.0, (1, 0, 0)), (180.0, (0, 0, -1))):
        settings = ThirdPerson.model_validate({"azimuth_deg": azimuth, "elevation_deg": 30.0})
        chosen = free_camera(settings, eye, up, points, 20.0, 1.5)
        way = (chosen.eye - chosen.target) / np.linalg.norm(chosen.eye - chosen.target)
        np.testing.assert_allclose(way, np.cos(np.pi / 6) * np.array(towards) + [0, 0.5, 0], atol=1e-12)


def test_a_given_place_is_taken() -> None:
    settings = ThirdPerson(eye=(1.0, 2.0, 3.0), target=(0.0, 1.0, 0.0), fov_deg=33.0)
    chosen = free_camera(settings, camera(), np.array([0.0, 1.0, 0.0]), np.zeros((1, 3)), 20.0, 1.5)
    assert (*chosen.eye, *chosen.target, chosen.fov_deg) == (1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 33.0)


# ---- texels ----


def test_grid_lines_are_centred_on_the_multiples_of_the_step() -> None:
    columns = np.arange(60) + 0.5
    place = np.stack(np.broadcast_arrays(0.4 * columns[None], 1000.3), axis=-1)  # a texel is 2.5 pixels wide
    jacobian = np.broadcast_to(np.array([[0.4, 0.0], [0.0, 1e-6]]), (1, 60, 2, 2))
    cover = grid_lines(place, jacobian, 4, 2.0)[0]  # lines at columns 0, 10, 20, ...
    expected = np.isin(np.arange(60) % 10, (9, 0))  # pixels whose centre is half a pixel from a line
    np.testing.assert_allclose(cover[expected], 1.0)
    np.testing.assert_allclose(cover[~expected], 0.0, atol=1e-12)
    assert not grid_lines(place, jacobian, 1, 2.0).any()  # 2.5 pixels per cell would only be grey


def test_colours_of_sampling_rates() -> None:
    np.testing.assert_allclose(rate_colors(np.array(STOPS)), STOP_COLORS)
    np.testing.assert_allclose(rate_colors(np.array([1.0, 2.125, 99.0])), [(0, 1, 0), (0.15, 0.9, 0.5), (0, 0, 0.4)])


def test_sampling_rates_of_a_known_jacobian() -> None:
    jacobian = np.array([[3.0, 4.0], [0.0, 0.8]])  # rows: the map's x and y
    rates = [float(sampling_rate(jacobian, mode)) for mode in ("x", "y", "det")]
    assert rates == pytest.approx([5.0, 0.8, np.sqrt(2.4)])


# ---- the sheet ----


def test_a_panel_is_copied_pixel_for_pixel_and_every_text_has_room() -> None:
    rng = np.random.default_rng(5)
    image = rng.random((40, 70, 3))
    bar = Bar("scale", lambda place: np.repeat(place[:, None], 3, axis=1), [(0.0, "0"), (1.0, "1")])
    sheet = Sheet([Panel(image, "one"), Panel(image, "two")], [bar, Chips([((1, 0, 0), "red")])], ["A note. " * 40])
    out = composed(sheet, "A $title with \\frac$ in it", "words " * 60)
    expected = np.rint(255.0 * image).astype(np.uint8)
    found = [
        (y, x)
        for y in range(out.shape[0] - 40)
        for x in (14, 14 + 70 + 12)
        if np.array_equal(out[y : y + 40, x : x + 70], expected)
    ]
    assert len(found) == 2 and found[0][0] == found[1][0]
    assert (out[:, -4:] == 255).all() and (out[-3:] == 255).all()  # nothing runs over the rim
    np.testing.assert_array_equal(out, composed(sheet, "A $title with \\frac$ in it", "words " * 60))


def test_text_is_wrapped_to_its_width() -> None:
    lines = wrapped("a word and another one and so on", 60.0, 9.0)
    assert " ".join(lines) == "a word and another one and so on" and len(lines) > 2


def test_shrinking_keeps_means() -> None:
    image = np.random.default_rng(6).random((30, 50, 3))
    small = _smaller(image, 20, 20)
    assert small.shape == (12, 20, 3)
    np.testing.assert_allclose(small.mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=1e-12)
    np.testing.assert_allclose(_smaller(image, 25, 30), image.reshape(15, 2, 25, 2, 3).mean(axis=(1, 3)), rtol=1e-9)

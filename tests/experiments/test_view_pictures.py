"""Every view of a small scene: the right thing at chosen pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import Delaunay
from view_subjects import make, write_configs

from experiments.results.images import ERROR_SCALE, error_view
from experiments.views import error_plot, light_maps, render, silhouettes, space, surfaces
from experiments.views.bodies import edges
from experiments.views.lines import project, to_pixels
from experiments.views.subject import Subject
from experiments.views.texels import jacobians, map_positions, sampling_rate
from wkernels.casters.pulls import pull_silhouettes


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_configs(tmp_path_factory.mktemp("config"))


@pytest.fixture(scope="module")
def box(files: Path) -> Subject:
    return make(files, "box")


def picture(sheet: Any, panel: int = 0) -> np.ndarray:
    image: np.ndarray = sheet.panels[panel].image
    return image


# ---- surfaces ----


@pytest.mark.parametrize("place", ["eye", "third"])
def test_every_receiver_has_the_colour_of_the_split_that_its_depth_names(box: Subject, place: str) -> None:
    shot = box.shot(place)
    depth = (shot.position - box.eye.eye_ws) @ box.eye.forward_ws
    ends = [view.choice.far for view in box.views]  # type: ignore[attr-defined]
    assert len(ends) == 3
    expected = np.full(depth.shape, -1)
    for i in reversed(range(3)):
        h = shot.position @ box.views[i].ws_to_ss[:, :3].T + box.views[i].ws_to_ss[:, 3]
        holds = (h[..., 3] > 0) & (np.abs(h[..., :2]).max(axis=-1) <= h[..., 3]) & (shot.flags > 0)
        expected[holds & (depth < ends[i])] = i
    np.testing.assert_array_equal(shot.layer[shot.layer >= 0] >= 0, True)
    same = shot.layer == expected
    assert same[shot.flags > 0].mean() > 0.97  # float32 at borders; and a receiver that only a later split holds
    image, plain = picture(surfaces.split_colours(box, place)), surfaces.base(shot)
    untouched = np.ones(depth.shape, bool) if place == "eye" else _beside_lines(box)
    for i in range(3):
        mine = (shot.layer == i) & untouched
        tone = 0.45 + 0.55 * plain[mine].mean(axis=-1, keepdims=True)
        np.testing.assert_allclose(image[mine], plain[mine] * 0.28 + np.array(surfaces.SPLIT_COLORS[i]) * tone * 0.72)
        assert mine.any()
    none = (shot.layer < 0) & untouched
    np.testing.assert_array_equal(image[none], plain[none])


def _beside_lines(subject: Subject) -> np.ndarray:
    """Pixels of the third-person view that no frustum line touches."""
    shot = subject.shot("third")
    ink = np.zeros((*shot.depth.shape, 3))
    surfaces.draw_frustum(ink, subject, shot)
    marked = np.ones((*shot.depth.shape, 3))
    surfaces.draw_frustum(marked, subject, shot)
    out: np.ndarray = (ink == 0.0).all(axis=-1) & (marked == 1.0).all(axis=-1)
    return out


@pytest.mark.parametrize("place", ["eye", "third"])
def test_the_jacobian_is_the_difference_of_map_positions_between_pixels(box: Subject, place: str) -> None:
    shot = box.shot(place)
    position = map_positions(box, shot)
    jacobian = jacobians(box, shot, shot.view, shot.layer >= 0)
    floor = shot.position[shot.flags > 0][:, 1].min()
    flat = (shot.normal[..., 1] > 0.999) & (np.abs(shot.position[..., 1] - floor) < 1e-3) & (shot.flags > 0)
    for axis in (0, 1):
        inner = np.zeros_like(flat)
        near = [np.roll(shot.layer, shift, axis) for shift in (1, -1)]
        inner[1:-1, 1:-1] = True
        inner &= flat & np.roll(flat, 1, axis) & np.roll(flat, -1, axis)
        inner &= (shot.layer == near[0]) & (shot.layer == near[1]) & (shot.layer >= 0)
        central = 0.5 * (np.roll(position, -1, axis) - np.roll(position, 1, axis))
        # positions count rows downwards, Jacobians to the right and up
        sign = np.array([1.0, -1.0]) * (1.0 if axis == 1 else -1.0)
        expected = central[inner] * sign
        found = jacobian[inner][:, :, 1 - axis]
        scale = np.linalg.norm(expected, axis=1)
        error = np.linalg.norm(found - expected, axis=1) / scale
        assert inner.sum() > 100
        assert np.median(error) < 0.01 and np.percentile(error, 90) < 0.1  # a difference has an error of second order


def test_texel_borders_are_dark_where_neighbours_read_different_cells(files: Path) -> None:
    subject = make(files, "box", "views.texels=32")
    shot = subject.shot("eye")
    image, plain = picture(surfaces.texel_borders(subject, "eye")), surfaces.base(shot)
    cell = np.floor(map_positions(subject, shot) / 32)
    jacobian = jacobians(subject, shot, shot.view, shot.layer >= 0)
    wide = 32.0 / np.linalg.norm(jacobian, axis=-1).max(axis=-1) > 8.0  # pixels per cell: no fading
    with np.errstate(invalid="ignore"):
        differs = (cell[:, 1:] != cell[:, :-1]).any(axis=-1)
    pairs = wide[:, 1:] & wide[:, :-1] & (shot.layer[:, 1:] == shot.layer[:, :-1])
    darkness = 1.0 - image.mean(axis=-1) / np.maximum(plain.mean(axis=-1), 1e-3)
    between = np.maximum(darkness[:, 1:], darkness[:, :-1])
    assert (pairs & differs).sum() > 20
    assert between[pairs & differs].min() > 0.25  # a border crosses a pixel or its neighbour
    assert np.median(between[pairs & ~differs]) < 0.2


def test_a_sampling_rate_of_one_is_green_from_everywhere(files: Path) -> None:
    changes = [
        "projection.fit=scene", "projection.splits=1", "projection.warp=none", "techniques.0.shadow_map.resolution=66",
        "image={width: 48, height: 32}", "views.third_person={azimuth_deg: 20, elevation_deg: 40}",
    ]  # fmt: skip
    subject = make(files, "above", *changes)
    for place in ("eye", "third"):
        shot = subject.shot(place)
        where = shot.layer >= 0
        if place == "third":
            where &= subject.in_eye_view(shot.position)[1]
            assert where.any() and not where[shot.layer >= 0].all()
        for mode in ("det", "x", "y"):
            rate = sampling_rate(jacobians(subject, shot, subject.eye, where), mode)[where]
            np.testing.assert_allclose(rate, 1.0, rtol=1e-5)  # positions are float32
        image, plain = picture(surfaces.sampling_frequency(subject, place, "det")), surfaces.base(shot)
        inside = where if place == "eye" else where & _beside_lines(subject)
        tone = 0.45 + 0.55 * plain[inside].mean(axis=-1, keepdims=True)
        green = plain[inside] * 0.15 + np.array([0.0, 1.0, 0.0]) * tone * 0.85
        np.testing.assert_allclose(image[inside], green, atol=1e-4)


def test_the_difference_is_that_to_the_reference_or_to_rays(box: Subject, files: Path) -> None:
    visibility = box.shot("eye").visibility
    reference = np.where(np.isnan(visibility), np.nan, 0.25).astype(np.float32)
    given = make(files, "box", reference=reference)
    found, known = picture(surfaces.difference(given, "eye")), np.isfinite(visibility)
    np.testing.assert_allclose(found[known], error_view(visibility, reference)[known] / 255.0)
    rays = box.truth("eye")
    assert set(np.unique(rays[known])) == {0.0, 1.0} and (rays[known] != visibility[known]).mean() < 0.1
    bar = surfaces.difference(box, "third").legend[0]
    assert ERROR_SCALE in bar.label  # type: ignore[union-attr]


# ---- silhouettes ----


def test_silhouettes_lie_where_lit_faces_meet_others(files: Path) -> None:
    """Of a box under a slanting light: six edges in one loop, seen through what hides them in dashes."""
    subject = make(files, "box", "techniques=[shadow_volume_zfail]", "scene.meshes.0.casts=false")
    shot = subject.shot("third")
    sheet = silhouettes.silhouettes(subject, "third")
    assert "6 of the casters' edges" in sheet.notes[0] and "1 loops" in sheet.notes[0]
    changed = np.abs(picture(sheet) - surfaces.base(shot)).max(axis=-1) > 0.1
    found = pull_silhouettes(subject.session, subject.geometry, subject.session.light.centre)
    ends = subject.geometry.points_ws.numpy()[found.ends].astype(float)
    pixels = to_pixels(shot.view, project(shot.view, ends.mean(axis=1))).astype(int)
    assert np.mean([changed[y - 1 : y + 2, x - 1 : x + 2].any() for x, y in pixels]) > 0.6
    assert changed.mean() < 0.3


# ---- in space ----


def test_frustum_corners_are_where_the_free_camera_projects_them(files: Path) -> None:
    subject = make(files, "box", "projection.splits=1")  # or the next split's wires would lie over the first one's
    shot = subject.shot("third")
    image = picture(space.frusta(subject))
    (frustum,) = subject.frusta
    corners = np.unique(edges(frustum).reshape(-1, 3), axis=0)
    pixels = to_pixels(shot.view, project(shot.view, corners)).astype(int)
    inside = ((pixels >= 1) & (pixels < [89, 59])).all(axis=1)
    red = (image[..., 0] > image[..., 1] + 0.15) & (image[..., 0] > image[..., 2] + 0.15)
    near = [red[y - 1 : y + 2, x - 1 : x + 2].any() for x, y in pixels[inside]]
    assert inside.sum() >= 4 and np.mean(near) > 0.7  # a hidden corner may lie in the gap between two dashes


def test_intersection_bodies_cover_the_scene_behind_them(box: Subject) -> None:
    shot = box.shot("third")
    image, plain = picture(space.intersection_bodies(box)), surfaces.base(shot)
    inside, _ = box.in_eye_view(shot.position)
    receives = inside & (shot.flags > 0)
    changed = np.abs(image - plain).max(axis=-1) > 0.02
    assert changed[receives].mean() > 0.95  # B holds all that the eye sees
    assert not changed[0, 0] and len(box.light_bodies) == 3
    assert all(body.volume > part.volume for body, part in zip(box.light_bodies, box.parts, strict=True))


def test_the_minimap_holds_the_eyes_picture_and_its_place(box: Subject) -> None:
    shot = box.shot("third")
    image = picture(space.minimap(box))
    inset = space._smaller(surfaces.base(box.shot("eye")), int(space.INSET * 90), int(0.45 * 60))
    rows, columns = inset.shape[:2]
    assert any(
        np.array_equal(image[y : y + rows, x : x + columns], inset)
        for y in range(60 - rows + 1)
        for x in range(90 - columns + 1)
    )
    x, y = to_pixels(shot.view, project(shot.view, box.eye.eye_ws[None]))[0].astype(int)
    patch = image[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3)
    assert (patch[:, 0] - patch[:, 2]).max() > 0.4  # orange, but for the lines that meet there


# ---- the maps ----


def test_depth_is_grey_between_white_and_black(box: Subject) -> None:
    size = light_maps.panel_size(3)
    image = picture(light_maps.depth_map(box), 1)[3:-3, 3:-3]
    depth = box.map_depth
    known = depth[np.isfinite(depth)]
    pick = ((np.arange(size) + 0.5) * 128 / size).astype(int)
    own = depth[1][pick][:, pick]
    grey = 0.96 - 0.86 * (own - known.min()) / (known.max() - known.min())
    np.testing.assert_allclose(image[np.isfinite(own)][:, 0], grey[np.isfinite(own)], rtol=1e-5)
    np.testing.assert_allclose(image[np.isinf(own)], np.broadcast_to(light_maps.EMPTY, (np.isinf(own).sum(), 3)))


def test_texels_inside_the_body_are_those_in_the_hull_of_its_projection(box: Subject) -> None:
    for layer in range(3):
        h = project(box.views[layer], box.parts[layer].vertices)
        hull = Delaunay(h[:, :2] / h[:, 3:])
        centre = (np.arange(128) + 0.5) / 64 - 1.0
        places = np.stack(np.meshgrid(centre, -centre), axis=-1)
        expected = hull.find_simplex(places) >= 0
        found = light_maps.texels_inside(box, layer)
        assert (found != expected).mean() < 1e-3 and 0.05 < found.mean() < 0.99
        read = light_maps.texels_read(box)[layer]
        assert read.any() and found[read].mean() > 0.98  # what the eye reads lies in B, but for rounding at its rim


def test_light_views_show_the_frustum_and_the_ground(box: Subject) -> None:
    sheet = light_maps.light_views(box)
    assert len(sheet.panels) == 3
    image = picture(sheet, 0)[3:-3, 3:-3]
    blue = (image[..., 2] > 0.75) & (image[..., 0] < 0.4)
    columns = np.nonzero(blue.sum(axis=0) > 40)[0]
    assert len(columns) and np.ptp(columns) < 8  # the view vector runs straight up
    dark = image.max(axis=-1) < 0.25
    assert dark.mean() > 0.002


@pytest.mark.parametrize("warp", ["none", "lispsm_nopt", "psm"])
def test_measured_errors_are_the_closed_form_where_it_holds(files: Path, warp: str) -> None:
    subject = make(files, "wide", f"projection.warp={warp}", "image={width: 64, height: 64}")
    found = error_plot.curves(subject)
    closed = error_plot.closed_form(subject, found.borders)
    assert not isinstance(closed, str), closed
    np.testing.assert_allclose(found.borders[[0, -1]], [1.0, 40.0])
    margin = 128.0 / 126.0  # the maps leave a texel at either side
    for measured, exact in ((found.m_x, closed[1]), (found.m_z, closed[2])):
        np.testing.assert_allclose(measured, margin * exact, rtol=2e-5)  # a hair off the borders
    sheet = error_plot.perspective_error(subject)
    assert "closed form" in sheet.notes[-1] and np.unique(picture(sheet).reshape(-1, 3), axis=0).shape[0] > 10


def test_both_sides_of_a_border_are_measured(files: Path) -> None:
    subject = make(files, "box", "projection.warp=none")
    found = error_plot.curves(subject)
    for i, border in enumerate(found.borders[1:-1], start=1):
        before, behind = i * error_plot.STEPS - 1, i * error_plot.STEPS
        assert found.z[before] < border < found.z[behind]
        assert abs(found.m_z[before] / found.m_z[behind] - 1.0) > 0.05
    assert error_plot.closed_form(subject, found.borders) == "the light is not in the plane of view and up vector"


# ---- every projection ----


@pytest.mark.parametrize(
    ("light", "projection", "layers"),
    [
        ("{kind: point, position: [0.5, 1.2, 1.5]}", "{fit: focused, splits: 2}", 6),
        ("{kind: point, position: [0.5, 9, 1.5]}", "{fit: focused, splits: 2, warp: psm}", 2),
        ("{kind: directional, direction: [0, -1, 0]}", "{fit: focused, splits: 2, stabilise: exact}", None),
        ("{kind: directional, direction: [0, -1, 0]}", "{fit: scene}", 1),
    ],
)
def test_every_kind_works_for_every_projection(files: Path, light: str, projection: str, layers: int | None) -> None:
    subject = make(files, "box", f"scene.lights=[{light}]", f"projection={projection}")
    assert layers is None or len(subject.views) == layers
    for name, draw in render._DRAW.items():
        sheet = draw(subject)
        assert all(np.isfinite(panel.image).all() for panel in sheet.panels), name
    assert len(subject.parts) == len(subject.ranges) == len(subject.views)


@pytest.mark.parametrize(
    ("reference", "words"), [("{light: centre}", "the light's centre"), ("{samples: 9}", "9 points of the light")]
)
def test_the_difference_is_to_what_the_reference_asks_for(files: Path, reference: str, words: str) -> None:
    subject = make(files, "box", f"reference={reference}")
    truth = subject.truth("third")
    between = (truth > 0.0) & (truth < 1.0)
    assert words in subject.truth_in_words and between.any() == ("9" in words)


def test_a_raised_near_plane_is_where_bodies_and_splits_begin(files: Path) -> None:
    user, auto = (make(files, "box", f"projection.near={near}") for near in ("user", "auto"))
    seen = auto.shot("eye").depth
    assert user.depths[0] < 0.9 * auto.depths[0] == pytest.approx(0.9 * seen.min(), rel=1e-6)
    assert auto.eye.near == auto.depths[0]

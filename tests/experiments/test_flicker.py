"""The flicker score of hard shadows: its floor, and what stabilisers do to it (Stingl 2011, section 3.5)."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pandas as pd
import pytest
import small_scenes

from algorithms.plugins import load_all
from algorithms.projections.composition import compose
from experiments.metrics.carry_over import carry_over
from experiments.metrics.registry import Measured, beside_hard_edge, evaluate
from experiments.results.store import FRAME_COLUMNS
from experiments.results.summary import summarise
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight
from wkernels.scene.model import Camera, Scene
from wkernels.scene.views import eye_view

WIDTH, HEIGHT, FRAMES = 192, 108, 8
AT_LEAST = 5.0
RAYS = "ray_cast_point_shadow"


def translating(frame: int) -> Camera:
    eye = np.array([-2.5 + 0.11 * frame, 4.2, 6.0 - 0.07 * frame])
    return Camera(eye, eye + np.array([0.2, -0.8, -1.0]), np.array([0.0, 1.0, 0.0]), 45.0, 0.1, 60.0)


@functools.cache
def scene() -> Scene:
    """Boxes that float over ground: every edge in the picture is a shadow's or a silhouette."""
    meshes = [
        small_scenes.mesh("ground", small_scenes.plane(60.0), casts=False),
        small_scenes.mesh("boxes", small_scenes.random_boxes(10, seed=4), receives=False),
    ]
    return small_scenes.scene(meshes, DirectionalLight(direction=np.array([0.4, -1.0, 0.25])), translating)


@functools.cache
def flicker(technique: str, device: str, splits: int = 1, stabilise: str = "none", resolution: int = 128) -> float:
    """Root mean square over a walkthrough's frames, so that a jump on few of them counts."""
    chosen: Any = load_all()[technique]
    projection, params = None, {}
    if technique != RAYS:
        projection = compose({"fit": "focused", "splits": splits, "stabilise": stabilise})
        params = {"resolution": resolution}
    session = Session(Geometry(scene(), device), width=WIDTH, height=HEIGHT, device=device, projection=projection)
    instance, before, scores = chosen(chosen.Params(**params)), None, []
    for frame in range(FRAMES):
        session.begin(frame)
        now = session.render(instance)
        session.advance()
        if before is not None:
            view = eye_view(translating(frame - 1), WIDTH, HEIGHT, np.zeros(3))
            carried = carry_over(before.visibility, before.world_position, view.ws_to_ss, now.world_position)
            score = evaluate(frozenset({"flicker"}), Measured(now.visibility, previous=carried))["flicker"]
            assert score is not None
            scores.append(score)
        before = now
    return float(np.sqrt(np.mean(np.square(scores))))


def test_rays_do_not_flicker(device: str) -> None:
    """One ray a pixel changes beside edges and where shadows are thinner than a pixel, which is the score's floor."""
    assert flicker(RAYS, device) < 0.004


@pytest.mark.parametrize("stabilise", ["exact", "approximate"])
@pytest.mark.parametrize("splits", [1, 3])
def test_stabilisers_reduce_flicker_by_five_at_equal_splits(splits: int, stabilise: str, device: str) -> None:
    resolution = 128 if splits == 1 else 48  # texels of several pixels in the nearest split too
    unstable = flicker("shadow_map", device, splits, "none", resolution)
    stable = flicker("shadow_map", device, splits, stabilise, resolution)
    assert unstable > AT_LEAST * flicker(RAYS, device)  # there is something to reduce
    assert unstable > AT_LEAST * stable


def test_flicker_grows_with_the_texels(device: str) -> None:
    coarse, fine = flicker("shadow_map", device), flicker("shadow_map", device, resolution=256)
    assert coarse > 3.0 * fine > 3.0 * flicker(RAYS, device)


def test_edges_are_those_between_neighbours_that_differ_by_more_than_a_half() -> None:
    image = np.ones((5, 7), np.float32)
    image[2, 3], image[0, 0], image[4, :] = 0.4, np.nan, 0.6
    expected = np.zeros((5, 7), dtype=bool)
    expected[2, 2:5] = expected[1, 3] = expected[3, 3] = True
    np.testing.assert_array_equal(beside_hard_edge(image), expected)


def test_a_step_of_one_pixel_is_not_flicker_and_one_of_several_is() -> None:
    def moved(edge: int) -> np.ndarray:
        return np.where(np.arange(40)[None] < edge, 0.0, 1.0).repeat(8, axis=0)

    def score(previous: np.ndarray) -> float | None:
        return evaluate(frozenset({"flicker"}), Measured(moved(20), previous=previous))["flicker"]

    assert score(moved(21)) == score(moved(19)) == 0.0
    # of the six pixels between the edges one lies beside today's; two of each of the eight rows do in all
    assert score(moved(26)) == pytest.approx(np.sqrt(5.0 / 38.0))
    penumbra = np.linspace(0.0, 1.0, 40)[None].repeat(8, axis=0)
    assert evaluate(frozenset({"flicker"}), Measured(penumbra, previous=penumbra + 0.1))["flicker"] == pytest.approx(
        0.1
    )


def test_flicker_with_edges_counts_a_hard_edge_that_moves_and_flicker_does_not() -> None:
    """A hard edge that jumps by a pixel column in an image of 100: one pixel in 100 changes by 1."""
    image = np.tile(np.repeat([0.0, 1.0], 50), (20, 1))
    moved = np.roll(image, 1, axis=1)
    moved[:, 0] = 0.0
    measured = Measured(moved, previous=np.where(beside_hard_edge(image), np.nan, image), previous_across_edges=image)
    scores = evaluate(frozenset({"flicker", "flicker_edges"}), measured)
    assert scores["flicker"] == 0.0 and scores["flicker_edges"] == pytest.approx(0.1)


def test_rounding_is_no_flicker() -> None:
    image = np.full((8, 8), 0.5, np.float32)
    for change, expected in ((1e-17, 0.0), (1e-7, 0.0), (1e-3, 1e-3)):
        score = evaluate(frozenset({"flicker"}), Measured(image, previous=image.astype(float) + change))["flicker"]
        assert score == pytest.approx(expected, rel=1e-3, abs=0.0)


NAN = float("nan")


@pytest.mark.parametrize(
    ("flicker", "edges", "median"),
    [
        ([NAN, 0.0, 0.0], [NAN, 0.1, 0.2], NAN),  # hard shadows of a moving eye
        ([NAN, 0.0, 0.0], [NAN, NAN, NAN], NAN),  # nothing is known of their edges
        ([NAN, 0.0, 0.0], [NAN, 0.0, 0.0], 0.0),  # nothing moves
        ([NAN, 0.0, 0.3], [NAN, 0.1, 0.4], 0.15),  # an edge jumped on one frame: the others count
        ([NAN, 0.01, 0.03], [NAN, 0.02, 0.03], 0.02),
        ([NAN, NAN, NAN], [NAN, NAN, NAN], NAN),
    ],
)
def test_summaries_leave_flicker_empty_where_all_change_is_beside_edges(
    flicker: list[float], edges: list[float], median: float
) -> None:
    frames = pd.DataFrame(np.nan, index=range(3), columns=list(FRAME_COLUMNS))
    frames = frames.assign(label="a", technique="t", frame=range(3), frame_ms=1.0, shadow_ms=1.0)
    frames = frames.assign(flicker=flicker, flicker_edges=edges)
    row = summarise(frames, "a").iloc[0]
    np.testing.assert_equal(row["flicker"], median)
    assert np.isnan(row["flicker_q3"]) == np.isnan(median)

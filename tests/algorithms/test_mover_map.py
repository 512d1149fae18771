"""A second map at the light's centre, of moving casters alone (Scherzer et al. 2009, section 5), in both shadow buffers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp
from compare import assert_twin
from sessions import open_session, render_frames, small_technique, true_visibility, walk

from wkernels.device.launch import launch
from wkernels.light_maps.light_map import depths_on_host
from wkernels.scene.model import Mesh, Scene
from wkernels.temporal.shadow_buffer import mover_shadow
from wkernels.temporal.shadow_buffer.mover_shadow import OVERLAPS, join_error, join_hidden, mover_regions

BOTH = ("tc_soft_paper", "tc_soft_thesis")
LAMP = small.light("rectangle", (2.0, 8.0, 1.0), 2.0)
PLAIN = {"overscan": 0.0}
OWN = {**PLAIN, "mover_map": "centre"}


def slide(frame: int) -> np.ndarray:
    out = np.eye(4)
    out[0, 3] = 0.15 * frame
    return out


def overlapping(lamp: Any = LAMP, **mover: Any) -> Scene:
    """A high plate that stands, and a low one that moves; neither receives, nor do they fill the map's view."""
    low = small.mesh("low", small.plane(1.4, 1.5, (0.0, 0.6)), receives=False)
    return small.scene(
        [
            replace(low, object_to_ws=slide, moving=True, **mover),
            small.mesh("ground", small.plane(12.0), casts=False),
            small.mesh("high", small.plane(2.0, 4.0, (0.5, 0.2)), receives=False),
        ],
        lamp,
    )


def only(scene: Scene, *names: str) -> Scene:
    def chosen(mesh: Mesh) -> Mesh:
        return replace(mesh, casts=mesh.casts and mesh.name in names)

    return replace(scene, meshes=tuple(chosen(mesh) for mesh in scene.meshes))


# ---- the maps -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", [None, {"fit": "focused", "splits": 3}])
def test_maps_hold_the_casters_that_are_asked_for(projection: dict[str, Any] | None, device: str) -> None:
    """Bit for bit those of scenes that have no others; triangles that stand come before those that move."""
    scene = small.cluttered(LAMP)
    moves = replace(scene.meshes[0], moving=True)
    scene = replace(scene, meshes=(moves, *scene.meshes[1:]))
    names = {"all": tuple(m.name for m in scene.meshes), "still": ("boxes", "sphere"), "moving": ("terrain",)}
    for casters, wanted in names.items():
        session = open_session(scene, device, projection=projection)
        views = session.light_map(64, caster_set=casters).map
        alone = open_session(only(scene, *wanted), device, projection=projection)
        expected, found = depths_on_host(alone.light_map(64).map), depths_on_host(views)
        np.testing.assert_array_equal(found, expected)
        assert np.isfinite(found).any() and found.shape[0] == (3 if projection else 1)
    geometry = session.geometry
    assert len(geometry.caster_sets["still"]) == 3 * geometry.still_triangles > 0
    assert len(geometry.caster_sets["moving"]) == 3 * (geometry.caster_triangles - geometry.still_triangles) > 0


def test_the_region_of_movers_holds_all_of_their_texels(device: str) -> None:
    for lamp in (LAMP, small.light("directional", (2.0, 8.0, 1.0)), small.light("sphere", (0.2, 1.6, 0.5), 0.3)):
        session = open_session(overlapping(lamp), device)
        light_map = session.light_map(128, caster_set="moving").map
        regions = mover_regions(session, light_map)
        for layer, depth in enumerate(depths_on_host(light_map)):
            rows, columns = np.nonzero(np.isfinite(depth))
            if len(rows):
                x0, y0, x1, y1 = regions[layer]
                assert x0 <= columns.min() + 1 and y0 <= rows.min() + 1
                assert columns.max() <= x1 and rows.max() <= y1
    assert (mover_regions(open_session(only(overlapping(), "high"), device), light_map)[:, 0] > 100).all()


# ---- what is shown ------------------------------------------------------------------------------------------------------


@wp.kernel
def join(
    first: int, still: wp.array(dtype=float), moving: wp.array(dtype=float), error: wp.array(dtype=float), overlap: int,
    out: wp.array(dtype=float), error_out: wp.array(dtype=float),
):  # fmt: skip
    i = first + wp.tid()
    out[i] = join_hidden(still[i], moving[i], overlap)
    error_out[i] = join_error(error[i], still[i], moving[i], overlap)


@pytest.mark.parametrize("overlap", OVERLAPS)
def test_shares_of_both_are_joined(overlap: str, device: str) -> None:
    still, moving, error = np.random.default_rng(1).random((3, 200))
    inputs: list[Any] = [wp.array(a, dtype=float, device=device) for a in (still, moving, error)]
    out = [wp.empty(200, dtype=float, device=device) for _ in range(2)]
    launch(join, 200, [*inputs, OVERLAPS[overlap]], out, device=device)
    if overlap == "product":
        assert_twin(out[0].numpy(), still * moving)
        assert_twin(out[1].numpy(), error * moving)
    else:
        assert_twin(out[0].numpy(), np.minimum(still, moving))
        assert_twin(out[1].numpy(), np.where(still <= moving, error, 0.0))


@pytest.mark.parametrize("overlap", OVERLAPS)
@pytest.mark.parametrize("name", BOTH)
def test_it_is_the_picture_of_still_casters_behind_pcss_of_moving_ones(name: str, overlap: str, device: str) -> None:
    """Each part rendered by itself, in a scene that has no other casters, and joined by NumPy."""
    scene = overlapping()
    (*_, result) = walk(scene, device, name, 6, mover_overlap=overlap, **OWN)
    (*_, still) = walk(only(scene, "high"), device, name, 6, **PLAIN)
    session = open_session(only(scene, "low"), device)
    session.begin(5)
    moving = session.render(small_technique("pcss")).visibility
    assert ((moving > 0.0) & (moving < 1.0) & (still.visibility < 1.0)).sum() > 40
    expected = np.minimum(still.visibility, moving) if overlap == "max" else still.visibility * moving
    np.testing.assert_allclose(result.visibility, expected, atol=1e-6)
    assert result.standard_error is not None and still.standard_error is not None
    error = np.where(still.visibility <= moving, still.standard_error, 0.0) if overlap == "max" else None
    expected = still.standard_error * moving if error is None else error
    assert np.nanmean(np.abs(result.standard_error - expected) > 1e-6) < 1e-3  # a tie of the filtered with PCSS


@pytest.mark.parametrize("name", BOTH)
def test_pixels_beside_the_movers_region_have_no_need_of_it(
    name: str, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    images = []
    for everywhere in (False, True):
        if everywhere:
            monkeypatch.setattr(mover_shadow, "mover_regions", lambda frame, m: np.array([[-1e9, -1e9, 1e9, 1e9]]))
        images.append(walk(overlapping(), device, name, 3, **OWN)[-1].visibility)
    np.testing.assert_array_equal(*images)


@pytest.mark.parametrize("name", BOTH)
def test_no_mover_makes_a_still_pixel_start_anew(name: str, device: str) -> None:
    """Under the moving plate and beside it every pixel has a test of every frame; without the second map it has none."""
    frames = 8
    held = {}
    for mover_map in ("none", "centre"):
        session = open_session(overlapping(), device)
        made = small_technique(name, mover_map=mover_map, movers="disocclude", **PLAIN)
        render_frames(session, made, frames)
        held[mover_map] = session.history("shadow buffer", lambda: None).previous.numpy()[..., 1]
    receives = held["centre"] > 0.0
    assert (held["centre"][receives] == frames).mean() > 0.95, "all but what the plate has uncovered itself"
    assert (held["none"][receives] == 0.0).sum() > 50


@pytest.mark.parametrize("name", BOTH)
def test_a_mover_that_leaves_takes_its_shadow_along(name: str, device: str) -> None:
    """The next frame has not a trace of it."""

    def away(frame: int) -> np.ndarray:
        out = np.eye(4)
        out[0, 3] = 0.0 if frame < 6 else 200.0
        return out

    scene = overlapping()
    scene = replace(scene, meshes=(replace(scene.meshes[0], object_to_ws=away), *scene.meshes[1:]))
    (*_, before, after) = walk(scene, device, name, 7, **OWN)
    (*_, still) = walk(only(scene, "high"), device, name, 7, **PLAIN)
    np.testing.assert_array_equal(after.visibility, still.visibility)
    assert np.nansum(after.visibility - before.visibility) > 10.0


@pytest.mark.parametrize("name", BOTH)
def test_it_is_nearer_to_the_truth_under_movers(name: str, device: str) -> None:
    """By a margin, and with less flicker where moving and static penumbrae overlap (section 4.1)."""
    scene = overlapping()
    frames = 16
    now, still, moving = (
        true_visibility(s, device, frames - 1) for s in (scene, only(scene, "high"), only(scene, "low"))
    )
    near = moving < 1.0
    rmse = {}
    for label, params in {"none": PLAIN, "product": OWN, "max": {**OWN, "mover_overlap": "max"}}.items():
        error = walk(scene, device, name, frames, resolution=512, **params)[-1].visibility - now
        rmse[label] = float(np.sqrt(np.mean(error[near] ** 2)))
    print(name, rmse)
    assert rmse["product"] < 0.7 * rmse["none"] and rmse["max"] < 0.9 * rmse["none"]
    # what the parts cannot know: max is never too dark
    both = (still < 1.0) & near
    assert both.sum() > 50
    assert (np.minimum(still, moving) - now)[both].min() >= -0.02
    errors = [np.sqrt(np.mean((shown - now)[both] ** 2)) for shown in (still * moving, np.minimum(still, moving))]
    assert errors[0] < 0.1, errors


@pytest.mark.parametrize("name", BOTH)
def test_where_nothing_moves_there_is_no_second_map(name: str, device: str) -> None:
    scene = small.cluttered(LAMP)
    images = [walk(scene, device, name, 3, mover_map=m, **PLAIN)[-1] for m in ("none", "centre")]
    np.testing.assert_array_equal(images[0].visibility, images[1].visibility)
    assert ("map of moving casters", "no caster moves", 1) in images[1].left_out
    everything = walk(scene, device, name, 3, {"skips": False}, **OWN)[-1]
    np.testing.assert_array_equal(everything.visibility, images[1].visibility)
    np.testing.assert_array_equal(everything.standard_error, images[1].standard_error)
    assert not everything.left_out

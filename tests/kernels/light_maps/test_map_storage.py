"""Where the layers of a light map lie: pictures do not depend on it, and filters stay in their tile."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import small_scenes as small
import warp as wp

from algorithms.plugins import find
from algorithms.projections.composition import compose
from wkernels.errors import InputError
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import depths_on_host, layout_of
from wkernels.light_maps.storage import PAGE, PLACES, allocate, lay_out, layer_images, layers_on_host
from wkernels.raster import Rasteriser
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import Light, SphereLight

SPLIT = {"fit": "focused", "splits": 4, "scheme": "log"}
SUN, LAMP = small.light("directional"), small.light("rectangle")
INSIDE = SphereLight(center=np.array([0.2, 3.2, 1.5]), radius=0.2)  # six faces
TECHNIQUES: list[tuple[str, dict[str, Any]]] = [
    ("shadow_map", {}),
    ("pcf", {"radius": 3.0}),
    ("pcf", {"radius": 60.0, "taps": 64}),  # far wider than a tile of 64 texels
    ("pcf", {"radius": 60.0, "taps": 64, "bilinear": False}),
    ("pcf_poisson", {"radius": 20.0}),
    ("pcf_blocker_skip", {"radius": 20.0}),
    ("pcss", {}),
    ("vsm", {}),
    ("vsm", {"taps": 101}),
    ("vsm", {"slope_variance": True}),
    ("vsm", {"width": "pcss"}),
    ("tc_soft_paper", {}),
    ("multi_shadow_map", {"samples": 3}),
    ("projection_aliasing_mitigation", {}),
]


def session(light: Light, device: str, moving: bool = False, **projection: Any) -> Session:
    scene = small.cluttered(light)
    if moving:
        boxes = small.mesh("boxes", small.random_boxes(9, 2), moving=True)
        scene = small.scene([small.mesh("ground", small.plane(14.0)), boxes], light)
    geometry = Geometry(scene, device)
    return Session(geometry, width=100, height=60, device=device, projection=compose(projection))


@pytest.mark.parametrize("storage", PLACES)
@pytest.mark.parametrize("layers", [1, 3, 4, 6, 9, 16])
@pytest.mark.parametrize("resolution", [1, 7, 64])
def test_every_texel_of_a_layer_has_a_place_of_its_own(storage: str, layers: int, resolution: int) -> None:
    layout = lay_out(storage, layers, resolution)
    rows = np.arange(resolution)
    places = np.array(layout.begin)[:, None, None] + rows[:, None] * layout.pitch + rows
    assert len(np.unique(places)) == layers * resolution**2
    assert places.min() >= 0 and places.max() < layout.texels
    room = PLACES[storage]
    if room is not None and layers > room:
        assert layout == lay_out("array", layers, resolution)
    elif storage == "separate":
        assert all(begin % PAGE == 0 for begin in layout.begin) and layout.texels % PAGE == 0
    else:
        assert layout.texels == (room or layers) * resolution**2
    if storage.startswith("atlas") and room is not None and layers <= room:
        across = int(np.sqrt(room))
        assert layout.pitch == across * resolution
        rows, columns = np.divmod(layout.begin, layout.pitch)
        np.testing.assert_array_equal(rows // resolution * across + columns // resolution, np.arange(layers))


def test_layers_are_views_of_the_texels(device: str) -> None:
    layout = lay_out("atlas4", 3, 5)
    texels = allocate(layout, wp.vec2, device)
    assert texels.ptr % (4 * PAGE) == 0 and texels.size == 100
    texels.fill_(wp.vec2(-1.0, -1.0))
    for i, image in enumerate(layer_images(texels, layout)):
        image.fill_(wp.vec2(float(i), 2.0))
    host = layers_on_host(texels, layout)
    assert host.shape == (3, 5, 5, 2)
    np.testing.assert_array_equal(host[..., 0], np.broadcast_to(np.arange(3.0)[:, None, None], (3, 5, 5)))
    assert (texels.numpy() == -1.0).sum() == 50  # the fourth tile


@pytest.mark.parametrize("light", [SUN, LAMP], ids=["sun", "lamp"])
@pytest.mark.parametrize(("name", "params"), TECHNIQUES)
def test_pictures_do_not_depend_on_the_storage(name: str, params: dict[str, Any], light: Light, device: str) -> None:
    if name == "pcss" and not light.has_area:
        pytest.skip("needs a light with an area")
    plugin = find(name)
    technique = plugin(plugin.Params(resolution=64, **params))
    expected = session(light, device, **SPLIT).render(technique).visibility
    assert len(np.unique(expected[np.isfinite(expected)])) > 1
    for storage in ("array", "atlas4", "atlas9", "atlas16"):
        found = session(light, device, storage=storage, **SPLIT).render(technique).visibility
        np.testing.assert_array_equal(found, expected, err_msg=storage)


@pytest.mark.parametrize("storage", PLACES)
@pytest.mark.parametrize("tagged", [False, True])
@pytest.mark.parametrize("resolution", [6, 20, 64])
def test_maps_do_not_depend_on_the_storage(storage: str, tagged: bool, resolution: int, device: str) -> None:
    splits = {**SPLIT, "splits": 6} if storage == "cube6" else SPLIT
    made = [session(SUN, device, moving=True, storage=kind, **splits) for kind in ("separate", storage)]
    plain, found = (s.light_map(resolution, tag_moving_casters=tagged).map for s in made)
    np.testing.assert_array_equal(depths_on_host(found), depths_on_host(plain))
    assert not tagged or (depths_on_host(found) < 0.0).any()


def test_unused_tiles_are_neither_cleared_nor_drawn(device: str) -> None:
    running = session(SUN, device, storage="atlas16", **SPLIT)
    light_map = running.light_map(32).map
    light_map.depth.fill_(-7.0)
    running.begin(0)
    light_map = running.light_map(32).map
    depth = light_map.depth.numpy().reshape(128, 128)
    drawn = light_map.layers
    assert (depth[:32, : 32 * drawn] != -7.0).all()
    assert (depth[32:] == -7.0).all() and (depth[:32, 32 * drawn :] == -7.0).all()


def test_a_map_takes_what_its_storage_says(device: str) -> None:
    texels = {}
    for storage in ("separate", "array", "atlas4", "atlas9", "atlas16"):
        light_map = session(SUN, device, storage=storage, **SPLIT).light_map(40).map
        texels[storage] = layout_of(light_map).texels / 40**2
        assert light_map.depth.size == layout_of(light_map).texels
    layers = light_map.layers
    assert texels.pop("separate") == pytest.approx(layers * 2048 / 1600)  # whole pages
    assert texels == {"array": layers, "atlas4": 4, "atlas9": 9, "atlas16": 16}


def test_six_faces_go_into_a_cube_and_where_an_atlas_is_too_small_one_after_the_other(device: str) -> None:
    plugin = find("pcf")
    technique = plugin(plugin.Params(resolution=64))
    expected = session(INSIDE, device).render(technique).visibility
    for storage, texels in (("cube6", 6), ("atlas4", 6), ("atlas9", 9)):
        running = session(INSIDE, device, storage=storage)
        np.testing.assert_array_equal(running.render(technique).visibility, expected)
        light_map = running.light_map(64).map
        assert light_map.layers == 6 and light_map.depth.size == texels * 64**2


def test_an_atlas_has_a_largest_tile(device: str) -> None:
    running = session(SUN, device, storage="atlas16", **SPLIT)
    with pytest.raises(InputError, match=r"projection\.storage: 'atlas16' takes splits of at most 2048 texels"):
        running.light_map(2049)


@pytest.mark.parametrize("path", ["lanes", "tiles"])
@pytest.mark.parametrize("width", [8, 9, 40])
def test_drawing_into_a_part_of_an_image_leaves_the_rest(path: str, width: int, device: str) -> None:
    geometry = Geometry(small.cluttered(SUN), device)
    view = compose()(
        SUN.centre, geometry.bounds(receivers=True), geometry.bounds(casters=True), width, session(SUN, device).eye()
    )[0].to_device()
    rasteriser = Rasteriser(device, path=path)  # type: ignore[arg-type]
    whole = [wp.full((width, width), 5, dtype=kind, device=device) for kind in (float, int)]
    part = [wp.full((width, 3 * width), 5, dtype=kind, device=device) for kind in (float, int)]
    rasteriser.draw(geometry.points_ws, geometry.caster_indices, view, *whole)
    rasteriser.draw(geometry.points_ws, geometry.caster_indices, view, *(image[:, width : 2 * width] for image in part))
    for expected, found in zip(whole, part, strict=True):
        host = found.numpy()
        np.testing.assert_array_equal(host[:, width : 2 * width], expected.numpy())
        assert (host[:, :width] == 5).all() and (host[:, 2 * width :] == 5).all()
    assert np.isfinite(whole[0].numpy()).any()

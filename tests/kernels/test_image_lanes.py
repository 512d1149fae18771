"""Image passes in lanes against their plain twins: shading, tags of moving casters, the nearest blocker of a map."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes as small
import warp as wp

from wkernels.device.lanes import LANES, Floats, Ints, Vectors, flat_floats, runs_of
from wkernels.filters import blur
from wkernels.filters import penumbra as filtering
from wkernels.filters.penumbra import pull_footprint
from wkernels.frame.session import Session, shading
from wkernels.light_maps import drawing as light_map_drawing
from wkernels.light_maps.light_map import depths_on_host
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import SphereLight
from wkernels.scene.model import Scene

INSIDE = SphereLight(center=np.array([0.2, 3.2, 1.5]), radius=0.2)  # six faces


def in_both_ways(monkeypatch: pytest.MonkeyPatch, module: object, make: object) -> tuple[np.ndarray, np.ndarray]:
    out = []
    for lanes in (False, True):
        monkeypatch.setattr(module, "uses_lanes", lambda device, lanes=lanes: lanes)
        out.append(make())  # type: ignore[operator]
    return out[0], out[1]


def moving_scene(light: object) -> Scene:
    boxes = small.mesh("boxes", small.random_boxes(9, 2), moving=True)
    return small.scene([small.mesh("ground", small.plane(14.0)), boxes], light)


@pytest.mark.parametrize("width", [1, 15, 16, 17, 63, 130])
@pytest.mark.parametrize("kind", ["directional", "point"])
def test_shading(width: int, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def make() -> np.ndarray:
        session = Session(Geometry(small.cluttered(small.light(kind))), width=width, height=40)
        gbuffer = session.gbuffer()
        lit = wp.array(np.random.default_rng(1).random((40, width)), dtype=float, device="cpu")
        color = wp.zeros((40, width), dtype=wp.vec3, device="cpu")
        shading.shade(gbuffer, session.geometry.mesh_diffuse, session.light, lit, color, "cpu", 2)
        return color.numpy()

    plain, lanes = in_both_ways(monkeypatch, shading, make)
    np.testing.assert_allclose(lanes, plain, atol=2e-6)
    assert width == 1 or len(np.unique(plain)) > 20


@pytest.mark.parametrize("resolution", [4, 8, 100, 128])
@pytest.mark.parametrize("light", [small.light("directional"), INSIDE])
def test_tags_of_moving_casters(resolution: int, light: object, monkeypatch: pytest.MonkeyPatch) -> None:
    def make() -> np.ndarray:
        session = Session(Geometry(moving_scene(light)), width=16, height=16, threads=3)
        return depths_on_host(session.light_map(resolution, tag_moving_casters=True))

    plain, lanes = in_both_ways(monkeypatch, light_map_drawing, make)
    np.testing.assert_array_equal(lanes, plain)
    assert resolution < 64 or ((plain < 0.0).any() and (plain > 0.0).any())


@pytest.mark.parametrize("resolution", [8, 64, 100, 256])
@pytest.mark.parametrize("light", [small.light("rectangle"), INSIDE])
def test_the_nearest_blocker(resolution: int, light: object, monkeypatch: pytest.MonkeyPatch) -> None:
    def make() -> np.ndarray:
        session = Session(Geometry(moving_scene(light)), width=16, height=16, threads=2)
        light_map = session.light_map(resolution, tag_moving_casters=True)
        found = pull_footprint(session, light_map).nearest_depth.numpy().copy()
        np.testing.assert_array_equal(found, np.abs(depths_on_host(light_map)).min(axis=(1, 2)))
        return found

    plain, lanes = in_both_ways(monkeypatch, filtering, make)
    np.testing.assert_array_equal(lanes, plain)


@pytest.mark.parametrize("dtype", [wp.vec2, wp.vec4])
@pytest.mark.parametrize("shape", [(9, 16), (30, 33), (40, 100), (3, 500)])
@pytest.mark.parametrize("radius", [0, 2, 40])
def test_blur(dtype: type, shape: tuple[int, int], radius: int, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(3).normal(size=(*shape, dtype._length_)).astype(np.float32)  # type: ignore[attr-defined]

    def make() -> np.ndarray:
        image = wp.array(values, dtype=dtype, device="cpu")
        return blur.separable_blur(image, blur.gaussian_weights(radius), threads=2).numpy()

    plain, lanes = in_both_ways(monkeypatch, blur, make)
    np.testing.assert_allclose(lanes, plain, atol=1e-6)


def test_runs_are_the_memory_they_show() -> None:
    values = wp.array(np.arange(200, dtype=np.float32), dtype=float, device="cpu")
    runs = runs_of(values, Floats).numpy()
    assert runs.shape == (200 - int(LANES) + 1, int(LANES))
    np.testing.assert_array_equal(runs[37], np.arange(37, 37 + int(LANES)))
    points = wp.array(np.arange(300, dtype=np.float32).reshape(100, 3), dtype=wp.vec3, device="cpu")
    np.testing.assert_array_equal(runs_of(points, Vectors).numpy()[6], np.arange(6, 6 + 3 * int(LANES)))
    np.testing.assert_array_equal(flat_floats(points).numpy(), np.arange(300))
    assert runs_of(wp.zeros(5, dtype=int, device="cpu"), Ints).shape == (0,)

"""Generators: found by scan, deterministic, of the stated sizes and triangle counts, closed where they say so."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
import trimesh

from experiments.scenes import generators
from experiments.scenes.generators import _shapes
from experiments.scenes.generators._paris_houses import blocks

NAMES = generators.names()
OPEN = {"ground", "river", "windows", "terrain", "needles", "floor", "wall", "plane", "leaves"}


def bounds(meshes) -> np.ndarray:
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def count(meshes) -> int:
    return sum(len(mesh.faces) for mesh in meshes)


def test_the_scan_finds_every_generator():
    assert {"paris", "winter", "overlap", "test_plane", "light_close_to_blocker", "elongated_along_axis"} <= set(NAMES)
    assert not any(name.startswith("_") for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_signature(name: str):
    parameters = inspect.signature(generators.load(name)).parameters
    assert list(parameters)[:2] == ["seed", "triangles"]
    assert all(p.kind is p.KEYWORD_ONLY and p.default is not p.empty for p in parameters.values())
    generators.parameters_model(name)(generate=name)  # the defaults are within the ranges


@pytest.mark.parametrize("name", NAMES)
def test_meshes_are_sound_and_repeatable(name: str):
    meshes, again = generators.load(name)(seed=5), generators.load(name)(seed=5)
    assert len({mesh.name for mesh in meshes}) == len(meshes)
    for mesh, twin in zip(meshes, again, strict=True):
        assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int32
        assert np.all(np.isfinite(mesh.vertices))
        assert mesh.faces.min() == 0 and mesh.faces.max() == len(mesh.vertices) - 1
        assert mesh.vertices.tobytes() == twin.vertices.tobytes() and mesh.faces.tobytes() == twin.faces.tobytes()
        assert all(0.0 <= c <= 1.0 for c in mesh.diffuse)
        if mesh.name not in OPEN:
            shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
            assert shape.is_watertight and shape.is_winding_consistent, mesh.name
            assert shape.volume > 0.0, mesh.name


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("factor", [0.7, 1.0, 2.0])
def test_triangle_target_is_met_within_one_percent(name: str, factor: float):
    generate = generators.load(name)
    target = round(factor * inspect.signature(generate).parameters["triangles"].default)
    assert count(generate(triangles=target)) == pytest.approx(target, rel=0.01)


@pytest.mark.parametrize(
    ("name", "target", "size"), [("paris", 255_000, (850, 330, 800)), ("winter", 380_000, (500, 100, 500))]
)
def test_stated_sizes(name: str, target: int, size: tuple[float, float, float]):
    for seed in (1, 2):
        meshes = generators.load(name)(seed=seed)
        assert count(meshes) == pytest.approx(target, rel=0.001)
        low, high = bounds(meshes)
        np.testing.assert_allclose(high - low, size, rtol=1e-3)
        assert low[1] == 0.0


def test_default_counts_of_the_others():
    assert count(generators.load("test_plane")()) == 2044
    assert count(generators.load("overlap")()) == pytest.approx(70_000, rel=0.01)


def test_seed_changes_random_scenes():
    for name in ("paris", "winter", "overlap", "test_plane"):
        one, two = generators.load(name)(seed=1), generators.load(name)(seed=2)
        different = [
            a.vertices.shape != b.vertices.shape or not np.array_equal(a.vertices, b.vertices)
            for a, b in zip(one, two, strict=True)
        ]
        assert any(different), name


def test_paris_is_flat_with_one_tall_tower():
    meshes = {mesh.name: mesh for mesh in generators.load("paris")()}
    for name in ("ground", "river"):
        np.testing.assert_array_equal(meshes[name].vertices[:, 1], 0.0)
    ground = np.concatenate([meshes[n].vertices[meshes[n].faces] for n in ("ground", "river")])
    area = 0.5 * np.linalg.norm(np.cross(ground[:, 1] - ground[:, 0], ground[:, 2] - ground[:, 0]), axis=1).sum()
    assert area == pytest.approx(850.0 * 800.0)  # no gap, no overlap
    tallest = {name: mesh.vertices[:, 1].max() for name, mesh in meshes.items()}
    assert tallest.pop("tower") == 330.0
    assert max(tallest.values()) < 45.0
    assert len(blocks()) >= 40


def test_winter_has_hills_and_trees_and_cabins():
    meshes = {mesh.name: mesh for mesh in generators.load("winter")()}
    assert np.ptp(meshes["terrain"].vertices[:, 1]) > 50.0
    assert {"cabins", "foliage", "needles", "trunks"} <= set(meshes)
    few = {mesh.name: len(mesh.faces) for mesh in generators.load("winter")(cabins=2)}
    assert few["cabins"] / 2 == len(meshes["cabins"].faces) / 9


@pytest.mark.parametrize(
    ("shape", "volume", "bodies"),
    [
        (_shapes.beams(np.array([[0.0, 0, 0], [1, 1, 1]]), np.array([[0.0, 5, 0], [4, 1, 5]]), 0.5), 2.5, 2),
        (_shapes.boxes(np.array([[0.0, 0, 0], [9, 0, 0]]), np.array([[1.0, 2, 3]]), 0.7), 12.0, 2),
        (_shapes.lathe([(1.0, 0.0), (1.0, 2.0)], 256), 2 * np.pi, 1),
        (_shapes.torus(2.0, 0.5, 256, 128), np.pi**2, 1),
        (_shapes.cage(1.0, 0, 0.01), 30 * 1.0515 * 1e-4, 30),
        (_shapes.cones(np.array([[[1.0, 0, -1], [-1, 0, -1], [0, 0, 1]]]), np.array([[0.0, 3, 0]])), 2.0, 1),
    ],
)
def test_shapes_are_closed_and_of_the_right_volume(shape, volume: float, bodies: int):
    solid = trimesh.Trimesh(*shape, process=False)
    assert solid.is_watertight and solid.is_winding_consistent
    assert len(solid.split(only_watertight=False)) == bodies
    assert solid.volume == pytest.approx(volume, rel=2e-3)

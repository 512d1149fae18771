"""Closed forms against Monte Carlo over the very meshes and lights of configs/scenes/a*.yaml."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.scenes import analytic, load_scene

SCENES = Path(__file__).parents[2] / "configs" / "scenes"
SAMPLES = 1024


def blocked(start: np.ndarray, step: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segments (or rays, for t up to 1) start + t step, (n, 3), hit any of the triangles (k, 3, 3)."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(step[:, None], edge2)
    det = np.sum(p * edge1, axis=2)
    det = np.where(np.abs(det) < 1e-300, 1e-300, det)
    s = start[:, None] - corners[:, 0]
    u = np.sum(s * p, axis=2) / det
    q = np.cross(s, edge1)
    v = np.sum(step[:, None] * q, axis=2) / det
    t = np.sum(edge2 * q, axis=2) / det
    return np.any((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9) & (t < 1), axis=1)


def monte_carlo(scene, position: np.ndarray, seed: int) -> np.ndarray:
    """Share of ``SAMPLES`` independent light points that each of the positions (n, 3) sees."""
    rng = np.random.default_rng(seed)
    casters = [mesh for mesh in scene.meshes if mesh.casts]
    triangles = np.zeros((0, 3, 3))
    for mesh in casters:
        pose = mesh.object_to_ws(0)
        triangles = np.concatenate([triangles, (mesh.vertices @ pose[:3, :3].T + pose[:3, 3])[mesh.faces]])
    visible = np.empty(len(position))
    for i, point in enumerate(position):
        sample = scene.lights[0].sample(rng.uniform(size=(SAMPLES, 3)))
        step = (sample[:, :3] - point * sample[:, 3:]) * np.where(sample[:, 3:] > 0, 1.0, 100.0)
        visible[i] = 1.0 - blocked(np.tile(point, (SAMPLES, 1)), step, triangles).mean()
    return visible


def receivers(name: str, rng: np.random.Generator) -> np.ndarray:
    """Points on y = 0 where something happens."""
    n = 20 if name == "a3_coaxial_discs" else 40  # its occluder has many triangles
    reach = {"a3_coaxial_discs": 4.5, "a4_rectangle": 4.0, "a5_two_occluders": 4.0, "a8_box": 3.5}.get(name, 1.4)
    xz = rng.uniform(-reach, reach, (n, 2))
    if name == "a8_box":
        xz = xz[(np.abs(xz[:, 0]) > 0.5) | (np.abs(xz[:, 1]) > 1.0)]  # not inside of the box
    return np.stack([xz[:, 0], np.zeros(len(xz)), xz[:, 1]], axis=1)


@pytest.mark.parametrize("name", sorted(set(analytic.CLOSED_FORMS) - {"a9_tilted_plane"}))
def test_closed_form_is_what_the_scene_file_shows(name: str):
    scene = load_scene(SCENES / f"{name}.yaml")
    position = receivers(name, np.random.default_rng(7))
    expected = analytic.CLOSED_FORMS[name](position)
    measured = monte_carlo(scene, position, seed=11)
    error = np.sqrt(expected * (1.0 - expected) / SAMPLES)
    # 1e-3 stands for the corners that stand in for a circle, and for shares of less than one sample.
    np.testing.assert_array_less(np.abs(measured - expected), 4.0 * error + 1e-3)
    if name[:2] in ("a1", "a2", "a3", "a4", "a5"):
        assert np.count_nonzero((expected > 0.05) & (expected < 0.95)) > 7  # the penumbra is tested


@pytest.mark.parametrize("form", ["a1_half_plane", "a2_half_plane_disc", "a3_coaxial_discs", "a4_rectangle"])
def test_heights_above_the_plane_count(form: str):
    """The closed forms hold for receivers at any height below the occluder."""
    scene = load_scene(SCENES / f"{form}.yaml")
    rng = np.random.default_rng(3)
    position = rng.uniform([-2.0, 0.5, -2.0], [2.0, 3.0, 2.0], (12, 3))
    expected = analytic.CLOSED_FORMS[form](position)
    error = np.sqrt(expected * (1.0 - expected) / SAMPLES)
    np.testing.assert_array_less(np.abs(monte_carlo(scene, position, 5) - expected), 4.0 * error + 1e-3)


def test_known_values():
    at = lambda x, z=0.0: np.array([x, 0.0, z])  # noqa: E731
    assert analytic.a1_half_plane(at(0.0)) == 0.5
    assert analytic.a1_half_plane(at(0.5)) == 0.75
    assert analytic.a1_half_plane(at(0.5), light_size=1.0) == 1.0
    assert analytic.a2_half_plane_disc(at(0.0)) == pytest.approx(0.5)
    assert analytic.a2_half_plane_disc(at(-1.1)) == 0.0 and analytic.a2_half_plane_disc(at(1.1)) == 1.0
    assert analytic.a3_radii() == (2.0, 3.0, 4.0)
    assert analytic.a3_coaxial_discs(at(1.99)) == pytest.approx(0.0, abs=1e-12)
    assert analytic.a3_coaxial_discs(at(4.01)) == pytest.approx(1.0, abs=1e-12)
    assert 0.0 < analytic.a3_coaxial_discs(at(2.2)) < analytic.a3_coaxial_discs(at(3.8)) < 1.0
    assert analytic.a3_coaxial_discs(at(0.0), blocker_radius=0.25) == pytest.approx(1.0 - 0.5**2)
    assert analytic.a4_rectangle(at(0.0)) == 0.0
    assert analytic.a4_rectangle(at(0.0), blocker=((0.0, 9.0), (-9.0, 9.0))) == pytest.approx(0.5)
    assert analytic.a8_shadow_length(height=2.0, elevation_deg=45.0) == pytest.approx(2.0)
    end = 0.5 + analytic.a8_shadow_length()
    assert analytic.a8_box(at(end - 1e-6)) == 0.0 and analytic.a8_box(at(end + 1e-6)) == 1.0
    assert analytic.a8_box(at(-0.6)) == 1.0


def test_fusion_of_two_occluders_is_darker_than_either():
    """A5 has places in the umbra of both together but of neither alone."""
    x = np.linspace(-2.0, 2.0, 401)
    position = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    nowhere = ((90.0, 91.0), (90.0, 91.0))
    both = analytic.a5_two_occluders(position)
    first = analytic.a5_two_occluders(position, blockers=(analytic.A5_BLOCKERS[0], nowhere))
    second = analytic.a5_two_occluders(position, blockers=(nowhere, analytic.A5_BLOCKERS[1]))
    assert np.any((both == 0.0) & (first > 0.1) & (second > 0.1))
    assert np.all(both <= np.minimum(first, second) + 1e-12)


def test_shape_is_that_of_the_points():
    position = np.zeros((3, 5, 3))
    for form in analytic.CLOSED_FORMS.values():
        assert np.shape(form(position)) == (3, 5)

"""What each bias of a light map does: acne that goes away, and gaps that open (the analytic scenes A8 and A9)."""

from __future__ import annotations

import numpy as np
import pytest
import small_scenes
import warp as wp
from light_map_probe import compare, locate_all, make_bias, make_session, upload

from wkernels.device.launch import launch
from wkernels.light_maps.light_map import BIAS_CONSTANT, BIAS_NONE, BIAS_NORMAL, BIAS_SLOPE, Bias
from wkernels.scene.lights import DirectionalLight, PointLight
from wkernels.scene.model import Mesh

TILTS = [(0.0, 0.0), (15.0, 40.0), (40.0, 0.0), (60.0, 77.0), (75.0, 200.0), (84.0, 110.0)]


def tilted_plane(tilt_deg: float, turn_deg: float) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """The analytic scene A9: a square turned away from straight up, points on it, and its normal."""
    tilt, turn = np.radians([tilt_deg, turn_deg])
    normal = np.array([np.sin(tilt) * np.cos(turn), np.cos(tilt), np.sin(tilt) * np.sin(turn)])
    e_u = np.cross(normal, [0.3, 0.1, 1.0])
    e_u /= np.linalg.norm(e_u)
    e_v = np.cross(normal, e_u)
    vertices, faces = small_scenes.plane(8.0)
    vertices = vertices[:, :1] * e_u + vertices[:, 2:] * e_v
    st = np.random.default_rng(4).uniform(-3.9, 3.9, (6000, 2))
    return small_scenes.mesh("plane", (vertices, faces)), st[:, :1] * e_u + st[:, 1:] * e_v, normal


@pytest.mark.parametrize("light", ["directional", "perspective"])
@pytest.mark.parametrize("resolution", [16, 200, 1024])
@pytest.mark.parametrize(("tilt", "turn"), TILTS)
def test_slope_bias_leaves_no_acne_where_no_bias_does(
    tilt: float, turn: float, resolution: int, light: str, device: str
) -> None:
    plane, points, normal = tilted_plane(tilt, turn)
    lamp = DirectionalLight(direction=np.array([0.05, -1.0, 0.02]))
    session = make_session(
        [plane], lamp if light == "directional" else PointLight(position=np.array([1.0, 30.0, -2.0])), device
    )
    light_map = session.light_map(resolution).map
    normals = np.tile(normal, (len(points), 1))
    points = points - session.geometry.origin_ws

    def dark(bias: Bias) -> float:
        return float((compare(light_map, bias, points, normals, device)["nearest"] == 0.0).mean())

    assert dark(make_bias(BIAS_SLOPE, slope=1.1)) == 0.0
    assert dark(make_bias(BIAS_NONE)) > 0.05
    if tilt > 30.0:
        assert dark(make_bias(BIAS_SLOPE, slope=0.5)) > 0.02, "the least bias must be just about needed"


@pytest.mark.parametrize("kind", [BIAS_CONSTANT, BIAS_NORMAL])
def test_large_constant_and_normal_biases_clear_a_moderate_tilt(kind: int, device: str) -> None:
    plane, points, normal = tilted_plane(40.0, 25.0)
    session = make_session([plane], DirectionalLight(direction=np.array([0.0, -1.0, 0.0])), device)
    light_map = session.light_map(128).map
    normals = np.tile(normal, (len(points), 1))
    points = points - session.geometry.origin_ws
    inside = np.abs(points).max(axis=1) < 2.5
    assert (compare(light_map, make_bias(kind, 4.0), points, normals, device)["nearest"][inside] == 1.0).all()
    assert (compare(light_map, make_bias(kind, 0.1), points, normals, device)["nearest"][inside] == 0.0).any()


@pytest.mark.parametrize("elevation_deg", [30.0, 45.0, 65.0])
@pytest.mark.parametrize("footprints", [40.0, 80.0])
def test_a_constant_bias_opens_a_gap_at_a_wall(elevation_deg: float, footprints: float, device: str) -> None:
    """Stingl 2011, section 2.2.1: b / tan(elevation) for a bias that lifts the receiver by b; along the light b sin of that."""
    elevation = np.radians(elevation_deg)
    ground = small_scenes.mesh("ground", small_scenes.plane(12.0), casts=False)
    corners = np.array([(0.0, 0.0, -4.0), (0.0, 0.0, 4.0), (0.0, 3.0, 4.0), (0.0, 3.0, -4.0)])
    wall = small_scenes.mesh("wall", (corners, np.array([(0, 1, 2), (0, 2, 3)], dtype=np.int32)), receives=False)
    lamp = DirectionalLight(direction=np.array([np.cos(elevation), -np.sin(elevation), 0.0]))
    session = make_session([ground, wall], lamp, device)
    light_map = session.light_map(1024).map
    x = np.linspace(0.002, 5.9, 6000)
    points = np.stack([x, np.zeros_like(x), np.full_like(x, 0.1)], axis=1) - session.geometry.origin_ws
    normals = np.tile([0.0, 1.0, 0.0], (len(x), 1))
    found, density = wp.zeros(len(x), dtype=wp.vec4, device=device), wp.zeros(len(x), dtype=wp.vec2, device=device)
    launch(locate_all, len(x), [light_map, upload(points, device)], [found, density], device=device)
    footprint = 1.0 / float(density.numpy().min(axis=1)[0])
    dark = compare(light_map, make_bias(BIAS_CONSTANT, footprints), points, normals, device)["nearest"] == 0.0
    texel_on_ground = 2.0 * footprint / np.sin(elevation)
    depth_bias = footprints * footprint
    assert x[dark].min() == pytest.approx(depth_bias * np.cos(elevation), abs=texel_on_ground)
    assert x[dark].min() == pytest.approx((depth_bias * np.sin(elevation)) / np.tan(elevation), abs=texel_on_ground)
    assert x[dark].max() == pytest.approx(3.0 / np.tan(elevation), abs=texel_on_ground)
    no_gap = compare(light_map, make_bias(BIAS_SLOPE), points, normals, device)["nearest"] == 0.0
    assert x[no_gap].min() < texel_on_ground

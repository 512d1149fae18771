"""Kernels and host twins with which the tests of light maps ask for positions, planes and comparisons."""

from __future__ import annotations

import numpy as np
import small_scenes
import warp as wp

from wkernels.device.launch import launch
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import (
    Bias,
    LightMap,
    compare_bilinear,
    compare_nearest,
    locate,
    locate_receiver,
    plane_of_receiver,
    receiver_depth_at,
    stored_depth,
    texels_per_length,
)
from wkernels.projections.light_views import scene_views
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight, PointLight
from wkernels.scene.model import Mesh
from wkernels.scene.views import HostView

LIGHTS = {
    "directional": DirectionalLight(direction=np.array([0.3, -1.0, 0.2])),
    "perspective": PointLight(position=np.array([2.0, 9.0, -1.0])),
    "six faces": PointLight(position=np.array([0.2, 1.1, 0.3])),
}


@wp.kernel
def locate_all(
    first: int,
    light_map: LightMap,
    position_ws: wp.array(dtype=wp.vec3),
    found_out: wp.array(dtype=wp.vec4),
    density_out: wp.array(dtype=wp.vec2),
):
    i = first + wp.tid()
    found = locate(light_map, position_ws[i])
    found_out[i] = found
    if found[3] >= 0.0:
        density_out[i] = texels_per_length(light_map, int(found[3]), position_ws[i])


@wp.kernel
def planes_all(
    first: int,
    light_map: LightMap,
    position_ws: wp.array(dtype=wp.vec3),
    normal_ws: wp.array(dtype=wp.vec3),
    depth_row_out: wp.array(dtype=wp.vec3),
    scale_row_out: wp.array(dtype=wp.vec3),
):
    i = first + wp.tid()
    found = locate(light_map, position_ws[i])
    depth_row, scale_row = plane_of_receiver(light_map, int(found[3]), position_ws[i], normal_ws[i])
    depth_row_out[i] = depth_row
    scale_row_out[i] = scale_row


@wp.kernel
def compare_all(
    first: int,
    light_map: LightMap,
    bias: Bias,
    position_ws: wp.array(dtype=wp.vec3),
    normal_ws: wp.array(dtype=wp.vec3),
    offset: wp.array(dtype=wp.vec2),
    receiver_out: wp.array(dtype=wp.vec4),
    nearest_out: wp.array(dtype=float),
    bilinear_out: wp.array(dtype=float),
    stored_out: wp.array(dtype=wp.vec4),
    predicted_out: wp.array(dtype=wp.vec4),
):
    i = first + wp.tid()
    receiver = locate_receiver(light_map, bias, position_ws[i], normal_ws[i])
    receiver_out[i] = wp.vec4(receiver.x, receiver.y, receiver.depth, float(receiver.layer))
    if receiver.layer < 0:
        return
    nearest_out[i] = compare_nearest(light_map, receiver)
    bilinear_out[i] = compare_bilinear(light_map, receiver, offset[i][0], offset[i][1])
    x = receiver.x + offset[i][0] - 0.5
    y = receiver.y + offset[i][1] - 0.5
    stored = wp.vec4()
    predicted = wp.vec4()
    for k in range(4):
        column = int(wp.floor(x)) + k % 2
        row = int(wp.floor(y)) + k / 2
        stored[k] = stored_depth(light_map, receiver.layer, column, row)
        predicted[k] = receiver_depth_at(receiver, float(column) + 0.5 - receiver.x, float(row) + 0.5 - receiver.y)
    stored_out[i] = stored
    predicted_out[i] = predicted


def make_bias(kind: int, constant: float = 1.0, slope: float = 1.1) -> Bias:
    out = Bias()
    out.kind, out.constant, out.slope = kind, constant, slope
    return out


def make_session(meshes: list[Mesh], lamp: DirectionalLight | PointLight, device: str) -> Session:
    return Session(Geometry(small_scenes.scene(meshes, lamp), device), width=8, height=8, device=device)


def cluttered_session(kind: str, device: str) -> tuple[Session, list[HostView]]:
    scene = small_scenes.cluttered(LIGHTS[kind])  # type: ignore[arg-type]
    session = Session(Geometry(scene, device), width=8, height=8, device=device)
    box = session.geometry.bounds(receivers=True)
    return session, scene_views(session.light.centre, box, session.geometry.bounds(casters=True), 48)


def upload(values: np.ndarray, device: str) -> wp.array:
    dtype = wp.vec3 if values.shape[1] == 3 else wp.vec2
    return wp.array(values.astype(np.float32), dtype=dtype, device=device)


def host_locate(views: list[HostView], points: np.ndarray, resolution: int) -> tuple[np.ndarray, ...]:
    """Texel positions (N, layers, 2), depth and centrality (N, layers), from the definitions, float64."""
    xy, depth, inside = [], [], []
    for view in views:
        h = points @ view.ws_to_ss[:, :3].T + view.ws_to_ss[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            ndc = h[:, :2] / h[:, 3:]
        xy.append((0.5 + 0.5 * ndc * np.array([1.0, -1.0])) * resolution)
        depth.append(h[:, 2])
        inside.append(np.where(h[:, 3] > 0.0, 1.0 - np.abs(ndc).max(axis=1), -np.inf))
    return np.stack(xy, axis=1), np.stack(depth, axis=1), np.stack(inside, axis=1)


def compare(
    light_map: LightMap,
    bias: Bias,
    points: np.ndarray,
    normals: np.ndarray,
    device: str,
    offsets: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    count = len(points)
    offsets = np.zeros((count, 2)) if offsets is None else offsets
    out = {
        "receiver": wp.zeros(count, dtype=wp.vec4, device=device),
        "nearest": wp.full(count, -1.0, dtype=float, device=device),
        "bilinear": wp.full(count, -1.0, dtype=float, device=device),
        "stored": wp.zeros(count, dtype=wp.vec4, device=device),
        "predicted": wp.zeros(count, dtype=wp.vec4, device=device),
    }
    inputs = [light_map, bias, upload(points, device), upload(normals, device), upload(offsets, device)]
    launch(compare_all, count, inputs, list(out.values()), device=device)
    return {name: array.numpy().copy() for name, array in out.items()}

"""Light views that cover what the eye sees, uniformly or warped towards the eye (Stingl 2011, sections 3.1 and 3.2).

Map positions are (u, v): offsets across the light's direction, divided by the depth from the light where it is a point.
v runs along the view direction as the light sees it. A warp of strength n' is the projective map

    X = x - u_s w,   Y = y - v_0 w,   W = w + (y - v_0 w) / n'

of homogeneous (x, y, w), with v_0 the least v of what is covered and u_s the warp's centre line: a perspective frustum
in the map's plane whose near side is v_0 and whose centre lies n' before it (Wimmer et al. 2004). Linear depth is not
touched. n' going to infinity is the identity, without a special case.

Moving points along the light's rays changes neither u nor v. So the body B that holds all light rays to the covered
part H has the same extent in the map as H itself; only its depth range is larger (``light_body``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wkernels.projections.clipping import (
    ConvexBody,
    box_polyhedron,
    clip_polyhedron,
    convex_hull,
    extrude_towards,
    frustum_planes,
)
from wkernels.projections.light_views import MAX_TANGENT, NEAR_TO_FAR
from wkernels.scene.geometry import Bounds
from wkernels.scene.lights import orthonormal_frame
from wkernels.scene.views import HostView, LayerChoice, ProjectiveView

LEAST_DEPTH = 1e-3  # of the reach: nearer to the light's plane than this, one view cannot hold the body


@dataclass(frozen=True)
class WarpShape:
    """What a warp's strength may depend on; lengths in scene units but for ``extent``.

    Attributes:
        near, far: Eye depths of what is covered.
        z_0, z_1: Eye depths of two points ``extent`` apart along v, on the first and the last of what is covered
            (Wimmer and Scherzer 2006); equal to near and far under overhead light.
        extent: Extent along v, d: scene units for directional lights, tangents for points.
        half_fov: Half the eye's field of view in the plane of view and light direction, radians.
        gamma: Angle between light and view direction, folded to 0 .. pi/2, radians.
        pseudo_near, pseudo_far: Shares of the depth range before and behind the pseudo planes (Stingl 2011, 4.2).
        distance: n' that the user chose, as a multiple of ``extent``; None where it is not given.
    """

    near: float
    far: float
    z_0: float
    z_1: float
    extent: float
    half_fov: float
    gamma: float = 0.5 * np.pi
    pseudo_near: float = 0.0
    pseudo_far: float = 0.0
    distance: float | None = None


@dataclass(frozen=True, eq=False)
class LightSpace:
    """Axes of the maps of one light.

    Attributes:
        origin_ws: The light, or for directions a point before everything that casts, (3,).
        right_ws, up_ws, forward_ws: Orthonormal, (3,) each; u and v run along the first two.
        perspective: Whether the light is a point.
        far: Linear depth of the farthest thing, scene units.
    """

    origin_ws: np.ndarray
    right_ws: np.ndarray
    up_ws: np.ndarray
    forward_ws: np.ndarray
    perspective: bool
    far: float

    @property
    def rows(self) -> np.ndarray:
        """Rows x, y, depth, w before fitting, float64 (4, 4)."""
        axes = np.stack([self.right_ws, self.up_ws, self.forward_ws])
        out = np.zeros((4, 4))
        out[:3, :3], out[:3, 3] = axes, -axes @ self.origin_ws
        out[3] = out[2] if self.perspective else (0.0, 0.0, 0.0, 1.0)
        return out

    def project(self, points_ws: np.ndarray) -> np.ndarray:
        """(u, v, w) of points (n, 3)."""
        h = points_ws @ self.rows[:, :3].T + self.rows[:, 3]
        return np.column_stack([h[:, :2] / h[:, 3:], h[:, 3]])


def seen_body(receivers: Bounds, eye: HostView) -> ConvexBody:
    """H, the part of the receivers' box in the eye's view; empty where it sees none."""
    return clip_polyhedron(
        box_polyhedron(receivers.low, receivers.high), frustum_planes(eye.ws_to_ss, eye.near, eye.far)
    )


def light_body(body: ConvexBody, scene: Bounds, light_ws: np.ndarray) -> ConvexBody:
    """B, everything in the scene's box that may cast a shadow into ``body``: its rays to the light (equation 3.1).

    Args:
        body: H; may be empty, and so is B then.
        scene: Box of casters and receivers.
        light_ws: Light sample (4,), a point (w = 1) or the direction towards the light (w = 0).
    """
    if body.is_empty:
        return body
    corners = body.vertices
    if light_ws[3] == 0.0:
        rays = extrude_towards(corners, light_ws[:3], 2.0 * float(np.linalg.norm(scene.high - scene.low)) + 1e-6)
    else:
        rays = convex_hull(np.concatenate([corners, light_ws[None, :3]]))
    low, high = scene.low, scene.high
    planes = np.concatenate([np.column_stack([np.eye(3), -low]), np.column_stack([-np.eye(3), high])])
    return clip_polyhedron(rays, planes)


def depth_range(points_ws: np.ndarray, eye: HostView) -> tuple[float, float]:
    """Least and greatest eye depth of points (n, 3), within the eye's own range (Stingl 2011, section 3.3.1)."""
    depth = (points_ws - eye.eye_ws) @ eye.forward_ws
    return max(float(depth.min()), eye.near), min(float(depth.max()), eye.far)


def light_space(
    light_ws: np.ndarray, body: np.ndarray, scene: Bounds, eye: HostView, *, turned: bool = True
) -> LightSpace | None:
    """Axes for maps that cover ``body``, corners (n, 3).

    Args:
        light_ws: Light sample (4,).
        body: What is covered.
        scene: Box of casters and receivers, for the depth range.
        eye: Its view direction is that of v.
        turned: False: axes that depend on the light alone.

    Returns:
        None where one view cannot hold the body: the light is inside it, or sees it too wide.
    """
    if light_ws[3] == 0.0:
        forward = -light_ws[:3] / np.linalg.norm(light_ws[:3])
        right, up = _axes(forward, eye) if turned else orthonormal_frame(-forward)
        depths = scene.corners @ forward
        span = max(float(np.ptp(depths)), 1e-6)
        origin = forward * (float(depths.min()) - 0.01 * span)
        return LightSpace(origin, right, up, forward, False, 1.02 * span)
    position = light_ws[:3]
    offsets = body - position
    reach = max(float(np.linalg.norm(scene.corners - position, axis=1).max()), 1e-6)
    best, least = None, np.inf
    for axis in (offsets.mean(axis=0), *np.eye(3), *-np.eye(3)):
        length = float(np.linalg.norm(axis))
        forward = axis / max(length, 1e-300)
        depths = offsets @ forward
        if length < 1e-6 * reach or depths.min() <= LEAST_DEPTH * reach:
            continue
        right, up = _axes(forward, eye)
        u, v = offsets @ right / depths, offsets @ up / depths
        area = float(np.ptp(u) * np.ptp(v))
        if max(np.abs(u).max(), np.abs(v).max()) <= MAX_TANGENT and area < least:
            best, least = LightSpace(position, right, up, forward, True, 1.001 * reach), area
    return best


def _axes(forward: np.ndarray, eye: HostView) -> tuple[np.ndarray, np.ndarray]:
    """(right, up) across ``forward``, up along the view direction; along the eye's up where the two are parallel."""
    for guide in (eye.forward_ws, eye.up_ws):
        across = guide - (guide @ forward) * forward
        length = float(np.linalg.norm(across))
        if length > 1e-6:
            up = across / length
            return np.cross(forward, up), up
    right, up = orthonormal_frame(-forward)
    return right, up


def warp_shape(space: LightSpace, body: np.ndarray, eye: HostView, **given: float | None) -> WarpShape:
    """Measures corners (n, 3) for a warp's strength; ``given`` are further fields of the shape."""
    mapped = space.project(body)
    depth = (body - eye.eye_ws) @ eye.forward_ws
    nearest = int(np.argmin(depth))
    z_0 = max(float(depth[nearest]), 1e-6 * max(float(depth.max()), 1e-30))
    first, extent = float(mapped[:, 1].min()), float(np.ptp(mapped[:, 1]))
    across, along, ahead = (float(eye.forward_ws @ axis) for axis in (space.right_ws, space.up_ws, space.forward_ws))
    if space.perspective:
        # light depth of the point at (u of the nearest corner, v_0) whose eye depth is z_0
        rate = float(mapped[nearest, 0]) * across + first * along + ahead
        start = float(eye.forward_ws @ (space.origin_ws - eye.eye_ws))
        reach = (z_0 - start) / rate if rate != 0.0 else -1.0
        rise = (reach if 0.0 < reach <= space.far else float(mapped[nearest, 2])) * extent * along
    else:
        rise = extent * along
    near, far = depth_range(body, eye)
    gamma = float(np.arctan2(max(along, 0.0), abs(ahead)))
    return WarpShape(near, far, z_0, z_0 + rise, extent, _half_fov(space, eye), gamma, **given)  # type: ignore[arg-type]


def _half_fov(space: LightSpace, eye: HostView) -> float:
    """Half the field of view in the plane of view and light direction; 0 where lines of sight are parallel."""
    if not eye.perspective:
        return 0.0
    left, right, bottom, top = eye.window
    tilt = space.forward_ws - (space.forward_ws @ eye.forward_ws) * eye.forward_ws
    length = float(np.linalg.norm(tilt))
    if length < 1e-9:
        return float(np.arctan(0.5 * (top - bottom)))
    share = np.abs(np.array([tilt @ eye.right_ws, tilt @ eye.up_ws])) / length
    return float(np.arctan(share @ np.array([0.5 * (right - left), 0.5 * (top - bottom)])))


def fitted_view(
    space: LightSpace,
    body: np.ndarray,
    resolution: int,
    distance: float = np.inf,
    centre_ws: np.ndarray | None = None,
    choice: LayerChoice | None = None,
) -> ProjectiveView:
    """The view that just holds corners (n, 3), with a texel of margin, under a warp of strength ``distance``.

    Args:
        space: The light's axes.
        body: What is covered.
        resolution: Texels per side.
        distance: n', in the units of v.
        centre_ws: A point on the warp's centre line, (3,); the middle of the body unless given.
        choice: How receivers choose this layer.
    """
    mapped = space.project(body)
    first = float(mapped[:, 1].min())
    middle = 0.5 * float(mapped[:, 0].min() + mapped[:, 0].max())
    if centre_ws is not None:
        centre = space.project(centre_ws[None])[0]
        if centre[2] > 0.0 and np.isfinite(centre).all():
            middle = float(np.clip(centre[0], mapped[:, 0].min(), mapped[:, 0].max()))
    rows = space.rows
    x, y, depth, w = rows
    x, y = x - middle * w, y - first * w
    w = w + y / distance if np.isfinite(distance) else w
    h = body @ np.stack([x, y, w])[:, :3].T + np.stack([x, y, w])[:, 3]
    fitted = np.stack([_fit(x, w, h[:, 0] / h[:, 2], resolution), _fit(y, w, h[:, 1] / h[:, 2], resolution), depth, w])
    return projective_view(space, fitted, resolution, choice)


def _fit(row: np.ndarray, w: np.ndarray, values: np.ndarray, resolution: int) -> np.ndarray:
    """``row`` scaled and shifted so that ``values`` fill [-1, 1] but for a texel at either end."""
    middle, half = 0.5 * float(values.min() + values.max()), 0.5 * float(np.ptp(values))
    half = max(half, 1e-6 * max(1e-6, abs(middle)))
    half *= resolution / max(resolution - 2.0, 0.5 * resolution)
    out: np.ndarray = (row - middle * w) / half
    return out


def projective_view(
    space: LightSpace, rows: np.ndarray, resolution: int, choice: LayerChoice | None = None
) -> ProjectiveView:
    """A square view with the matrix ``rows`` on the axes of ``space``."""
    return ProjectiveView(
        eye_ws=space.origin_ws,
        right_ws=space.right_ws,
        up_ws=space.up_ws,
        forward_ws=space.forward_ws,
        window=(-1.0, 1.0, -1.0, 1.0),
        near=NEAR_TO_FAR * space.far if space.perspective else 0.0,
        far=space.far,
        width=resolution,
        height=resolution,
        perspective=space.perspective,
        rows=rows,
        choice=choice,
    )


def depth_from(view: ProjectiveView, body: ConvexBody) -> ProjectiveView:
    """A directional light's view whose depth begins before ``body``, B of what it covers, as far as B is deep.

    For scenes that go on so far that float32 depths from their border say little; linear depth may begin anywhere.
    """
    if body.is_empty:
        return view
    depth = body.vertices @ view.rows[2, :3] + view.rows[2, 3]
    room = max(float(np.ptp(depth)), 1e-6)
    first = float(depth.min()) - room
    rows = view.rows.copy()
    rows[2, 3] -= first
    return replace(
        view,
        eye_ws=view.eye_ws + first * view.forward_ws,
        rows=rows,
        far=3.0 * room,
        clamped_before=max(view.clamped_before - first, 0.0),
    )

"""Views: the eye's camera or a light's, as the matrices that kernels use.

A view's matrix has the rows ``(x, y, d, w)``: screen position is ``(x/w, y/w)`` in [-1, 1], and ``d`` is the *linear*
depth along the view axis in scene units, not divided by w. That one form covers perspective, orthographic and warped
views; depth keeps its precision whatever near and far are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import warp as wp

ALONG_UP = 1e-6
"""Sine of the angle between view direction and vertical axis under which another axis is taken for up."""


@wp.struct
class View:
    """Device form of ``HostView``. Pixel (column x, row y) has its centre at (x + 1/2, y + 1/2); row 0 is the top."""

    ws_to_ss: wp.mat44  # rows x, y, linear depth, w
    origin_ws: wp.vec3  # a pixel's ray is base + depth * along, each affine in pixel coordinates:
    base_dx_ws: wp.vec3  # base = origin + x base_dx + y base_dy   (constant for perspective views)
    base_dy_ws: wp.vec3
    along_ws: wp.vec3  # along = along + x along_dx + y along_dy   (constant for orthographic views)
    along_dx_ws: wp.vec3
    along_dy_ws: wp.vec3
    near: float  # linear depth, scene units
    far: float
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class HostView:
    """A perspective or orthographic view in float64.

    Attributes:
        eye_ws: Position (3,); for orthographic views the point whose depth is 0.
        right_ws, up_ws, forward_ws: Orthonormal axes (3,).
        window: (left, right, bottom, top): tangents for perspective views, scene units for orthographic ones.
        near, far: Linear depth range.
        width, height: Pixels.
        perspective: False for orthographic.
    """

    eye_ws: np.ndarray
    right_ws: np.ndarray
    up_ws: np.ndarray
    forward_ws: np.ndarray
    window: tuple[float, float, float, float]
    near: float
    far: float
    width: int
    height: int
    perspective: bool = True

    @property
    def ws_to_ss(self) -> np.ndarray:
        """float64 (4, 4), rows x, y, linear depth, w."""
        left, right, bottom, top = self.window
        rows = np.zeros((4, 4))
        axes = np.stack([self.right_ws, self.up_ws, self.forward_ws])
        offset = -axes @ self.eye_ws
        centre_x, centre_y = (right + left) / (right - left), (top + bottom) / (top - bottom)
        rows[0, :3], rows[0, 3] = 2.0 / (right - left) * axes[0], 2.0 / (right - left) * offset[0]
        rows[1, :3], rows[1, 3] = 2.0 / (top - bottom) * axes[1], 2.0 / (top - bottom) * offset[1]
        rows[2, :3], rows[2, 3] = axes[2], offset[2]
        if self.perspective:
            rows[3] = rows[2]
            rows[0] -= centre_x * rows[2]
            rows[1] -= centre_y * rows[2]
        else:
            rows[3, 3] = 1.0
            rows[0, 3] -= centre_x
            rows[1, 3] -= centre_y
        return rows

    def to_device(self) -> View:
        """The struct that kernels take."""
        left, right, bottom, top = self.window
        step_x, step_y = (right - left) / self.width, (bottom - top) / self.height
        corner = left * self.right_ws + top * self.up_ws
        zero = np.zeros(3)
        out = View()
        out.ws_to_ss = wp.mat44(*self.ws_to_ss.astype(np.float32).ravel())
        if self.perspective:
            out.origin_ws, out.base_dx_ws, out.base_dy_ws = wp.vec3(*self.eye_ws), wp.vec3(*zero), wp.vec3(*zero)
            out.along_ws = wp.vec3(*(self.forward_ws + corner))
            out.along_dx_ws, out.along_dy_ws = wp.vec3(*(step_x * self.right_ws)), wp.vec3(*(step_y * self.up_ws))
        else:
            out.origin_ws = wp.vec3(*(self.eye_ws + corner))
            out.base_dx_ws, out.base_dy_ws = wp.vec3(*(step_x * self.right_ws)), wp.vec3(*(step_y * self.up_ws))
            out.along_ws, out.along_dx_ws, out.along_dy_ws = wp.vec3(*self.forward_ws), wp.vec3(*zero), wp.vec3(*zero)
        out.near, out.far, out.width, out.height = self.near, self.far, self.width, self.height
        return out


@dataclass(frozen=True)
class LayerChoice:
    """How receivers choose among the layers of a light map.

    Attributes:
        rule: ``depth``: the first layer whose ``far`` lies beyond the receiver's eye depth; ``best``: the first that
            holds the receiver, nearer splits being finer. Without a choice: the layer that holds it most centrally.
        eye_row: Eye depth of a position p is ``eye_row @ (p, 1)``, float64 (4,).
        far: Eye depth at which the layer's split ends, scene units.
    """

    rule: Literal["depth", "best"]
    eye_row: tuple[float, float, float, float]
    far: float


@dataclass(frozen=True, eq=False)
class ProjectiveView(HostView):
    """A light's view with any matrix: warped ones too. Its pixels have no rays, so it is for light maps only.

    Attributes:
        rows: float64 (4, 4), rows x, y, linear depth, w; stands in for ``window``.
        choice: None where the receivers' place in the layers decides.
        clamped_before: Linear depth that nearer casters are moved to; 0 where they keep their own.
    """

    rows: np.ndarray = field(default_factory=lambda: np.eye(4))
    choice: LayerChoice | None = None
    clamped_before: float = 0.0

    @property
    def ws_to_ss(self) -> np.ndarray:
        return self.rows

    def to_device(self) -> View:
        out = View()
        out.ws_to_ss = wp.mat44(*self.rows.astype(np.float32).ravel())
        out.near, out.far, out.width, out.height = self.near, self.far, self.width, self.height
        return out


@wp.func
def pixel_base_ws(view: View, x: float, y: float):
    """Where the ray through screen position (x, y) in pixels has depth 0."""
    return view.origin_ws + x * view.base_dx_ws + y * view.base_dy_ws


@wp.func
def pixel_along_ws(view: View, x: float, y: float):
    """Direction of the ray through (x, y), scaled so that its parameter is linear depth."""
    return view.along_ws + x * view.along_dx_ws + y * view.along_dy_ws


def eye_view(camera, width: int, height: int, origin_ws: np.ndarray, margin: tuple[int, int] = (0, 0)) -> HostView:
    """The view of ``camera``, rebased by ``-origin_ws``, with ``margin`` extra pixels at each side (overscan).

    The pixel pitch does not depend on the margin, so the middle of an overscanned view samples the same receiver
    points. A camera with a ``height`` is orthographic.
    """
    forward = np.asarray(camera.target, float) - np.asarray(camera.eye, float)
    forward /= np.linalg.norm(forward)
    up = np.asarray(camera.up, float)
    if np.linalg.norm(np.cross(forward, up)) < ALONG_UP * np.linalg.norm(up):  # looking straight along up
        up = np.eye(3)[np.argmin(np.abs(forward))]
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    perspective = camera.height is None
    half = np.tan(np.radians(camera.fov_deg) / 2.0) if perspective else 0.5 * camera.height
    half_w = half * (width + 2 * margin[0]) / height
    half_h = half * (height + 2 * margin[1]) / height
    return HostView(
        eye_ws=np.asarray(camera.eye, float) - origin_ws,
        right_ws=right,
        up_ws=np.cross(right, forward),
        forward_ws=forward,
        window=(-half_w, half_w, -half_h, half_h),
        near=float(camera.near),
        far=float(camera.far),
        width=width + 2 * margin[0],
        height=height + 2 * margin[1],
        perspective=perspective,
    )

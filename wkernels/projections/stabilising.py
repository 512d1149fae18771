"""Windows of orthographic light views whose texels stay where they are as the eye moves. Host, float64."""

from __future__ import annotations

import numpy as np

from wkernels.scene.views import HostView


def frustum_sphere(eye: HostView) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of the least sphere around a view's symmetric frustum, or around its box."""
    left, right, bottom, top = eye.window
    if not eye.perspective:
        half = 0.5 * np.array([right - left, top - bottom, eye.far - eye.near])
        return eye.eye_ws + 0.5 * (eye.near + eye.far) * eye.forward_ws, float(np.linalg.norm(half))
    k_2 = (0.5 * (right - left)) ** 2 + (0.5 * (top - bottom)) ** 2
    depth = min(eye.far, 0.5 * (eye.near + eye.far) * (1.0 + k_2))
    return eye.eye_ws + depth * eye.forward_ws, float(np.hypot(eye.far - depth, eye.far * np.sqrt(k_2)))


def snapped_window(middle: np.ndarray, half: np.ndarray, resolution: int) -> np.ndarray:
    """A window whose texel borders lie at whole multiples of the texel size.

    Args:
        middle: Centre of what is covered, map units, (2,).
        half: Half its extent, (2,); the texel size depends on nothing else.
        resolution: Texels per side.

    Returns:
        (left, right, bottom, top), with at least a texel of margin.
    """
    # snapping moves the centre by up to half a texel, and filters want a whole one beside
    half = half * resolution / max(resolution - 4.0, 0.5 * resolution)
    texel = 2.0 * half / resolution
    corner = np.round((middle - half) / texel) * texel
    return np.array([corner[0], corner[0] + 2.0 * half[0], corner[1], corner[1] + 2.0 * half[1]])

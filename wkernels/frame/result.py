"""What one rendered frame leaves behind, read back from the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wkernels.projections.light_views import perspective_aliasing
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import CASTS, RECEIVES

if TYPE_CHECKING:
    from wkernels.frame.session import Session

G_BUFFER, SHADING = "g-buffer", "shading"
TURNED_AWAY = "comparisons of pixels with the light depth map", "their surface is turned away from the light"


@dataclass
class FrameResult:
    """What one rendered frame leaves behind.

    Attributes:
        visibility: float32 (H, W); NaN where no receiver is seen.
        color: float32 (H, W, 3), linear, for people.
        standard_error: float32 (H, W) for methods that sample the light, else None.
        world_position: float32 (H, W, 3), scene units; NaN where nothing is seen.
        passes: Milliseconds per pass, in order of first use.
        frame_ms: Everything this technique needed for the frame.
        shadow_ms: Without G-buffer and shading.
        left_out: (what, reason, count) of work this frame did not need.
        m_x_max, m_z_max: Largest perspective aliasing error along the view vector; NaN without a shadow map.
        not_finite: Receiver pixels whose visibility the technique left NaN or infinite: its defect.
    """

    visibility: np.ndarray
    color: np.ndarray
    standard_error: np.ndarray | None
    world_position: np.ndarray
    passes: list[tuple[str, float]]
    frame_ms: float
    shadow_ms: float
    left_out: list[tuple[str, str, int]]
    m_x_max: float
    m_z_max: float
    not_finite: int = 0


def check_image(what: str, image: Any, shape: tuple[int, ...]) -> None:
    """Refuses what kernels would read past the end of, as they do not check bounds.

    Raises:
        ValueError: ``image`` is no Warp array, or not float32 of ``shape``; ``what`` begins the message.
    """
    found = f"a {type(image).__name__}"
    if isinstance(image, wp.array):
        if image.shape == shape and image.dtype == wp.float32:
            return
        found = f"{image.dtype.__name__} {image.shape}"
    raise ValueError(f"{what} {found}, not float32 of a G-buffer's size {shape}")


def read_back(
    frame: Session, gbuffer: GBuffer, visibility: wp.array, color: wp.array, spent: dict[str, float]
) -> FrameResult:
    """Copies a frame's results to the host, without the margin of an overscanned G-buffer.

    Args:
        frame: The session that rendered it.
        gbuffer: The receivers, of the same size as the arrays.
        visibility: float32, what the technique returned.
        color: vec3, shaded.
        spent: Milliseconds per pass.
    """
    rows = slice((visibility.shape[0] - frame.height) // 2, (visibility.shape[0] + frame.height) // 2)
    cols = slice((visibility.shape[1] - frame.width) // 2, (visibility.shape[1] + frame.width) // 2)
    flags = gbuffer.flags.numpy()[rows, cols]
    seen = gbuffer.mesh.numpy()[rows, cols] >= 0
    lit = visibility.numpy()[rows, cols].copy()
    receives = (flags & RECEIVES) != 0
    not_finite = int((receives & ~np.isfinite(lit)).sum())
    lit[~receives] = np.nan
    position = gbuffer.position_ws.numpy()[rows, cols] + frame.geometry.origin_ws
    position[~seen] = np.nan
    error = None
    if frame.standard_error is not None:
        error = frame.standard_error.numpy()[rows, cols].copy()
        error[~receives] = np.nan
    m_x = m_z = float("nan")
    if frame.light_views is not None:
        views, sample = frame.light_views
        _, all_x, all_z = perspective_aliasing(views, sample, frame.near_plane.used or frame.eye())
        m_x, m_z = (float(np.nanmax(m)) if np.isfinite(m).any() else float("nan") for m in (all_x, all_z))
    total = sum(spent.values())
    return FrameResult(
        visibility=lit,
        color=color.numpy()[rows, cols].copy(),
        standard_error=error,
        world_position=position.astype(np.float32),
        passes=list(spent.items()),
        frame_ms=total,
        shadow_ms=total - spent.get(G_BUFFER, 0.0) - spent.get(SHADING, 0.0),
        left_out=[(what, reason, count) for (what, reason), count in frame.left_out.items()],
        m_x_max=m_x,
        m_z_max=m_z,
        not_finite=not_finite,
    )


def tell_turned_away(frame: Session, gbuffer: GBuffer) -> None:
    """Has the receivers counted that are not compared with the frame's map, as they are dark by themselves."""
    light_map = frame.read_map
    if light_map is None:
        return

    def count() -> int:
        light = np.asarray(light_map.light_ws, np.float32)
        to_light = light[:3] - gbuffer.position_ws.numpy() * light[3]
        both = RECEIVES | CASTS
        turned = np.einsum("hwi,hwi->hw", gbuffer.normal_ws.numpy(), to_light) <= 0.0
        return int((turned & ((gbuffer.flags.numpy() & both) == both)).sum())

    frame.tell(*TURNED_AWAY, count)

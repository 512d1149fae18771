"""What one rendered frame leaves behind, read back from the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wkernels.light_maps.host_map import HostMap, LightLook
from wkernels.projections.light_views import perspective_aliasing
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import CASTS, RECEIVES
from wkernels.scene.views import HostView
from wkernels.workspace.left_out import Omission, Reasoned
from wkernels.workspace.products import Product

SHADING = "shading"  # name of the pass


class TurnedAway(Omission):
    """What needs no map, as its own surface hides the light."""

    PIXELS = "comparisons of pixels with the light depth map", "their surface is turned away from the light"


class Unread(Omission):
    """What of a light a method does not look at."""

    TEXTURE = "texture of the light", "nothing asks for it: all parts of the light count alike"


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


@dataclass
class Rendered:
    """A frame on the device.

    Attributes:
        gbuffer: The receivers, of the same size as the images.
        visibility: float32, what the technique returned.
        standard_error: float32, or None.
        color: vec3, shaded.
        look: Where the technique looked from the light; None if it read no map.
        eye: The view that the light's views were made for.
    """

    gbuffer: GBuffer
    visibility: wp.array
    standard_error: wp.array | None
    color: wp.array
    look: LightLook | None
    eye: HostView


def read_back(
    frame: Rendered,
    size: tuple[int, int],
    origin_ws: np.ndarray,
    spent: dict[str, float],
    left_out: dict[Reasoned, int],
) -> FrameResult:
    """Copies a frame's results to the host, without the margin of an overscanned G-buffer.

    Args:
        frame: What was rendered.
        size: Height and width of the frame in pixels.
        origin_ws: Of the rebased world, (3,), scene units.
        spent: Milliseconds per pass.
        left_out: How often what was left out for which reason.
    """
    held = frame.visibility.shape
    rows, cols = (slice((h - s) // 2, (h + s) // 2) for h, s in zip(held, size, strict=True))
    flags = frame.gbuffer.flags.numpy()[rows, cols]
    seen = frame.gbuffer.mesh.numpy()[rows, cols] >= 0
    lit = frame.visibility.numpy()[rows, cols].copy()
    receives = (flags & RECEIVES) != 0
    not_finite = int((receives & ~np.isfinite(lit)).sum())
    lit[~receives] = np.nan
    position = frame.gbuffer.position_ws.numpy()[rows, cols] + origin_ws
    position[~seen] = np.nan
    error = None
    if frame.standard_error is not None:
        error = frame.standard_error.numpy()[rows, cols].copy()
        error[~receives] = np.nan
    m_x = m_z = float("nan")
    if frame.look is not None:
        _, all_x, all_z = perspective_aliasing(list(frame.look.views), frame.look.light_ws, frame.eye)
        m_x, m_z = (float(np.nanmax(m)) if np.isfinite(m).any() else float("nan") for m in (all_x, all_z))
    total = sum(spent.values())
    return FrameResult(
        visibility=lit,
        color=frame.color.numpy()[rows, cols].copy(),
        standard_error=error,
        world_position=position.astype(np.float32),
        passes=list(spent.items()),
        frame_ms=total,
        shadow_ms=total - spent.get(Product.G_BUFFER.value, 0.0) - spent.get(SHADING, 0.0),
        left_out=[(what, reason, count) for (what, reason), count in left_out.items()],
        m_x_max=m_x,
        m_z_max=m_z,
        not_finite=not_finite,
    )


def count_turned_away(gbuffer: GBuffer, light_map: HostMap) -> int:
    """Receivers that are not compared with a map, as their own surface hides the light."""
    light = np.asarray(light_map.map.light_ws, np.float32)
    to_light = light[:3] - gbuffer.position_ws.numpy() * light[3]
    both = RECEIVES | CASTS
    turned = np.einsum("hwi,hwi->hw", gbuffer.normal_ws.numpy(), to_light) <= 0.0
    return int((turned & ((gbuffer.flags.numpy() & both) == both)).sum())

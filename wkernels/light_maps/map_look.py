"""What kernels are told of a map's views: matrices, axes, and how receivers choose among its layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from wkernels.light_maps.light_map import BY_DEPTH, BY_MARGIN, FIRST_INSIDE, LightMap
from wkernels.light_maps.storage import MapLayout, begins_on_device
from wkernels.scene.views import HostView, ProjectiveView


@dataclass(frozen=True, eq=False, kw_only=True)
class MapLook:
    """The fields of ``LightMap`` that follow from its views, on the host: float32, one entry for each layer.

    Attributes:
        ws_to_ls: (layers, 4, 4).
        right_ws: (layers, 3).
        up_ws: (layers, 3).
        split_far: (layers,), 0 but for BY_DEPTH and FIRST_INSIDE.
        light_ws: The light sample (4,), rebased world.
        near: Linear depth of the near plane.
        selection: BY_MARGIN, BY_DEPTH or FIRST_INSIDE.
        eye_row: (4,), 0 for BY_MARGIN.
    """

    ws_to_ls: np.ndarray
    right_ws: np.ndarray
    up_ws: np.ndarray
    split_far: np.ndarray
    light_ws: np.ndarray
    near: float
    selection: int
    eye_row: np.ndarray

    def on_device(self, layout: MapLayout, depth: wp.array) -> LightMap:
        """The struct of a map with these views, whose depths (texels,) lie as ``layout`` says."""
        device, out = depth.device, LightMap()
        out.depth, out.pitch, out.resolution = depth, layout.pitch, layout.resolution
        out.layer_begin = begins_on_device(layout, str(device))
        out.ws_to_ls = wp.array(self.ws_to_ls, dtype=wp.mat44, device=device)
        out.right_ws = wp.array(self.right_ws, dtype=wp.vec3, device=device)
        out.up_ws = wp.array(self.up_ws, dtype=wp.vec3, device=device)
        out.split_far = wp.array(self.split_far, dtype=float, device=device)
        out.layers, out.light_ws, out.near = len(self.ws_to_ls), wp.vec4(*self.light_ws), self.near
        out.selection, out.eye_row = self.selection, wp.vec4(*self.eye_row)
        return out


def look_of(views: Sequence[HostView], light_ws: np.ndarray) -> MapLook:
    """What kernels are told of a map with these views, one per layer, from the light sample (4,)."""
    choices = [view.choice for view in views if isinstance(view, ProjectiveView) and view.choice is not None]
    chosen = len(views) > 1 and len(choices) == len(views)
    rule = BY_DEPTH if chosen and choices[0].rule == "depth" else FIRST_INSIDE if chosen else BY_MARGIN
    return MapLook(
        ws_to_ls=np.stack([view.ws_to_ss for view in views]).astype(np.float32),
        right_ws=np.stack([view.right_ws for view in views]).astype(np.float32),
        up_ws=np.stack([view.up_ws for view in views]).astype(np.float32),
        split_far=np.array([choice.far for choice in choices] if chosen else [0.0] * len(views), dtype=np.float32),
        light_ws=np.asarray(light_ws),
        near=max(views[0].near, clamps_of(views)[0]),
        selection=int(rule),
        eye_row=np.array(choices[0].eye_row if chosen else np.zeros(4)),
    )


def views_stamp(views: Sequence[HostView]) -> tuple[bytes, tuple]:
    """What a map's content depends on of its views, comparable."""
    choices = tuple(view.choice for view in views if isinstance(view, ProjectiveView))
    return np.stack([view.ws_to_ss for view in views]).tobytes(), (choices, clamps_of(views))


def clamps_of(views: Sequence[HostView]) -> tuple[float, ...]:
    """For each view the linear depth that nearer casters are moved to; 0 where they keep their own."""
    return tuple(view.clamped_before if isinstance(view, ProjectiveView) else 0.0 for view in views)

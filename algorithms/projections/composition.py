"""Composing a projection from its parts, as the key ``projection`` of an experiment file names them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from algorithms.projections.projection import LEAST_ANGLE, Fit, Stabiliser, Warp
from algorithms.projections.schema import Projection, read_projection
from algorithms.projections.table import fits, stabilisers, warps
from wkernels.errors import InputError
from wkernels.frame.light_side import LightViews
from wkernels.light_maps.storage import PLACES, MapOptions
from wkernels.projections.clipping import ConvexBody, clip_polyhedron
from wkernels.projections.focusing import (
    LightSpace,
    depth_from,
    depth_range,
    fitted_view,
    light_body,
    light_space,
    projective_view,
    warp_shape,
)
from wkernels.projections.light_views import scene_views
from wkernels.projections.side_pieces import side_pieces
from wkernels.projections.splits import pseudo_planes, shares_of_split, split_borders
from wkernels.scene.geometry import Bounds
from wkernels.scene.origin import PRECISION
from wkernels.scene.views import HostView, LayerChoice, ProjectiveView
from wkernels.workspace.left_out import Omission


class Fallback(Omission):
    """What a composition does not do, whether skips are on or not: there is no other way to go."""

    NOTHING_SEEN = "focused light views", "the eye sees nothing that receives: the whole scene's are used"
    TOO_WIDE = (
        "focused light views",
        "the light is amid what is seen, or sees it too wide for one view: the whole scene's are used",
    )
    EMPTY_SPLIT = "light view of a split", "nothing of what the eye sees lies in it"
    NO_DEPTH = "splits of the view's depth", "what is seen has no depth to split"
    DUELLING = "warp", "light and view direction are less than a degree apart: nothing is better than none"
    NO_PERSPECTIVE = "warp", "an orthographic view has no perspective aliasing that a warp would even out"
    PARALLEL_FACES = "a map for each side face", "an orthographic view's faces are parallel: one map is used"


def compose(settings: Mapping[str, Any] | None = None) -> LightViews:
    """The projection that a mapping with the keys of an experiment file's ``projection`` stands for.

    Args:
        settings: Keys of ``Projection``; what is left out is the plainest value.

    Raises:
        InputError: An unknown key, a value that does not exist, or parts that make no sense together, with the reason.
    """
    chosen = read_projection(settings or {})
    fit, warp = fits()[chosen.fit](), warps()[chosen.warp]()
    _check_together(chosen, fit, warp)
    if not fit.follows_eye:
        return SceneViews(fit, chosen)
    stabiliser = None if chosen.stabilise == "none" else stabilisers()[chosen.stabilise]()
    return Composition(fit, warp, stabiliser, chosen)


def _check_together(chosen: Projection, fit: Fit, warp: Warp) -> None:
    """Refuses compositions that make no sense."""
    if not fit.follows_eye:
        tight = ", ".join(name for name, cls in fits().items() if cls.follows_eye)
        changed = chosen.changed()
        for key in ("warp", "splits", "stabilise", "partition", "near", "adjust", "depth"):
            if key in changed:
                why = f"needs a fit that follows the eye ({tight}); '{fit.name}' covers the whole scene."
                raise _refused(key, f"{changed[key]!r} {why}")
    if chosen.stabilise != "none" and chosen.warp != "none":
        why = "cannot stabilise a warp, whose texels differ in size and move with the eye; a temporal technique can."
        raise _refused("stabilise", why)
    if chosen.near != "user" and chosen.stabilise != "none" and not stabilisers()[chosen.stabilise].adjusts:
        why = f"{chosen.near!r} cannot be with texels of constant size, which need a constant depth range."
        raise _refused("near", why)
    if chosen.partition == "faces":
        if chosen.splits > 1:
            why = "'faces' needs one split: it divides the view by its sides instead of by depth."
            raise _refused("partition", why)
        if chosen.stabilise != "none":
            raise _refused("stabilise", "cannot stabilise the maps of faces, whose axes turn with the eye.")
        if chosen.selection != "depth":
            why = "'best' chooses among splits by depth; the maps of faces are chosen by margin."
            raise _refused("selection", why)
    if warp.takes_distance != (chosen.warp_distance is not None):
        takers = " or ".join(repr(name) for name, cls in warps().items() if cls.takes_distance)
        needed = chosen.warp_distance is None
        why = f"is required by the warp '{warp.name}'." if needed else f"needs the warp {takers}."
        raise _refused("warp_distance", why)
    for key in ("pseudo_near", "pseudo_far"):
        if getattr(chosen, key) and chosen.scheme != "pseudo":
            raise _refused(key, "needs the scheme 'pseudo'.")
    if chosen.pseudo_near + chosen.pseudo_far >= 1.0:
        raise _refused("pseudo_near", "pseudo_near and pseudo_far together must be less than 1.")
    slots = PLACES[chosen.storage]
    if slots is not None and fit.follows_eye:  # how many views cover the whole scene is up to its light
        if chosen.splits > slots or (chosen.storage == "cube6" and chosen.splits != slots):
            why = f"{chosen.storage!r} has {slots} places, which {chosen.splits} splits do not fit."
            raise _refused("storage", why)


def _refused(key: str, why: str) -> InputError:
    return InputError(why, key=f"projection.{key}")


class SceneViews:
    """A fit that does not follow the eye; a ``LightViews``.

    Args:
        fit: The fit.
        settings: What was asked for.
    """

    def __init__(self, fit: Fit, settings: Projection) -> None:
        self.fit = fit
        self.map_options = MapOptions(settings.storage, settings.drawing)

    def __call__(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        """The fit's views."""
        return self.fit.views(light_ws, receivers, casters, resolution, eye)


class Composition:
    """A fit that follows the eye, with a warp, a partition and a stabiliser, which is a ``LightViews``.

    Args:
        fit, warp, stabiliser: The parts; None where nothing is stabilised.
        settings: What was asked for, which makes sense together.

    Attributes:
        near: Which near plane the eye's view has that this is called with; ``wkernels.frame.near_plane``.
        left_out: What the last call could not do, or did not need to.
    """

    def __init__(self, fit: Fit, warp: Warp, stabiliser: Stabiliser | None, settings: Projection) -> None:
        self.fit, self.warp, self.stabiliser, self.settings = fit, warp, stabiliser, settings
        self.map_options = MapOptions(settings.storage, settings.drawing)
        self.near = settings.near
        self.left_out: list[Fallback] = []

    def __call__(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        """One view per part that has something to cover, nearest first; the whole scene's where none has.

        Raises:
            InputError: A stabiliser with a point light.
        """
        if self.stabiliser is not None and light_ws[3] != 0.0:
            raise InputError(
                "needs a directional light: other maps have no constant texels.", key="projection.stabilise"
            )
        self.left_out = []
        whole = self.fit.body(receivers, eye)
        if whole.is_empty:
            self.left_out.append(Fallback.NOTHING_SEEN)
            return scene_views(light_ws, receivers, casters, resolution)
        scene = Bounds()
        scene.add(np.concatenate([receivers.corners, casters.corners]))
        faces = self.settings.partition == "faces" and eye.perspective
        if self.settings.partition == "faces" and not faces:
            self.left_out.append(Fallback.PARALLEL_FACES)
        pieces = side_pieces(whole, eye) if faces else [(whole, eye)]
        views: list[HostView] = []
        for body, ahead in pieces:
            space = light_space(light_ws, body.vertices, scene, ahead, turned=self.stabiliser is None)
            if space is None:  # no plane map holds the body
                self.left_out.append(Fallback.TOO_WIDE)
                return scene_views(light_ws, receivers, casters, resolution)
            clamp = self._clamp(space, whole, scene)
            goes_on = not space.perspective and space.far > 2.0 * PRECISION * eye.near
            for part, view in self._parts(space, body, ahead, resolution, not faces):
                clamped = replace(view, clamped_before=clamp)
                views.append(depth_from(clamped, light_body(part, scene, light_ws)) if goes_on else clamped)
        return views or scene_views(light_ws, receivers, casters, resolution)

    def _parts(
        self, space: LightSpace, whole: ConvexBody, eye: HostView, resolution: int, by_depth: bool
    ) -> list[tuple[ConvexBody, ProjectiveView]]:
        """A body's splits and their views; without a choice of layers where the body is one of several pieces."""
        views = []
        adjusts = self.settings.adjust and (self.stabiliser is None or self.stabiliser.adjusts)
        near, far = depth_range(whole.vertices, eye) if adjusts else (eye.near, eye.far)
        borders = self._borders(near, far)
        row = (*eye.forward_ws, -float(eye.forward_ws @ eye.eye_ws))
        for i, (begin, end) in enumerate(itertools.pairwise(borders)):
            body = whole
            if len(borders) > 2:
                ahead = np.array(row)
                body = clip_polyhedron(whole, np.stack([ahead - (0, 0, 0, begin), (0, 0, 0, end) - ahead]))
            if body.is_empty:
                self.left_out.append(Fallback.EMPTY_SPLIT)
                continue
            last = i == len(borders) - 2
            choice = LayerChoice(self.settings.selection, row, np.inf if last else float(end)) if by_depth else None
            part = replace(eye, near=float(begin), far=float(end))
            planes = pseudo_planes(near, far, self.settings.pseudo_near, self.settings.pseudo_far)
            shares = shares_of_split(borders, i, planes)
            views.append((body, self._view(space, body.vertices, part, resolution, choice, shares)))
        return views

    def _clamp(self, space: LightSpace, seen: ConvexBody, scene: Bounds) -> float:
        """Linear depth that casters are clamped to; 0 where that would move none.

        It is as far before what is seen as that is deep: a bias that carries a receiver before it would have carried
        the receiver before everything that is seen, too. All layers have it from the whole of what is seen, because
        receivers may read a layer that was not made for them.
        """
        if self.settings.depth == "scene":
            return 0.0
        depth, first = (points @ space.rows[2, :3] + space.rows[2, 3] for points in (seen.vertices, scene.corners))
        near = 2.0 * float(depth.min()) - float(depth.max())
        return near if near > max(float(first.min()), 0.0) else 0.0

    def _borders(self, near: float, far: float) -> np.ndarray:
        settings = self.settings
        if far <= near * (1.0 + 1e-9):  # flat across the view: nothing to split
            if settings.splits > 1:
                self.left_out.append(Fallback.NO_DEPTH)
            return np.array([near, far])
        shares = settings.pseudo_near, settings.pseudo_far
        return split_borders(near, far, settings.splits, settings.scheme, settings.lambda_, *shares)

    def _view(
        self,
        space: LightSpace,
        body: np.ndarray,
        eye: HostView,
        resolution: int,
        choice: LayerChoice | None,
        shares: tuple[float, float],
    ) -> ProjectiveView:
        if self.stabiliser is not None:
            left, right, bottom, top = self.stabiliser.window(space, body, eye, resolution)
            rows = space.rows
            rows[0] = (2.0 * rows[0] - (right + left) * rows[3]) / (right - left)
            rows[1] = (2.0 * rows[1] - (top + bottom) * rows[3]) / (top - bottom)
            return projective_view(space, rows, resolution, choice)
        given = {"pseudo_near": shares[0], "pseudo_far": shares[1], "distance": self.settings.warp_distance}
        shape = warp_shape(space, body, eye, **given)
        distance = self.warp.bounded_distance(shape) if eye.perspective else np.inf
        if not eye.perspective and self.settings.warp != "none":
            self.left_out.append(Fallback.NO_PERSPECTIVE)
        elif shape.gamma < LEAST_ANGLE and self.settings.warp != "none":
            self.left_out.append(Fallback.DUELLING)
        depth = (body - eye.eye_ws) @ eye.forward_ws
        # the point with the nearest corner's depth on the view vector moves as the eye does; the corner itself jumps
        centre = eye.eye_ws + float(depth.min()) * eye.forward_ws
        if self.settings.warp_centre == "vertex":
            centre = body[int(np.argmin(depth))]
        return fitted_view(space, body, resolution, distance, centre if np.isfinite(distance) else None, choice)

"""What the pictures are made from: one label's frame as the eye and as a free camera see it, and its light's maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from algorithms.projections.schema import read_projection
from experiments.rendering.engine import FrameLike, WarpEngine
from experiments.rendering.reference import AREA_TECHNIQUE, POINT_TECHNIQUE
from experiments.schema.experiment import Experiment
from experiments.schema.models import Reference, Views
from experiments.schema.techniques import TechniqueRun
from experiments.views.bodies import frustum_between
from experiments.views.free_camera import free_camera
from wkernels.analysis.light_layers import chosen_layers
from wkernels.frame.session import Session
from wkernels.projections.clipping import ConvexBody, box_polyhedron, clip_polyhedron, frustum_planes
from wkernels.projections.focusing import depth_range, light_body, seen_body
from wkernels.raster import Rasteriser
from wkernels.scene.geometry import CASTS, Bounds
from wkernels.scene.model import Camera
from wkernels.scene.views import HostView, LayerChoice, ProjectiveView


@dataclass(frozen=True, eq=False)
class Shot:
    """What one camera sees; arrays of its size, rebased world.

    Attributes:
        view: The camera.
        depth: Linear, +inf where nothing is seen.
        position, normal: (H, W, 3) float64.
        flags: Of the mesh, see ``wkernels.scene.geometry``; 0 where nothing is seen.
        color: Shaded by the technique, linear (H, W, 3).
        visibility: The technique's, NaN where nothing receives.
        layer: Which layer of the light map is read, -1 for none.
    """

    view: HostView
    depth: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flags: np.ndarray
    color: np.ndarray
    visibility: np.ndarray
    layer: np.ndarray


class Subject:
    """One label on one frame.

    Args:
        experiment: What is run.
        engine: Its renderer.
        run: The label.
        session: The label's session, which has just rendered the frame.
        result: What it rendered.
        frame: Frame number.
        reference: The frame's reference visibility (H, W), if one was made.

    Attributes:
        shots: By place, ``eye`` and ``third``.
        views: The light's views, one a layer; empty where the technique reads no light map.
        light_ws: The light sample (4,) that they belong to, rebased world.
        eye: The eye's view, its near plane where the maps have it.
        settings: What the projection was asked for.
    """

    def __init__(
        self,
        experiment: Experiment,
        engine: WarpEngine,
        run: TechniqueRun,
        session: Session,
        result: FrameLike,
        frame: int,
        reference: np.ndarray | None,
    ) -> None:
        assert experiment.views is not None
        self.options: Views = experiment.views
        self.experiment, self.engine, self.run, self.frame = experiment, engine, run, frame
        self.session, self.reference = session, reference
        self.geometry = engine.geometry
        self.settings = read_projection(run.projection or {})
        look = session.shown
        self.eye = (look and session.near_plane.used) or session.eye()
        self.views: list[HostView] = list(look.views) if look else []
        self.light_ws = np.asarray(look.light_ws if look else session.light.centre, float)
        self._camera = self._free_camera()
        self._result = result
        self._shots: dict[str, Shot] = {}

    # ---- cameras and what they see

    def shot(self, place: str) -> Shot:
        """What the eye (``eye``) or the free camera (``third``) sees."""
        if place not in self._shots:
            session = self._observer(place)
            result: FrameLike = self._result
            if place == "third":
                technique: Any = self.engine.plugins[self.run.name]
                result = session.render(technique(technique.Params(**self.run.params)))
            self._shots[place] = self._take(session, result)
        return self._shots[place]

    def truth(self, place: str) -> np.ndarray:
        """Ray-cast visibility (H, W) of a place: the run's reference, else the same rays for this camera."""
        if place == "eye" and self.reference is not None:
            return self.reference
        from algorithms.plugins import find

        technique: Any = find(AREA_TECHNIQUE if self._soft_reference else POINT_TECHNIQUE, [])
        samples = {"samples": self._soft_reference.samples} if self._soft_reference else {}
        return self._observer(place).render(technique(technique.Params(**samples))).visibility

    @property
    def truth_in_words(self) -> str:
        """What ``truth`` is."""
        if self._soft_reference:
            return f"ray cast to {self._soft_reference.samples} points of the light"
        return "ray cast to the light's centre"

    @property
    def _soft_reference(self) -> Reference | None:
        """The experiment's reference if it samples the light; None where one ray is the truth."""
        reference = self.experiment.reference
        soft = reference is not None and reference.light == "whole" and self.session.light.has_area
        return reference if soft else None

    def _observer(self, place: str) -> Session:
        """A session of its own, so that nothing of the timed one changes; it reads the very maps of that one."""
        image = self.options.image if place == "third" else self.experiment.image
        assert image is not None
        out = Session(
            self.geometry,
            width=image.width,
            height=image.height,
            light_index=self.experiment.light,
            device=self.engine.device,
            threads=self.engine.threads,
            seed=self.experiment.seed,
            projection=self._projection,
            skips=self.engine.skips,
            index=self.frame,
        )
        if place == "third":
            out.look(self._camera)
        return out

    def _projection(
        self, light_ws: np.ndarray, receivers: Bounds, casters: Bounds, resolution: int, eye: HostView
    ) -> list[HostView]:
        """The eye's maps, whoever looks at them."""
        if self.views and resolution == self.resolution and np.array_equal(light_ws, self.light_ws):
            return self.views
        return self.session.projection(light_ws, receivers, casters, resolution, self.eye)

    def _take(self, session: Session, result: FrameLike) -> Shot:
        gbuffer = session.gbuffer()
        layer = np.full(gbuffer.depth.shape, -1)
        if self.views:
            light_map = session.light_map(self.resolution, self.light_ws).map
            layer = chosen_layers(gbuffer, light_map, session.device, session.threads)
        return Shot(
            view=session.eye(),
            depth=gbuffer.depth.numpy().astype(float),
            position=gbuffer.position_ws.numpy().astype(float),
            normal=gbuffer.normal_ws.numpy().astype(float),
            flags=gbuffer.flags.numpy().copy(),
            color=np.array(result.color),
            visibility=np.array(result.visibility),
            layer=layer,
        )

    def _free_camera(self) -> Camera:
        origin, settings = self.geometry.origin_ws, self.options.third_person
        moved = {
            key: tuple(np.array(value) - origin)
            for key in ("eye", "target")
            if (value := getattr(settings, key)) is not None
        }
        box = self.scene_box
        corners = box.corners if not box.empty else self.eye.eye_ws[None]
        points = corners if self.whole.is_empty else self.whole.vertices
        image = self.options.image
        assert image is not None
        reach = float(np.linalg.norm(corners - self.eye.eye_ws, axis=1).max()) + float(np.ptp(corners, axis=0).max())
        up = self.geometry.scene.camera(self.frame).up
        chosen = free_camera(settings.model_copy(update=moved), self.eye, up, points, reach, image.width / image.height)
        return replace(chosen, eye=chosen.eye + origin, target=chosen.target + origin)

    # ---- the light's maps

    @property
    def resolution(self) -> int:
        """Texels per side of a layer."""
        return self.views[0].width

    @cached_property
    def map_depth(self) -> np.ndarray:
        """Linear depth of the casters, (layers, R, R), row 0 the top, +inf where nothing casts."""
        layers, size = len(self.views), self.resolution
        depth = wp.empty((layers, size, size), dtype=float, device=self.engine.device)
        rasteriser = Rasteriser(self.engine.device, self.engine.threads)
        views = [view.to_device() for view in self.views]
        geometry = self.geometry
        rasteriser.draw_many(geometry.points_ws, geometry.caster_indices, views, depth, cutouts=geometry.cutouts)
        out: np.ndarray = depth.numpy().copy()
        return out

    def to_light(self, points: np.ndarray) -> np.ndarray:
        """Unit ways to the light from points (..., 3)."""
        way = self.light_ws[:3] - points * self.light_ws[3]
        out: np.ndarray = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-30)
        return out

    def is_back_lit(self, shot: Shot) -> np.ndarray:
        """Pixels whose own surface hides the light, so that no map is read, (H, W)."""
        facing = np.einsum("...i,...i", shot.normal, self.to_light(shot.position))
        out: np.ndarray = (facing <= 0.0) & ((shot.flags & CASTS) != 0)
        return out

    # ---- what the maps have to cover

    @cached_property
    def receivers(self) -> Bounds:
        """Box of what receives; of everything where nothing does."""
        box = self.geometry.bounds(receivers=True)
        return self.scene_box if box.empty else box

    @cached_property
    def scene_box(self) -> Bounds:
        """Box of what casts or receives."""
        return self.geometry.bounds(casters=True, receivers=True)

    @cached_property
    def whole(self) -> ConvexBody:
        """H: the receivers' box in the eye's view; empty where it sees none."""
        return ConvexBody() if self.receivers.empty else seen_body(self.receivers, self.eye)

    @property
    def follows_eye(self) -> bool:
        """Whether the maps cover what the eye sees, not the whole scene."""
        return bool(self.views) and all(isinstance(view, ProjectiveView) for view in self.views)

    @cached_property
    def depths(self) -> tuple[float, float]:
        """Eye depths of what the eye sees of the receivers' box, which is what maps that follow the eye cover."""
        if self.whole.is_empty or not self.settings.adjust:
            return self.eye.near, self.eye.far
        near, far = depth_range(self.whole.vertices, self.eye)
        return (near, far) if near < far else (self.eye.near, self.eye.far)

    @cached_property
    def ranges(self) -> list[tuple[float, float]]:
        """Eye depths that each layer covers; the whole range for layers that are not depth splits."""
        near, far = self.depths
        found = [getattr(view, "choice", None) for view in self.views]
        choices = [choice for choice in found if isinstance(choice, LayerChoice)]
        ends = [min(choice.far, far) for choice in choices]
        if len(choices) != len(self.views) or any(b <= a for a, b in zip([near, *ends], ends, strict=False)):
            return [(near, far)] * len(self.views)
        return list(zip([near, *ends[:-1]], ends, strict=True))

    @property
    def is_split(self) -> bool:
        """Whether the layers are depth splits."""
        return len(set(self.ranges)) > 1

    @cached_property
    def parts(self) -> list[ConvexBody]:
        """H of each layer: what it has to cover for the eye, whether or not it covers more."""
        whole = self.whole
        if whole.is_empty:
            whole = box_polyhedron(self.receivers.low, self.receivers.high)
        row = np.append(self.eye.forward_ws, -float(self.eye.forward_ws @ self.eye.eye_ws))
        bodies = []
        for view, (near, far) in zip(self.views, self.ranges, strict=True):
            body = whole
            if self.is_split:
                body = clip_polyhedron(body, np.stack([row - (0, 0, 0, near), (0, 0, 0, far) - row]))
            if len(self.views) > 1 and not self.is_split:  # the faces of a cube: each its own share
                body = clip_polyhedron(body, _planes(view))
            bodies.append(body)
        return bodies

    @cached_property
    def light_bodies(self) -> list[ConvexBody]:
        """B of each layer: all light rays to what it covers, within the scene."""
        return [light_body(body, self.scene_box, self.light_ws) for body in self.parts]

    @cached_property
    def frusta(self) -> list[ConvexBody]:
        """The eye's frustum of each split; one where there are no splits."""
        ranges: Sequence[tuple[float, float]] = self.ranges if self.views and self.is_split else [self.depths]
        return [frustum_between(self.eye, near, far) for near, far in ranges]

    def in_eye_view(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether points (..., 3) lie in the eye's frustum, and whether the eye also sees them, (...) each."""
        rows = self.eye.ws_to_ss
        h = points @ rows[:, :3].T + rows[:, 3]
        w = np.where(h[..., 3] > 0.0, h[..., 3], np.nan)
        x, y = h[..., 0] / w, h[..., 1] / w
        inside = (np.abs(x) <= 1.0) & (np.abs(y) <= 1.0) & (h[..., 2] >= self.eye.near) & (h[..., 2] <= self.eye.far)
        depth = self.shot("eye").depth
        height, width = depth.shape
        column = np.clip(np.nan_to_num((0.5 + 0.5 * x) * width), 0, width - 1).astype(int)
        row = np.clip(np.nan_to_num((0.5 - 0.5 * y) * height), 0, height - 1).astype(int)
        # the deepest of the neighbours, or surfaces seen at a slant would hide themselves between pixels
        padded = np.pad(np.where(np.isfinite(depth), depth, 0.0), 1)
        shifts = [(i, j) for i in range(3) for j in range(3)]
        reach = np.max([padded[i : i + height, j : j + width] for i, j in shifts], axis=0)
        return inside, inside & (h[..., 2] <= 1.003 * reach[row, column])


def _planes(view: HostView) -> np.ndarray:
    """Side and near planes of a light's view, (n, 4)."""
    return frustum_planes(view.ws_to_ss, max(view.near, 1e-6 * view.far), 2.0 * view.far)[:5]

"""USD stages: meshes, implicit shapes, point instancers, UsdLux lights, cameras, skeletons, and what is animated."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.scenes.importing.deformation import SampledVertices
from experiments.scenes.importing.description import (
    Asked,
    Grey,
    ImportedCamera,
    ImportedLight,
    ImportedScene,
    Instance,
    Shape,
    each_frame,
    frame_count,
    rigid,
)
from experiments.scenes.importing.usd_lights import usd_light
from experiments.scenes.importing.usd_masks import masked_triangles
from experiments.scenes.meshes.axes import TO_Y_UP
from experiments.scenes.meshes.reading import MeshError
from experiments.scenes.meshes.usd import NOT_UTF8, drawn_prims, open_stage
from experiments.scenes.meshes.usd_prims import prim_triangles
from wkernels.errors import one_line

Key = tuple[str, int]  # path of a prim, and which of its copies in point instancers


@dataclass
class _Drawn:
    """A prim that is drawn, and where on every frame."""

    prim: Any
    poses: list[np.ndarray]


def read(path: Path, asked: Asked) -> ImportedScene:
    """The stage, in metres if it says its unit and with y up; raises MeshError."""
    if importlib.util.find_spec("pxr") is None:
        raise MeshError("is USD, which needs an extra: pip install 'wkernels[formats]'.")
    from pxr import Tf

    try:
        stage = open_stage(path)
        for error in stage.GetCompositionErrors():
            asked.tell(f"is incomplete: {one_line(error)}.")
        return _Reader(stage, asked).scene()
    except Tf.ErrorException as error:
        raise MeshError(f"cannot be read: {one_line(error)}.") from None
    except UnicodeDecodeError:
        raise MeshError(NOT_UTF8) from None


class _Reader:
    """One stage while it is read."""

    def __init__(self, stage: Any, asked: Asked) -> None:
        self._stage, self._tell = stage, asked.tell
        self._out = ImportedScene()
        self._times = self._frames(asked)
        self._out.frames = len(self._times)
        self._shapes: dict[str, int] = {}  # by prim, or by prototype of its native instances

    def scene(self) -> ImportedScene:
        """Everything on the stage."""
        self._set_units()
        self._bake_skeletons()
        self._add_meshes()
        unsupported: Counter[str] = Counter()
        for prim in self._placed_prims():
            self._add_light_or_camera(prim, unsupported)
        for kind, count in sorted(unsupported.items()):
            self._tell(f"left out: {count} {kind}.")
        return self._out

    def _frames(self, asked: Asked) -> list[Any]:
        """The time code of every frame; one where nothing is animated, or nothing shall be."""
        from pxr import Usd

        stage = self._stage
        rest = [
            Usd.TimeCode(stage.GetStartTimeCode()) if stage.HasAuthoredTimeCodeRange() else Usd.TimeCode.EarliestTime()
        ]
        if asked.animation not in (None, "none"):
            raise MeshError(f"has no animation {asked.animation!r}: a stage has only one.")
        start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
        if asked.animation == "none" or not (stage.HasAuthoredTimeCodeRange() and end > start):
            return rest
        per_second = stage.GetTimeCodesPerSecond()
        if not 0.0 < per_second < float("inf"):
            raise MeshError(f"has {per_second:g} time codes per second.")
        fps = asked.fps or per_second
        count = frame_count((end - start) / per_second, fps)
        self._out.notes.append(f"time codes {start:g} to {end:g}: {count} frames at {fps:g} per second")
        return [Usd.TimeCode(start + frame * per_second / fps) for frame in range(count)]

    def _set_units(self) -> None:
        from pxr import UsdGeom

        up, unit = str(UsdGeom.GetStageUpAxis(self._stage)), 1.0
        if UsdGeom.StageHasAuthoredMetersPerUnit(self._stage):
            unit = float(UsdGeom.GetStageMetersPerUnit(self._stage))
        if not 0.0 < unit < float("inf"):
            raise MeshError(f"its unit is {unit:g} m.")
        if up not in TO_Y_UP:
            raise MeshError(f"has the up axis {up or 'nothing'}, which is none.")
        self._out.to_scene = np.eye(4)
        self._out.to_scene[:3, :3] = unit * TO_Y_UP[up]
        if up != "Y":
            self._out.notes.append(f"its up axis {up} is turned to y")
        if unit != 1.0:
            self._out.notes.append(f"its unit is {unit:g} m; it is scaled to metres")

    def _bake_skeletons(self) -> None:
        """Writes what skeletons and blend shapes do to points into the session's layer, as samples in time."""
        from pxr import Gf, Usd, UsdSkel

        if not any(prim.IsA(UsdSkel.Root) for prim in self._stage.Traverse()):
            return
        self._stage.SetEditTarget(self._stage.GetSessionLayer())
        interval = Gf.Interval(self._times[0].GetValue(), self._times[-1].GetValue())
        everything = Usd.PrimRange(self._stage.GetPseudoRoot())
        if not UsdSkel.BakeSkinning(everything, interval):
            self._tell("its skeletons cannot be applied; skinned meshes are drawn at rest.")

    # ---- meshes ----

    def _add_meshes(self) -> None:
        dropped: Counter[str] = Counter()
        drawn = self._drawn_at(self._times[0], dropped)
        order = list(drawn)
        moving = len(self._times) > 1
        for time in self._times[1:] if moving else []:
            now = self._drawn_at(time, Counter())
            if now.keys() != drawn.keys():
                self._tell("what appears or vanishes is drawn as on the first frame.")
            for key, one in drawn.items():
                one.poses.append(now[key].poses[0] if key in now else one.poses[-1])
        for key in order:
            self._add_mesh(drawn[key], dropped)
        if dropped:
            self._tell(
                "left out: " + ", ".join(f"{count} prims {what}" for what, count in sorted(dropped.items())) + "."
            )

    def _drawn_at(self, time: Any, dropped: Counter[str]) -> dict[Key, _Drawn]:
        copies: Counter[str] = Counter()
        out: dict[Key, _Drawn] = {}
        for prim, to_stage in drawn_prims(self._stage, time, dropped):
            path = str(prim.GetPath())
            out[path, copies[path]] = _Drawn(prim, [to_stage])
            copies[path] += 1
        return out

    def _add_mesh(self, one: _Drawn, dropped: Counter[str]) -> None:
        prim = one.prim
        kept = str(prim.GetPrimInPrototype().GetPath()) if prim.IsInstanceProxy() else str(prim.GetPath())
        if kept not in self._shapes:
            found = prim_triangles(prim, self._times[0], self._tell)
            if found is None:
                dropped[f"of type {prim.GetTypeName()}"] += 1
                return
            vertices, faces = (np.asarray(part) for part in found)
            shape = Shape(vertices, faces, self._samples(prim, vertices, faces))
            if (masked := masked_triangles(prim, self._times[0], self._tell)) is not None:
                if shape.deformation is None:
                    shape = Shape(masked.vertices, masked.faces, mask=masked.mask)
                else:
                    self._tell(f"the opacity mask of {prim.GetPath()}, whose points move, is left out; it is opaque.")
            self._shapes[kept] = self._out.add(shape)
        pose = each_frame(np.array(one.poses))
        self._out.instances.append(Instance(prim.GetName(), self._shapes[kept], pose, _diffuse(prim, self._times[0])))

    def _samples(self, prim: Any, vertices: np.ndarray, faces: np.ndarray) -> SampledVertices | None:
        """Points on every frame, where they vary and the faces do not."""
        names = ("points", "size", "radius", "height", "width", "length", "radiusTop", "radiusBottom")
        held = [prim.GetAttribute(name) for name in names if prim.HasAttribute(name)]
        if len(self._times) == 1 or not any(attribute.ValueMightBeTimeVarying() for attribute in held):
            return None
        positions = [vertices]
        for time in self._times[1:]:
            found = prim_triangles(prim, time, self._tell)
            if found is None or not np.array_equal(found[1], faces):
                self._tell(f"the faces of {prim.GetPath()} change with time; it is drawn as on the first frame.")
                return None
            positions.append(np.asarray(found[0]))
        stacked = np.array(positions, np.float32 if max(map(len, positions)) > 100_000 else np.float64)
        return (
            None if np.array_equal(stacked, np.broadcast_to(stacked[:1], stacked.shape)) else SampledVertices(stacked)
        )

    # ---- lights and cameras ----

    def _placed_prims(self) -> Iterator[Any]:
        """All prims but those below point instancers, which are there only as their copies."""
        from pxr import Usd, UsdGeom

        prims = iter(Usd.PrimRange(self._stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        for prim in prims:
            if prim.IsA(UsdGeom.PointInstancer):
                prims.PruneChildren()
            yield prim

    def _add_light_or_camera(self, prim: Any, unsupported: Counter[str]) -> None:
        from pxr import UsdGeom, UsdLux

        first = self._times[0]
        if prim.IsA(UsdGeom.Camera):
            self._out.cameras.append(self._camera(prim))
            return
        if not prim.HasAPI(UsdLux.LightAPI):
            return
        if UsdGeom.Imageable(prim).ComputeVisibility(first) == UsdGeom.Tokens.invisible:
            unsupported["lights that are invisible"] += 1
            return
        if prim.IsA(UsdGeom.Gprim):
            unsupported["meshes that shine, as lights"] += 1
            return
        light = usd_light(prim, first, self._tell)
        if light is None:
            unsupported[f"lights of type {prim.GetTypeName()}"] += 1
        else:
            self._out.lights.append(ImportedLight(prim.GetName(), light, self._poses(prim)))

    def _poses(self, prim: Any) -> np.ndarray:
        from pxr import UsdGeom

        imageable = UsdGeom.Imageable(prim)
        poses = [np.array(imageable.ComputeLocalToWorldTransform(time)).T for time in self._times]
        return each_frame(np.array(poses))

    def _camera(self, prim: Any) -> ImportedCamera:
        from pxr import Gf, UsdGeom

        lens = UsdGeom.Camera(prim).GetCamera(self._times[0])
        near, far = lens.clippingRange.min, lens.clippingRange.max
        name, pose = prim.GetName(), each_frame(rigid(self._poses(prim)))
        if lens.horizontalApertureOffset or lens.verticalApertureOffset:
            self._tell(f"the aperture offset of camera {name!r} is left out.")
        if not lens.verticalAperture > 0.0:
            raise MeshError(f"camera {name!r} has the vertical aperture {lens.verticalAperture:g}.")
        if lens.projection == Gf.Camera.Orthographic:
            height = float(lens.verticalAperture * Gf.Camera.APERTURE_UNIT)
            return ImportedCamera(name, pose, height=height, near=near, far=far)
        fov = float(lens.GetFieldOfView(Gf.Camera.FOVVertical))
        if not 0.0 < fov < 180.0:
            raise MeshError(f"camera {name!r} has the field of view {fov:g} degrees.")
        return ImportedCamera(name, pose, fov_deg=fov, near=near, far=far)


def _diffuse(prim: Any, time: Any) -> Grey | None:
    """The prim's constant display colour; None where it has none, or one for each vertex."""
    from pxr import UsdGeom

    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    values = np.array(primvar.Get(time) if primvar and primvar.HasValue() else [], np.float64).reshape(-1, 3)
    if len(values) != 1 or not np.isfinite(values).all():
        return None
    red, green, blue = np.clip(values[0], 0.0, 1.0).tolist()
    return red, green, blue

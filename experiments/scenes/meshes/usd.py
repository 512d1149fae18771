"""USD stages as one mesh: meshes and implicit shapes of all prims that are drawn, point instancers included."""

from __future__ import annotations

import importlib.util
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from experiments.scenes.meshes.axes import TO_Y_UP
from experiments.scenes.meshes.reading import MeshError, Parts, Tell, check_indices, plain_bytes
from experiments.scenes.meshes.usd_binary import check_binary
from experiments.scenes.meshes.usd_prims import attribute_values, prim_triangles
from experiments.scenes.primitives import Triangles
from wkernels.errors import one_line

NOT_UTF8 = "cannot be read: it has a name or a word that is not UTF-8 text."
"""Of files that Python cannot be told of by USD."""
_DEEPEST = 16  # levels of instancers within prototypes


def read(path: Path, tell: Tell) -> Triangles:
    """All triangles at the first time sample, turned so that y is up; lengths stay in the stage's units."""
    if importlib.util.find_spec("pxr") is None:
        raise MeshError("USD files need an extra: pip install 'wkernels[formats]'.")
    from pxr import Tf

    try:
        return _read(open_stage(path), tell)
    except Tf.ErrorException as error:
        raise MeshError(f"cannot be read: {one_line(error)}.") from None
    except UnicodeDecodeError:
        raise MeshError(NOT_UTF8) from None


def open_stage(path: Path) -> Any:
    """The stage of a file, whose attributes have values of the types that their schemas give them.

    Text that is not UTF-8 is taken for Latin-1, and a byte order mark is left out.

    Raises:
        Tf.ErrorException: USD cannot read it.
        MeshError: USD would end the process, or an attribute is of another type.
    """
    stage = _opened(path)
    _check_types(stage)
    return stage


def _opened(path: Path) -> Any:
    from pxr import Sdf, Usd

    data = path.read_bytes()
    check_binary(path, data)
    text = plain_bytes(data)
    if text.startswith(b"#usda"):
        try:
            words = text.decode()
        except UnicodeDecodeError:
            words = text.decode("latin-1")
        if words.encode() != data:  # USD itself refuses such layers
            identifier = str(path.resolve())
            layer = Sdf.Layer.Find(identifier) or Sdf.Layer.New(Sdf.FileFormat.FindById("usda"), identifier)
            if layer.ImportFromString(words):
                return Usd.Stage.Open(layer)
    return Usd.Stage.Open(str(path))


def _check_types(stage: Any) -> None:
    """Raises MeshError where an attribute was written with another type than its schema's, which USD lets pass."""
    for prim in stage.TraverseAll():
        for attribute in prim.GetAuthoredAttributes():
            wanted = attribute.GetTypeName()
            for spec in attribute.GetPropertyStack():
                if spec.typeName != wanted:
                    raise MeshError(f"{attribute.GetPath()} is of the type {spec.typeName}, not {wanted}.")


def _read(stage: Any, tell: Tell) -> Triangles:
    from pxr import Usd, UsdGeom

    for fault in stage.GetCompositionErrors():
        tell(f"is incomplete: {one_line(fault)}.")
    parts, time = Parts(), Usd.TimeCode.EarliestTime()
    dropped: Counter[str] = Counter()
    turn = np.eye(4)
    up = str(UsdGeom.GetStageUpAxis(stage))
    if up not in TO_Y_UP:
        raise MeshError(f"has the up axis {up}, which is none.")
    if up != "Y":
        turn[:3, :3] = TO_Y_UP[up]
        tell(f"its up axis {up} is turned to y.")
    for prim, to_stage in drawn_prims(stage, time, dropped):
        found = prim_triangles(prim, time, tell)
        if found is None:
            dropped[f"of type {prim.GetTypeName()}"] += 1
        elif not np.isfinite(to_stage).all():
            raise MeshError(f"the transform of {prim.GetPath()} is not finite.")
        else:
            parts.add_placed(*found, turn @ to_stage)
    if dropped:
        tell("left out: " + ", ".join(f"{count} prims {what}" for what, count in sorted(dropped.items())) + ".")
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if UsdGeom.StageHasAuthoredMetersPerUnit(stage) and unit != 1.0:
        tell(f"its unit is {unit:g} m; lengths are not scaled.")
    if skinned := sum(_is_skinned(prim) for prim in stage.Traverse()):
        what = "mesh is" if skinned == 1 else "meshes are"
        tell(f"its skeletons are not applied: {skinned} {what} drawn at rest; import: moves them.")
    if any(_varies(prim) for prim in stage.Traverse()):
        tell("it is animated; it is drawn as at its first time sample.")
    return parts.triangles()


def drawn_prims(stage: Any, time: Any, dropped: Counter[str]) -> Iterator[tuple[Any, np.ndarray]]:
    """The prims with an extent that a renderer draws, each with its matrix to stage space, float64 (4, 4).

    Prims that are invisible or of purpose guide or proxy are not, and are counted in ``dropped``, by the reason; the
    prototypes of a point instancer are drawn where its instances are, and nowhere else.
    """
    yield from _drawn_below(stage.GetPseudoRoot(), np.eye(4), None, time, dropped, 0)


def _drawn_below(
    root: Any, root_to_stage: np.ndarray, root_to_world: np.ndarray | None, time: Any, dropped: Counter[str], depth: int
) -> Iterator[tuple[Any, np.ndarray]]:
    """Prims at and below ``root``; where it is a prototype, ``root_to_world`` is its matrix at its own place."""
    from pxr import Usd, UsdGeom

    from_root = np.eye(4) if root_to_world is None else root_to_stage @ np.linalg.inv(root_to_world)
    prims = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim.IsPseudoRoot() or not prim.IsA(UsdGeom.Imageable):
            continue
        imageable = UsdGeom.Imageable(prim)
        instancer = prim.IsA(UsdGeom.PointInstancer)
        if instancer:
            prims.PruneChildren()
        if not (instancer or prim.IsA(UsdGeom.Boundable)) or prim.GetTypeName() in _WITHOUT_SURFACE:
            continue
        if imageable.ComputeVisibility(time) == UsdGeom.Tokens.invisible:
            dropped["that are invisible"] += 1
            continue
        purpose = str(imageable.ComputePurpose())
        if purpose in ("guide", "proxy"):
            dropped[f"of purpose {purpose}"] += 1
            continue
        to_stage = from_root @ _world(imageable, time)
        if not instancer:
            yield prim, to_stage
        elif depth >= _DEEPEST:
            raise MeshError(f"the point instancer {prim.GetPath()} is a prototype of itself.")
        else:
            for prototype, matrix in _instances(UsdGeom.PointInstancer(prim), time):
                own = _world(UsdGeom.Imageable(prototype), time)
                yield from _drawn_below(prototype, to_stage @ matrix, own, time, dropped, depth + 1)


def _instances(instancer: Any, time: Any) -> Iterator[tuple[Any, np.ndarray]]:
    """Prototype and its matrix to the instancer's space of every instance that is not masked out."""
    path = instancer.GetPath()
    paths = instancer.GetPrototypesRel().GetForwardedTargets()
    index = attribute_values(instancer.GetProtoIndicesAttr(), time, np.int64)
    check_indices(index, len(paths), what=f"an instance of {path}")
    if len(attribute_values(instancer.GetPositionsAttr(), time, np.float64)) != len(index):
        raise MeshError(f"the point instancer {path} has not as many positions as instances.")
    matrices = instancer.ComputeInstanceTransformsAtTime(time, time)
    mask = instancer.ComputeMaskAtTime(time)
    if mask:
        index = index[np.array(mask, bool)]
    if len(matrices) != len(index):
        raise MeshError(f"the point instancer {path} has attributes of different lengths.")
    for which, matrix in zip(index.tolist(), matrices, strict=True):
        prototype = instancer.GetPrim().GetStage().GetPrimAtPath(paths[which])
        if not prototype:
            raise MeshError(f"the point instancer {path} names a prototype that is missing: {paths[which]}.")
        yield prototype, np.array(matrix).T


def _world(imageable: Any, time: Any) -> np.ndarray:
    return np.array(imageable.ComputeLocalToWorldTransform(time)).T  # USD multiplies row vectors from the left


def _is_skinned(prim: Any) -> bool:
    """Whether a skeleton or blend shapes would move a prim's points."""
    from pxr import UsdGeom, UsdSkel

    if not prim.IsA(UsdGeom.Mesh):
        return False
    binding = UsdSkel.BindingAPI(prim)
    joints = binding.GetJointIndicesPrimvar()
    return bool((joints and joints.HasAuthoredValue()) or binding.GetBlendShapeTargetsRel().HasAuthoredTargets())


def _varies(prim: Any) -> bool:
    """Whether a transform or a shape changes with time."""
    from pxr import UsdGeom

    if prim.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(prim).TransformMightBeTimeVarying():
        return True
    return prim.IsA(UsdGeom.Gprim) and any(
        prim.GetAttribute(name).ValueMightBeTimeVarying()
        for name in ("points", "size", "radius", "height", "visibility")
        if prim.HasAttribute(name)
    )


_WITHOUT_SURFACE = {
    *("RectLight", "DiskLight", "SphereLight", "CylinderLight", "PortalLight", "GeometryLight", "DomeLight"),
    *("DomeLight_1", "DistantLight", "PluginLight", "SkelRoot", "Skeleton", "Volume"),
}

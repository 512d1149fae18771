"""Mesh files: every format gives the same triangles, broken parts are left out, missing readers are named."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from experiments.config.source import from_dict
from experiments.scenes import load_scene
from experiments.scenes.files import read_triangles
from experiments.scenes.place import Place
from wkernels.errors import InputError


def read(path: Path):
    return read_triangles(path.name, Place(from_dict({}), path.parent))


def solid(triangles) -> trimesh.Trimesh:
    return trimesh.Trimesh(*triangles, process=False)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb", "dae"])
def test_formats_give_the_same_closed_mesh(tmp_path: Path, suffix: str):
    original = trimesh.creation.torus(2.0, 0.5)
    file = tmp_path / f"torus.{suffix}"
    original.export(file)
    vertices, faces = read(file)
    shape = solid((vertices, faces))
    assert vertices.dtype == np.float64 and faces.dtype == np.int32
    assert len(faces) == len(original.faces)
    assert shape.is_watertight  # STL has no shared vertices, they are welded
    assert shape.volume == pytest.approx(original.volume, rel=1e-5)
    np.testing.assert_allclose(shape.bounds, original.bounds, atol=1e-6)


def test_scene_graph_of_a_glb_is_applied(tmp_path: Path):
    box = trimesh.creation.box()
    graph = trimesh.Scene()
    graph.add_geometry(box, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    graph.add_geometry(box, transform=trimesh.transformations.scale_matrix(2.0))
    graph.export(tmp_path / "two.glb")
    shape = solid(read(tmp_path / "two.glb"))
    assert shape.volume == pytest.approx(9.0)
    np.testing.assert_allclose(shape.bounds, [[-1, -1, -1], [5.5, 1, 1]])


def write_usd(path: Path, left_handed: bool = False, scale: tuple[float, float, float] = (1, 1, 1)) -> None:
    from pxr import Gf, Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(path))
    parent = UsdGeom.Xform.Define(stage, "/root")
    parent.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    parent.AddScaleOp().Set(Gf.Vec3f(*scale))
    for name, hidden in (("cube", False), ("hidden", True)):
        mesh = UsdGeom.Mesh.Define(stage, f"/root/{name}")
        corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        mesh.GetPointsAttr().Set(corners)
        mesh.GetFaceVertexCountsAttr().Set([4] * 6)
        order = -1 if left_handed else 1
        mesh.GetFaceVertexIndicesAttr().Set([i for quad in quads for i in quad[::order]])
        if left_handed:
            mesh.GetOrientationAttr().Set(UsdGeom.Tokens.leftHanded)
        if hidden:
            mesh.MakeInvisible()
    stage.Save()


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 1, -3)])
def test_usd_transforms_orientation_fans_and_visibility(tmp_path: Path, left_handed: bool, scale):
    pytest.importorskip("pxr")
    write_usd(tmp_path / "cube.usda", left_handed, scale)
    shape = solid(read(tmp_path / "cube.usda"))
    assert len(shape.faces) == 12 and shape.is_watertight
    size = np.abs(np.array(scale, float))
    assert shape.volume == pytest.approx(8.0 * size.prod())  # positive: faces outwards in each of the four cases
    np.testing.assert_allclose(shape.bounds, [np.array([1, 2, 3]) - size, np.array([1, 2, 3]) + size])


def test_warp_assets():
    pytest.importorskip("pxr")
    place = Place(from_dict({}), Path())
    bunny = solid(read_triangles("warp:bunny.usd", place))
    assert bunny.is_watertight and bunny.volume > 0 and len(bunny.faces) == 12200
    assert len(read_triangles("warp:rocks.usd", place)[1]) == 10870


def test_triangles_with_non_finite_vertices_are_left_out_with_a_warning(tmp_path: Path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 1 0\nv 0 inf 1\nf 1 2 3\nf 1 2 4\nf 5 2 3\nf 1 1 2\n"
    (tmp_path / "part.obj").write_text(text)
    file = tmp_path / "scene.yaml"
    file.write_text(
        "meshes:\n  - {file: part.obj}\nlights: [{kind: point, position: [0, 1, 0]}]\n"
        "camera: {eye: [0, 0, 5], target: [0, 0, 0]}\n"
    )
    with pytest.warns(UserWarning, match=r"scene.yaml:2: .*2 of 4 triangles have non-finite vertices"):
        mesh = load_scene(file).meshes[0]
    assert len(mesh.faces) == 2  # the one without area stays
    assert np.all(np.isfinite(mesh.vertices)) and len(mesh.vertices) == 3


@pytest.mark.parametrize(("module", "name", "what"), [("pxr", "a.usd", "USD"), ("collada", "a.dae", "Collada")])
def test_missing_readers_name_the_extra(tmp_path: Path, monkeypatch, module: str, name: str, what: str):
    (tmp_path / name).write_text("")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"{what} files need an extra: .*wkernels\[formats\]"):
        read(tmp_path / name)


def test_faces_that_use_missing_vertices(tmp_path: Path):
    (tmp_path / "bad.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"
    )
    with pytest.raises(InputError, match=r"bad\.ply': line 13: a face uses vertex 7, but they run from 0 to 2"):
        read(tmp_path / "bad.ply")

"""glTF as the specification has it: every way to say two plates gives two plates, and what is wrong is refused."""

from __future__ import annotations

import base64
import copy
import json
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from experiments.scenes.meshes.gltf_document import Document
from tests.scenes.mesh_cases import CASES, assert_same, read, solid, written
from wkernels.errors import InputError

GLTF = CASES / "gltf"
TRIANGLES = read(CASES / "obj" / "plain.obj")
SAME = ["hierarchy", "mirror", "quant_i16norm", "gpu_instancing_required", "sparse", "strip_fan", "morph", "two_prims"]


@pytest.mark.parametrize("name", [*(f"{stem}.glb" for stem in SAME), "ext space.gltf"])
def test_cases_that_are_two_plates(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = read(GLTF / name)
    if name == "strip_fan.glb":  # the strip has the other diagonal
        assert solid(mesh).area == pytest.approx(1.64)
        np.testing.assert_allclose(solid(mesh).bounds, solid(TRIANGLES).bounds)
        assert np.all(solid(mesh).face_normals[:, 1] > 0.99)
    elif name == "mirror.glb":  # its node turns one plate over; outside stays outside
        assert sorted(solid(mesh).face_normals[:, 1].round(6).tolist()) == [-1, -1, 1, 1]
        np.testing.assert_allclose(solid(mesh).bounds, solid(TRIANGLES).bounds, atol=1e-6)
    else:
        assert_same(mesh, TRIANGLES)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("unknown_required.glb", r"requires VENDOR_unknown_geometry, which is not supported"),
        ("nan_translation.glb", r"the translation of node 0 is not finite"),
        ("index_out.glb", r"primitive 0 of mesh 0 uses vertex 9, but they run from 0 to 3"),
    ],
)
def test_cases_that_are_refused(name: str, message: str):
    with pytest.raises(InputError, match=rf"{name}.*{message}"):
        read(GLTF / name)


def test_draco_is_decoded():
    pytest.importorskip("DracoPy")
    mesh = solid(read(GLTF / "draco_required.glb"))
    assert mesh.area == pytest.approx(1.64, abs=1e-3)
    np.testing.assert_allclose(mesh.bounds, solid(TRIANGLES).bounds, atol=1e-3)


def test_draco_without_a_decoder_is_refused_by_name(monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(InputError, match=r"KHR_draco_mesh_compression.*wkernels\[formats\]"):
        read(GLTF / "draco_required.glb")


@pytest.mark.parametrize("damage", [slice(0, 5), slice(11, 14), slice(30, None)])
def test_draco_that_is_damaged_is_refused_by_name(tmp_path: Path, damage: slice):
    pytest.importorskip("DracoPy")
    document = Document(GLTF / "draco_required.glb")
    payload = bytearray(document.view_bytes(0)[0])
    payload[damage] = b"\xff" * len(payload[damage])
    data = with_buffer(document.json, bytes(payload))
    with pytest.raises(InputError, match=r"KHR_draco_mesh_compression and cannot be decoded|uses vertex"):
        read(written(tmp_path, "a.gltf", json.dumps(data)))


def test_masks_are_told_to_be_solid():
    with pytest.warns(UserWarning, match=r"1 materials with alphaMode MASK are drawn opaque"):
        read(GLTF / "alpha.glb")


def with_buffer(data: dict, payload: bytes) -> dict:
    uri = "data:application/octet-stream;base64," + base64.b64encode(payload).decode()
    return {**copy.deepcopy(data), "buffers": [{"byteLength": len(payload), "uri": uri}]}


class Maker:
    """A glTF of one node and mesh, whose accessors are appended."""

    def __init__(self) -> None:
        self.data: dict = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "scene": 0, "bufferViews": []}
        self.data |= {"accessors": [], "nodes": [{"mesh": 0}], "meshes": [{"primitives": []}]}
        self.payload = b""

    def add(self, values, dtype: str, kind: str, **more) -> int:
        values = np.asarray(values, dtype)
        self.data["bufferViews"].append({"buffer": 0, "byteOffset": len(self.payload), "byteLength": values.nbytes})
        self.payload += values.tobytes() + b"\0" * (-values.nbytes % 4)
        component = {"i1": 5120, "u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}[dtype]
        view = len(self.data["bufferViews"]) - 1
        accessor = {"bufferView": view, "componentType": component, "count": len(values), "type": kind, **more}
        self.data["accessors"].append(accessor)
        return len(self.data["accessors"]) - 1

    def primitive(self, **more) -> dict:
        out = {"attributes": {"POSITION": self.add(TRIANGLES[0], "<f4", "VEC3")}, **more}
        self.data["meshes"][0]["primitives"].append(out)
        return out

    def faces(self, faces=None, dtype: str = "<u2") -> int:
        return self.add(np.ravel(TRIANGLES[1] if faces is None else faces), dtype, "SCALAR")

    def read(self, folder: Path):
        return read(written(folder, "a.gltf", json.dumps(with_buffer(self.data, self.payload))))


@pytest.mark.parametrize("dtype", ["u1", "<u2", "<u4"])
def test_indices_of_every_type(tmp_path: Path, dtype: str):
    maker = Maker()
    maker.primitive(indices=maker.faces(dtype=dtype))
    assert_same(maker.read(tmp_path), TRIANGLES)


def test_without_indices(tmp_path: Path):
    maker = Maker()
    corners = TRIANGLES[0][TRIANGLES[1]].reshape(-1, 3)
    maker.data["meshes"][0]["primitives"] = [{"attributes": {"POSITION": maker.add(corners, "<f4", "VEC3")}}]
    assert_same(maker.read(tmp_path), TRIANGLES)


@pytest.mark.parametrize(
    ("dtype", "normalised", "scale"),
    [
        ("i1", True, 127),
        ("u1", True, 255),
        ("<i2", True, 32767),
        ("<u2", True, 65535),
        ("<i2", False, 1),
        ("u1", False, 1),
    ],
)
def test_quantised_positions(tmp_path: Path, dtype: str, normalised: bool, scale: int):
    """In steps of a tenth, which every type holds: as they are, or as shares of the greatest value, shifted above 0."""
    maker = Maker()
    tenths = np.round((TRIANGLES[0] + [1.5, 0, 0.5]) * 10)
    quantised = tenths if not normalised else np.round(tenths / 30 * scale)
    position = maker.add(quantised, dtype, "VEC3", **({"normalized": True} if normalised else {}))
    maker.data["meshes"][0]["primitives"] = [{"attributes": {"POSITION": position}, "indices": maker.faces()}]
    factor = 3.0 if normalised else 0.1
    maker.data["nodes"][0] |= {"scale": [factor] * 3, "translation": [-1.5, 0, -0.5]}
    maker.data["extensionsRequired"] = ["KHR_mesh_quantization"]
    vertices, _ = maker.read(tmp_path)
    np.testing.assert_allclose(vertices, TRIANGLES[0], atol=0.5 * factor / scale + 1e-6 if normalised else 1e-6)


def test_stride_and_offset(tmp_path: Path):
    maker = Maker()
    wide = np.full((8, 5), 99.0)
    wide[:, 1:4] = TRIANGLES[0]
    position = maker.add(wide, "<f4", "VEC3", byteOffset=4)
    maker.data["bufferViews"][0]["byteStride"] = 20
    maker.data["meshes"][0]["primitives"] = [{"attributes": {"POSITION": position}, "indices": maker.faces()}]
    assert_same(maker.read(tmp_path), TRIANGLES)


def test_strips_turn_every_second_triangle(tmp_path: Path):
    maker = Maker()
    maker.primitive(indices=maker.faces([0, 1, 3, 2]), mode=5)
    vertices, faces = maker.read(tmp_path)
    assert len(faces) == 2 and np.all(solid((vertices, faces)).face_normals[:, 1] > 0.99)


def test_sparse_without_a_base(tmp_path: Path):
    maker = Maker()
    values = maker.add(TRIANGLES[0], "<f4", "VEC3")
    at = maker.add(np.arange(8), "u1", "SCALAR")
    sparse = {"count": 8, "indices": {"bufferView": at, "componentType": 5121}, "values": {"bufferView": values}}
    maker.data["accessors"].append({"componentType": 5126, "count": 8, "type": "VEC3", "sparse": sparse})
    maker.data["meshes"][0]["primitives"] = [{"attributes": {"POSITION": 2}, "indices": maker.faces()}]
    assert_same(maker.read(tmp_path), TRIANGLES)


def test_weights_of_a_node_win_over_those_of_its_mesh(tmp_path: Path):
    maker = Maker()
    primitive = maker.primitive(indices=maker.faces())
    offset = maker.add(np.tile([0, 4, 0], (8, 1)), "<f4", "VEC3")
    primitive["targets"] = [{"NORMAL": offset}, {"POSITION": offset}]
    maker.data["meshes"][0]["weights"] = [1.0, 1.0]
    maker.data["nodes"][0]["weights"] = [1.0, 0.25]
    vertices, faces = maker.read(tmp_path)
    assert_same((vertices - [0, 1, 0], faces), TRIANGLES)


def test_instances_turn_and_scale(tmp_path: Path):
    maker = Maker()
    maker.primitive(indices=maker.faces())
    half = np.sqrt(0.5)
    attributes = {
        "TRANSLATION": maker.add([[0, 0, 0], [9, 0, 0]], "<f4", "VEC3"),
        "ROTATION": maker.add(
            np.round(np.array([[0, 0, 0, 1], [0, half, 0, half]]) * 32767), "<i2", "VEC4", normalized=True
        ),
    }
    maker.data["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    vertices, faces = maker.read(tmp_path)
    assert len(faces) == 8
    assert_same((vertices[:8], faces[:4]), TRIANGLES)
    x, y, z = vertices[8:].T
    assert_same((np.stack([-z, y, x - 9], axis=1), faces[4:] - 8), TRIANGLES)  # a quarter turn about y


def test_a_skin_moves_vertices_with_its_joints_and_not_with_its_node(tmp_path: Path):
    maker = Maker()
    primitive = maker.primitive(indices=maker.faces())
    joints = np.zeros((8, 4))
    joints[4:, 0] = 1
    weights = np.tile([0.5, 0.5, 0, 0], (8, 1))  # twice the same joint
    joints[:, 1] = joints[:, 0]
    primitive["attributes"] |= {
        "JOINTS_0": maker.add(joints, "u1", "VEC4"),
        "WEIGHTS_0": maker.add(weights, "<f4", "VEC4"),
    }
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 3, 0] = -5.0  # by columns
    maker.data["skins"] = [{"joints": [1, 2], "inverseBindMatrices": maker.add(bind.reshape(2, 16), "<f4", "MAT4")}]
    nodes = [{"mesh": 0, "skin": 0, "translation": [50, 0, 0]}, {"children": [2]}, {"translation": [5, 3, 0]}]
    maker.data |= {"nodes": nodes, "scenes": [{"nodes": [0, 1]}]}
    vertices, faces = maker.read(tmp_path)
    moved = TRIANGLES[0] + np.repeat([[0, 0, 0], [0, 3, 0]], 4, axis=0)
    assert_same((vertices, faces), (moved, TRIANGLES[1]))


def test_nodes_that_are_hidden_or_of_other_scenes(tmp_path: Path):
    maker = Maker()
    maker.primitive(indices=maker.faces())
    hidden = {"children": [1], "extensions": {"KHR_node_visibility": {"visible": False}}}
    maker.data["nodes"] = [hidden, {"mesh": 0}, {"mesh": 0}, {"mesh": 0, "translation": [0, 9, 0]}]
    maker.data |= {"scenes": [{"nodes": [3]}, {"nodes": [0, 2]}], "scene": 1}
    with pytest.warns(UserWarning, match=r"left out: 1 invisible nodes"):
        assert_same(maker.read(tmp_path), TRIANGLES)


def test_what_is_used_but_not_read_is_told(tmp_path: Path):
    maker = Maker()
    maker.primitive(indices=maker.faces())
    maker.primitive(indices=maker.faces([0, 1, 2, 3]), mode=1)
    maker.data["extensionsUsed"] = ["VENDOR_physics", "KHR_materials_unlit", "KHR_mesh_quantization"]
    maker.data["animations"] = [{}]
    with pytest.warns(UserWarning) as told:
        assert_same(maker.read(tmp_path), TRIANGLES)
    words = " ".join(str(warning.message) for warning in told)
    assert "uses VENDOR_physics, which is not read" in words and "unlit" not in words
    assert "animations are not read" in words and "primitive 1 of mesh 0, which is made of points or lines" in words


BROKEN = {
    "a cycle": (
        lambda d: d["nodes"].append({"children": [0]}) or d["nodes"][0].update(children=[1]),
        "child of several",
    ),
    "a node that is missing": (lambda d: d["nodes"][0].update(children=[7]), "uses number 7 of its nodes"),
    "a matrix of nine": (lambda d: d["nodes"][0].update(matrix=[1.0] * 9), "the matrix of node 0 must be 16 numbers"),
    "an infinite scale": (lambda d: d["nodes"][0].update(scale=[1, 1e999, 1]), "the scale of node 0 is not finite"),
    "no rotation": (lambda d: d["nodes"][0].update(rotation=[0, 0, 0, 0]), "the rotation of node 0 is no quaternion"),
    "a mode": (lambda d: d["meshes"][0]["primitives"][0].update(mode=9), "unknown mode 9"),
    "a short buffer": (lambda d: d["buffers"][0].update(byteLength=999), "has 120 bytes, not the 999"),
    "a view too long": (lambda d: d["bufferViews"][0].update(byteLength=999), "bufferView 0 reaches beyond the 120"),
    "a count too great": (lambda d: d["accessors"][1].update(count=9), "accessor 1 reaches beyond"),
    "a huge count": (
        lambda d: (
            d["accessors"].append({"count": 10**12, "type": "VEC3", "componentType": 5126})
            or d["meshes"][0]["primitives"][0]["attributes"].update(POSITION=2)
        ),
        "without any data",
    ),
    "a type": (lambda d: d["accessors"][0].update(type="VEC9"), "unknown type"),
    "a negative index": (lambda d: d["nodes"][0].update(mesh=-1), "uses number -1 of its meshes"),
    "a word for a list": (lambda d: d.update(nodes="all"), "its nodes must be a list"),
    "weights": (
        lambda d: d["meshes"][0].update(weights=[1]) or d["meshes"][0]["primitives"][0].update(targets=[{}, {}]),
        "2 morph targets, but 1 weights",
    ),
    "meshopt": (
        lambda d: d["bufferViews"][0].update(extensions={"EXT_meshopt_compression": {"buffer": 0}}),
        "compressed",
    ),
    "another version": (lambda d: d["asset"].update(version="1.0"), "glTF of version 1.0"),
    "a buffer elsewhere": (lambda d: d["buffers"][0].update(uri="https://a.b/c.bin"), "only files relative"),
    "a buffer that is missing": (
        lambda d: d["buffers"][0].update(uri="no%20file.bin"),
        "its buffer 'no file.bin' is missing",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_with_a_gltf_is_named(tmp_path: Path, case: str):
    maker = Maker()
    maker.primitive(indices=maker.faces())
    data = with_buffer(maker.data, maker.payload)
    change, message = BROKEN[case]
    change(data)
    with pytest.raises(InputError, match=rf"a\.gltf'.*{message}"):
        read(written(tmp_path, "a.gltf", json.dumps(data)))


@pytest.mark.parametrize("length", [0, 4, 11, 19, 40, 400, 1100])
def test_a_glb_that_is_cut_is_refused(tmp_path: Path, length: int):
    data = (GLTF / "two_prims.glb").read_bytes()[:length]
    with pytest.raises(InputError, match=r"a\.glb'"):
        read(written(tmp_path, "a.glb", data))


def test_a_mirrored_solid_keeps_its_outside(tmp_path: Path):
    graph = trimesh.Scene()
    graph.add_geometry(trimesh.creation.box(), transform=np.diag([-1.0, 2.0, 1.0, 1.0]))
    graph.export(tmp_path / "box.glb")
    assert solid(read(tmp_path / "box.glb")).volume == pytest.approx(2.0)

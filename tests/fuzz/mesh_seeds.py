"""Healthy mesh files of every format, as bytes: the cases of tests/scenes, those of ``seeds``, and some made here."""

from __future__ import annotations

import base64
import importlib.util
import json
import os
import struct
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from experiments.scenes import primitives

SCENES = Path(__file__).parents[1] / "scenes"
CASES, SEEDS = SCENES / "cases", Path(__file__).parent / "seeds"
LARGEST = 40_000
"""Bytes of a seed; larger ones only make inputs slower."""

BESIDE = {"sheet.ply": SEEDS / "sheet.ply", "my bin ü.bin": CASES / "gltf" / "my bin ü.bin"}
"""Files that seeds refer to."""


@cache
def seeds() -> dict[str, tuple[bytes, ...]]:
    """Contents by suffix."""
    found: dict[str, list[bytes]] = {}
    for path in sorted([*CASES.rglob("*"), *SEEDS.iterdir()]):
        if path.is_file() and path.suffix not in (".yaml", ".bin", ".md") and path.stat().st_size <= LARGEST:
            found.setdefault(path.suffix.lower(), []).append(path.read_bytes())
    found[".off"] = [OFF, COFF, b"4OFF\n3 1 0\n0 0 0 1\n2 0 0 2\n0 1 0 1\n3 0 1 2\n"]
    found[".stl"] = [TEXT_STL, binary_stl()]
    found[".ply"] += [binary_ply("<"), binary_ply(">"), STRIPS_PLY]
    found[".gltf"] += gltf_files()
    found[".glb"].append(glb_of(found[".gltf"][-1]))
    if importlib.util.find_spec("pxr") is not None:
        found[".usdc"], found[".usdz"] = crates(found[".usda"])
    return {suffix: tuple(data) for suffix, data in found.items()}


OFF = b"OFF\n# a square and a triangle\n5 2 6\n0 0 0\n1 0 0\n1 0 1\n0 0 1\n0.5 1 0.5\n4 0 1 2 3 255 0 0\n3 0 1 4\n"
COFF = b"COFF 4 1 0\n0 0 0 1 0 0 1\n1 0 0 0 1 0 1\n1 1 0 0 0 1 1\n0 1 0 1 1 1 1\n4 0 1 2 3\n"
TEXT_STL = b"""solid two plates
facet normal 0 1 0
 outer loop
  vertex -1 0 0
  vertex 0 0 1.5e0
  vertex 1 0 0
 endloop
endfacet
facet normal 0 0 0
 outer loop
  vertex 0 1 0
  vertex 0 1 1
  vertex 1 1 1
  vertex 1 1 0
 endloop
endfacet
endsolid two plates
"""
STRIPS_PLY = b"""ply
format ascii 1.0
comment two strips
element vertex 6
property float x
property float y
property float z
property uchar red
element tristrips 1
property list int int vertex_indices
end_header
0 0 0 1
1 0 0 2
0 1 0 3
1 1 0 4
0 2 0 5
1 2 0 6
8 0 1 2 3 -1 3 4 5
"""


def binary_stl() -> bytes:
    """Four facets."""
    corners = np.arange(36, dtype="<f4").reshape(4, 9) % 7
    facets = b"".join(struct.pack("<3f", 0, 0, 1) + row.tobytes() + b"\0\0" for row in corners)
    return b"solid but binary".ljust(80) + struct.pack("<I", 4) + facets


def binary_ply(order: str) -> bytes:
    """A square and a triangle, in one byte order."""
    name = {"<": "little", ">": "big"}[order]
    head = (
        f"ply\nformat binary_{name}_endian 1.0\nelement vertex 5\nproperty double x\nproperty double y\nproperty double z\n"
        "property uchar quality\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    )
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 2, 0)]
    body = b"".join(struct.pack(order + "3dB", *point, 9) for point in points)
    return head.encode() + body + struct.pack(order + "B4iB3i", 4, 0, 1, 2, 3, 3, 3, 2, 4)


def gltf_files() -> list[bytes]:
    """A scene with cameras, lights and an animation; a skin; morph targets; meshopt where it is installed."""
    from tests.scenes.gltf_files import GltfFile

    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 2, 0.5]]
    faces = [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
    out = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("scene", "skin", "morph", "meshopt"):
            file = GltfFile()
            if name == "scene":
                camera = {"type": "perspective", "perspective": {"yfov": 0.9, "znear": 0.1, "zfar": 100}}
                file.json["cameras"] = [
                    camera,
                    {"type": "orthographic", "orthographic": {"xmag": 3, "ymag": 3, "znear": 0, "zfar": 9}},
                ]
                file.node(camera=0, translation=[0, 1, 6])
                file.node(camera=1, translation=[0, 1, 6], rotation=[0, 0, 0, 1])
                file.json["materials"] = [
                    {"pbrMetallicRoughness": {"baseColorFactor": [1, 0.5, 0.2, 1]}, "alphaMode": "MASK"}
                ]
                child = file.node(root=False, mesh=file.mesh(vertices, faces, material=0), scale=[1, 2, 1])
                parent = file.node(children=[child], translation=[0, 0, -1])
                file.node(translation=[0, 5, 0], extensions=file.light(type="point", intensity=3.0, color=[1, 1, 0.5]))
                file.node(rotation=[-0.7071, 0, 0, 0.7071], extensions=file.light(type="directional"))
                file.animate(
                    (parent, "translation", [0, 0.1], [[0, 0, -1], [2, 0, -1]]),
                    (child, "rotation", [0, 0.05, 0.1], [[0, 0, 0, 1], [0, 0.7071, 0, 0.7071], [0, 1, 0, 0]]),
                )
            elif name == "skin":
                more = {
                    "JOINTS_0": file.accessor(np.array([[0, 1, 0, 0]] * 5)),
                    "WEIGHTS_0": file.accessor([[0.5, 0.5, 0.0, 0.0]] * 5),
                }
                mesh = file.mesh(vertices, faces, attributes=more)
                joints = [file.node(translation=[0, 0, 0]), file.node(translation=[0, 1, 0])]
                file.json["skins"] = [{"joints": joints, "inverseBindMatrices": file.accessor([np.eye(4).ravel()] * 2)}]
                file.node(mesh=mesh, skin=0)
                file.animate((joints[1], "scale", [0, 0.1], [[1, 1, 1], [2, 2, 2]]), kind="STEP")
            elif name == "morph":
                target = {"POSITION": file.accessor([[0.0, 0.0, 1.0]] * 5)}
                mesh = file.mesh(vertices, faces, targets=[target])
                file.json["meshes"][mesh]["weights"] = [0.25]
                node = file.node(mesh=mesh)
                file.animate((node, "weights", [0, 0.1], [[0.0], [1.0]]))
            elif importlib.util.find_spec("meshoptimizer") is None:
                continue
            else:
                _compress(file)
            out.append(file.write(Path(folder) / "a.gltf").read_bytes())
    return out


def _compress(file: Any) -> None:
    import meshoptimizer

    # its buffers are too small for a handful of triangles, and are written beyond their end
    sphere = primitives.sphere(1.5, 2)
    vertices, faces = sphere[0].astype(np.float32), sphere[1].astype(np.uint32)
    file.node(mesh=file.mesh(vertices, faces))
    parts = {
        "ATTRIBUTES": (meshoptimizer.encode_vertex_buffer(vertices, len(vertices), 12), len(vertices), 12),
        "TRIANGLES": (meshoptimizer.encode_index_buffer(faces.ravel(), faces.size), faces.size, 4),
    }
    for view, (mode, (data, count, stride)) in zip(file.json["bufferViews"], parts.items(), strict=True):
        packed = file.bytes_of(bytes(data))
        extension = {"buffer": 0, **packed, "byteStride": stride, "count": count, "mode": mode}
        view["extensions"] = {"EXT_meshopt_compression": extension}
    file.json |= {"extensionsUsed": ["EXT_meshopt_compression"], "extensionsRequired": ["EXT_meshopt_compression"]}


def glb_of(gltf: bytes) -> bytes:
    """The same file as a GLB, its buffer a chunk."""
    data = json.loads(gltf)
    body = base64.b64decode(data["buffers"][0].pop("uri").partition(",")[2])
    text = json.dumps(data).encode()
    text += b" " * (-len(text) % 4)
    body += b"\0" * (-len(body) % 4)
    size = 12 + 8 + len(text) + 8 + len(body)
    head = struct.pack("<4sII", b"glTF", 2, size)
    return head + struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body


def crates(texts: list[bytes]) -> tuple[list[bytes], list[bytes]]:
    """Stages in their binary form, and one in a package; the same bytes in every process."""
    from pxr import Sdf, UsdUtils

    binary, packages = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for index, text in enumerate(texts):
            (folder / f"{index}.usda").write_bytes(text)
            Sdf.Layer.FindOrOpen(str(folder / f"{index}.usda")).Export(str(folder / f"{index}.usdc"))
            os.utime(folder / f"{index}.usdc", (1e9, 1e9))
            binary.append((folder / f"{index}.usdc").read_bytes())
        UsdUtils.CreateNewUsdzPackage(str(folder / "0.usdc"), str(folder / "a.usdz"))
        packages.append((folder / "a.usdz").read_bytes())
    return binary, packages

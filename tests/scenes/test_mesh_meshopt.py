"""glTF buffers that meshoptimizer compressed give the triangles that went in."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import GltfFile

from experiments.config.source import from_dict
from experiments.scenes import primitives
from experiments.scenes.files import read_triangles
from experiments.scenes.place import Place
from wkernels.errors import InputError

meshoptimizer = pytest.importorskip("meshoptimizer")


def compressed(path: Path, **changes: Any) -> tuple[np.ndarray, np.ndarray]:
    """Writes a sphere whose two buffer views are compressed; returns what went in."""
    vertices, faces = primitives.sphere(1.5, 2)
    vertices = vertices.astype(np.float32)
    file = GltfFile()
    parts = {
        "ATTRIBUTES": (meshoptimizer.encode_vertex_buffer(vertices, len(vertices), 12), len(vertices), 12),
        "TRIANGLES": (meshoptimizer.encode_index_buffer(faces.ravel().astype(np.uint32), faces.size), faces.size, 4),
    }
    file.node(mesh=file.mesh(vertices, faces))
    for view, (mode, (data, count, stride)) in zip(file.json["bufferViews"], parts.items(), strict=True):
        packed = file.bytes_of(bytes(data))
        extension = {"buffer": 0, **packed, "byteStride": stride, "count": count, "mode": mode, **changes}
        view["extensions"] = {"EXT_meshopt_compression": extension}
    file.blank(sum(view["byteLength"] for view in file.json["bufferViews"]))  # nothing there but the compressed bytes
    file.json |= {"extensionsUsed": ["EXT_meshopt_compression"], "extensionsRequired": ["EXT_meshopt_compression"]}
    file.write(path)
    return vertices, faces


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    return read_triangles(path.name, Place(from_dict({}), path.parent))


def volume(corners: np.ndarray) -> float:
    """Of the closed body of triangles (F, 3, 3), counter-clockwise seen from outside."""
    return float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0)


def test_what_went_in_comes_out(tmp_path: Path) -> None:
    vertices, faces = compressed(tmp_path / "a.gltf")
    found, found_faces = read(tmp_path / "a.gltf")
    ours, theirs = found[found_faces], vertices[faces].astype(np.float64)
    # the index codec keeps triangles and their sense, but neither their order nor which corner comes first
    np.testing.assert_allclose(np.sort(ours.sum(axis=1), axis=0), np.sort(theirs.sum(axis=1), axis=0), atol=1e-6)
    assert volume(ours) == pytest.approx(volume(theirs), rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 10**9}, "bufferView 0 cannot be decompressed"),
        ({"byteLength": 20}, "bufferView 0 cannot be decompressed"),
        ({"mode": "POINTS"}, "an unknown way: POINTS"),
        ({"filter": "QUATERNION"}, "the filter QUATERNION on elements of 12 bytes"),
        ({"byteStride": 0}, "a count or stride"),
    ],
)
def test_what_cannot_be_decoded_is_refused(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    compressed(tmp_path / "a.gltf", **changes)
    with pytest.raises(InputError, match=message):
        read(tmp_path / "a.gltf")


def test_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compressed(tmp_path / "a.gltf")
    monkeypatch.setitem(sys.modules, "meshoptimizer", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"wkernels\[meshopt\]"):
        read(tmp_path / "a.gltf")

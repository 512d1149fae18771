"""Small glTF files written by hand, for tests of their import."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np

_KINDS = {"f": 5126, "u": 5125}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class GltfFile:
    """A document that grows; ``json`` may be changed before it is written."""

    def __init__(self) -> None:
        self._bytes = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
            "meshes": [],
            "cameras": [],
            "accessors": [],
            "bufferViews": [],
        }

    def accessor(self, values: Any) -> int:
        """Index of an accessor with float32 or uint32 values."""
        array = np.asarray(values)
        array = array.astype("<u4" if array.dtype.kind in "iu" else "<f4")
        array = array.reshape(len(array), -1)
        self.json["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": array.nbytes},
        )
        self._bytes += array.tobytes()
        return self._add(
            "accessors",
            {
                "bufferView": len(self.json["bufferViews"]) - 1,
                "componentType": _KINDS[array.dtype.kind],
                "count": len(array),
                "type": _SHAPES[array.shape[1]],
            },
        )

    def bytes_of(self, data: bytes) -> dict[str, int]:
        """Place of further bytes in the buffer, as a buffer view has it."""
        place = {"byteOffset": len(self._bytes), "byteLength": len(data)}
        self._bytes += data
        return place

    def blank(self, count: int) -> None:
        """Overwrites the first bytes of the buffer."""
        self._bytes = b"\xee" * count + self._bytes[count:]

    def mesh(self, vertices: Any, faces: Any, **more: Any) -> int:
        """Index of a mesh of one primitive."""
        attributes = {"POSITION": self.accessor(vertices), **more.pop("attributes", {})}
        primitive = {"attributes": attributes, "indices": self.accessor(np.ravel(faces)), **more}
        return self._add("meshes", {"primitives": [primitive]})

    def node(self, *, root: bool = True, **keys: Any) -> int:
        """Index of a node."""
        index = self._add("nodes", keys)
        if root:
            self.json["scenes"][0]["nodes"].append(index)
        return index

    def light(self, **keys: Any) -> dict[str, Any]:
        """The ``extensions`` of a node with a punctual light."""
        lights = self.json.setdefault("extensions", {}).setdefault("KHR_lights_punctual", {}).setdefault("lights", [])
        self.json["extensionsUsed"] = ["KHR_lights_punctual"]
        lights.append(keys)
        return {"KHR_lights_punctual": {"light": len(lights) - 1}}

    def masked(self, image: bytes, **material: Any) -> int:
        """Index of a material of alphaMode MASK whose texture, taken without interpolation, is a PNG in the buffer."""
        self.json["bufferViews"].append({"buffer": 0, **self.bytes_of(image)})
        image_index = self._add("images", {"bufferView": len(self.json["bufferViews"]) - 1, "mimeType": "image/png"})
        sampler = self._add("samplers", {"magFilter": 9728, "wrapS": 33071, "wrapT": 33071})
        texture = self._add("textures", {"source": image_index, "sampler": sampler})
        surface = {"baseColorTexture": {"index": texture}}
        return self._add("materials", {"alphaMode": "MASK", "pbrMetallicRoughness": surface, **material})

    def animate(self, *tracks: tuple[int, str, Any, Any], kind: str = "LINEAR", name: str = "go") -> None:
        """An animation of tracks (node, path, times, values)."""
        samplers, channels = [], []
        for node, path, times, values in tracks:
            keys = {
                "input": self.accessor(np.asarray(times, float)),
                "output": self.accessor(np.asarray(values, float)),
            }
            samplers.append({**keys, "interpolation": kind})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        self._add("animations", {"name": name, "samplers": samplers, "channels": channels})

    def write(self, path: Path) -> Path:
        """Writes it with its buffer inside."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self._bytes).decode()
        path.write_text(json.dumps({**self.json, "buffers": [{"uri": uri, "byteLength": len(self._bytes)}]}))
        return path

    def _add(self, key: str, item: dict[str, Any]) -> int:
        self.json.setdefault(key, []).append(item)
        return len(self.json[key]) - 1

"""A glTF 2.0 file: its JSON, its buffers and what accessors read from them (Khronos, glTF 2.0 specification)."""

from __future__ import annotations

import base64
import binascii
import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

import numpy as np

from experiments.scenes.meshes import gltf_meshopt
from experiments.scenes.meshes.reading import MeshError
from wkernels.errors import one_line

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_GLB = b"glTF"
_GLB_JSON, _GLB_BIN = 0x4E4F534A, 0x004E4942
_MOST_DIGITS = 300  # of a whole number that float64 can hold
_MOST_WITHOUT_DATA = 1 << 24  # elements of an accessor that no bytes stand behind


class Document:
    """The parts of a glTF file by index. Every look-up that the file gets wrong raises MeshError.

    Attributes:
        path: The file.
        json: Its JSON, an object.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        data = path.read_bytes()
        self._chunk: bytes | None = None
        text = self._unpack(data) if data.startswith(_GLB) else data
        try:
            self.json: dict[str, Any] = json.loads(
                text.decode("utf-8-sig"), object_hook=_without_nulls, parse_int=_whole_number
            )
        except (ValueError, RecursionError) as error:
            raise MeshError(f"its JSON cannot be read: {one_line(error)}.") from None
        if not isinstance(self.json, dict):
            raise MeshError("its JSON is no object.")
        version = str(self.get(self.json, "asset", dict, {}).get("version", ""))
        if not version.startswith("2"):
            raise MeshError(f"is glTF of version {version or 'unknown'}; 2.0 is read.")
        self._buffers: dict[int, bytes] = {}

    def get(self, data: dict[str, Any], key: str, kind: type, default: Any = None) -> Any:
        """``data[key]`` of an object, which must be of a kind, or the default where it is missing."""
        if not isinstance(data, dict):
            raise MeshError(f"has {str(data)[:40]} where an object with the key {key} must be.")
        value = data.get(key, default)
        if value is not None and (not isinstance(value, kind) or (kind is int and isinstance(value, bool))):
            raise MeshError(f"its {key} must be {_KINDS.get(kind, kind.__name__)}, not {str(value)[:40]}.")
        return value

    def items(self, key: str) -> list[dict[str, Any]]:
        """All of the top level's ``nodes``, ``meshes``, ..."""
        return self.objects(self.json, key)

    def objects(self, data: dict[str, Any], key: str) -> list[dict[str, Any]]:
        """A list of objects, empty where it is missing."""
        items = self.get(data, key, list, [])
        if not all(isinstance(item, dict) for item in items):
            raise MeshError(f"its {key} must be objects.")
        return items

    def indices(self, data: dict[str, Any], key: str) -> list[int]:
        """A list of whole numbers, empty where it is missing."""
        items = self.get(data, key, list, [])
        if not all(isinstance(item, int) and not isinstance(item, bool) for item in items):
            raise MeshError(f"its {key} must be whole numbers.")
        return items

    def item(self, key: str, index: Any) -> dict[str, Any]:
        """One of the top level's ``nodes``, ``meshes``, ... by its index."""
        items = self.items(key)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(items):
            raise MeshError(f"uses number {index} of its {key}, of which there are {len(items)}.")
        return items[index]

    def numbers(self, data: dict[str, Any], key: str, length: int, default: list[float], what: str) -> np.ndarray:
        """A list of finite numbers, float64; ``what`` it belongs to is named in the message."""
        value = data.get(key, default)
        good = isinstance(value, list) and all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in value)
        if not good or len(value) != length:
            raise MeshError(f"the {key} of {what} must be {length} numbers.")
        out = np.array([float(x) for x in value])
        if not np.isfinite(out).all():
            raise MeshError(f"the {key} of {what} is not finite: {value}.")
        return out

    def extensions_used(self) -> tuple[list[str], list[str]]:
        """Names of the extensions that are required, and of those that are merely used."""
        required = [str(name) for name in self.get(self.json, "extensionsRequired", list, [])]
        used = [str(name) for name in self.get(self.json, "extensionsUsed", list, [])]
        return required, [name for name in used if name not in required]

    def accessor(self, index: Any) -> np.ndarray:
        """What an accessor reads, (count, width): float64 of normalised integers and floats, else int64."""
        data = self.item("accessors", index)
        what = f"accessor {index}"
        kind, width = self._kind(data, what)
        count = self.get(data, "count", int, 0)
        if count < 0:
            raise MeshError(f"{what} has the count {count}.")
        if data.get("bufferView") is None:
            if count > _MOST_WITHOUT_DATA:
                raise MeshError(f"{what} has {count} elements without any data.")
            raw = np.zeros((count, width), kind)
        else:
            raw = self._elements(data, kind, width, count, what)
        sparse = self.get(data, "sparse", dict)
        if sparse is not None:
            raw = self._with_sparse(raw, sparse, what)
        if kind.kind == "f":
            return raw.astype(np.float64)
        if not data.get("normalized"):
            return raw.astype(np.int64)
        out: np.ndarray = raw / float(np.iinfo(kind).max)  # section 3.11, "Accessors": f = max(c / max, -1)
        return np.maximum(out, -1.0)

    def view_bytes(self, index: Any) -> tuple[bytes, int | None]:
        """The bytes of a buffer view and its stride, None where elements follow one another."""
        view = self.item("bufferViews", index)
        extensions = self.get(view, "extensions", dict, {})
        for name in gltf_meshopt.NAMES:
            if name in extensions:
                packed = self.get(extensions, name, dict, {})
                return gltf_meshopt.decoded(self._part(packed, f"bufferView {index}"), packed, f"bufferView {index}"), (
                    self.get(packed, "byteStride", int) if packed.get("mode") == "ATTRIBUTES" else None
                )
        held = self._part(view, f"bufferView {index}")
        stride = self.get(view, "byteStride", int)
        if stride is not None and not 4 <= stride <= 252:
            raise MeshError(f"bufferView {index} has the stride {stride}, which must be 4 to 252.")
        return held, stride

    def _part(self, view: dict[str, Any], what: str) -> bytes:
        data = self._buffer(view.get("buffer"))
        offset, length = self.get(view, "byteOffset", int, 0), self.get(view, "byteLength", int, 0)
        if offset < 0 or length < 0 or offset + length > len(data):
            raise MeshError(f"{what} reaches beyond the {len(data)} bytes of its buffer.")
        return data[offset : offset + length]

    def _kind(self, data: dict[str, Any], what: str) -> tuple[np.dtype, int]:
        component, shape = self.get(data, "componentType", int), self.get(data, "type", str)
        if component not in _COMPONENTS or shape not in _WIDTHS:
            raise MeshError(f"{what} is of an unknown type ({component}, {shape}).")
        return np.dtype(_COMPONENTS[component]), _WIDTHS[shape]

    def _elements(self, data: dict[str, Any], kind: np.dtype, width: int, count: int, what: str) -> np.ndarray:
        held, stride = self.view_bytes(data.get("bufferView"))
        offset = self.get(data, "byteOffset", int, 0)
        size = kind.itemsize * width
        stride = size if stride is None else stride
        if not count:
            return np.zeros((0, width), kind)
        if stride < size or offset < 0 or offset + stride * (count - 1) + size > len(held):
            raise MeshError(f"{what} reaches beyond the {len(held)} bytes of its bufferView.")
        return np.ndarray((count, width), kind, held, offset, (stride, kind.itemsize))

    def _with_sparse(self, raw: np.ndarray, sparse: dict[str, Any], what: str) -> np.ndarray:
        count = self.get(sparse, "count", int, 0)
        indices, values = self.get(sparse, "indices", dict, {}), self.get(sparse, "values", dict, {})
        kind, _ = self._kind({**indices, "type": "SCALAR"}, f"the sparse part of {what}")
        at = self._elements(indices, kind, 1, count, f"the sparse part of {what}").ravel().astype(np.int64)
        if len(at) and at.max() >= len(raw):
            raise MeshError(f"the sparse part of {what} changes element {at.max()} of {len(raw)}.")
        out = raw.copy()
        out[at] = self._elements(values, raw.dtype, raw.shape[1], count, f"the sparse part of {what}")
        return out

    def _buffer(self, index: Any) -> bytes:
        data = self.item("buffers", index)
        if index not in self._buffers:
            self._buffers[index] = self._load(index, self.get(data, "uri", str))
        length = self.get(data, "byteLength", int, 0)
        if len(self._buffers[index]) < length:
            raise MeshError(f"buffer {index} has {len(self._buffers[index])} bytes, not the {length} that it says.")
        return self._buffers[index]

    def _load(self, index: int, uri: str | None) -> bytes:
        if uri is None:
            if index == 0 and self._chunk is not None:
                return self._chunk
            raise MeshError(f"buffer {index} has neither a uri nor a binary chunk.")
        return self.external(uri, f"buffer {index}")

    def external(self, uri: str, what: str) -> bytes:
        """The bytes that a uri stands for, of a file beside this one or in itself; ``what`` is named in messages."""
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            try:
                if not comma or not head.endswith(";base64"):
                    raise ValueError
                return base64.b64decode(unquote(body), validate=True)
            except (ValueError, binascii.Error):
                raise MeshError(f"{what} is no base64 data.") from None
        if urlparse(uri).netloc or Path(unquote(uri)).is_absolute():
            raise MeshError(f"{what} is '{uri}'; only files relative to the glTF file are read.")
        for name in (unquote(uri), uri):  # the specification escapes names, not every writer does
            file = self.path.parent / name
            try:
                if file.is_file():
                    return file.read_bytes()
            except (OSError, ValueError) as error:
                raise MeshError(f"its {what.split()[0]} '{name}' cannot be read: {one_line(error)}.") from None
        raise MeshError(f"its {what.split()[0]} '{unquote(uri)}' is missing.")

    def _unpack(self, data: bytes) -> bytes:
        """The JSON of a GLB container; keeps its binary chunk."""
        if len(data) < 20:
            raise MeshError("cannot be read: a GLB has 20 bytes at least.")
        version, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
        if version != 2:
            raise MeshError(f"is a GLB of version {version}; 2 is read.")
        if length > len(data):
            raise MeshError(f"has {len(data)} bytes, not the {length} that it says.")
        text, at = None, 12
        while at + 8 <= length:
            size, kind = (int.from_bytes(data[i : i + 4], "little") for i in (at, at + 4))
            if at + 8 + size > length:
                raise MeshError("has a chunk that reaches beyond its end.")
            chunk = data[at + 8 : at + 8 + size]
            if text is None and kind == _GLB_JSON:
                text = chunk
            elif self._chunk is None and kind == _GLB_BIN:
                self._chunk = chunk
            at += 8 + size
        if text is None:
            raise MeshError("has no JSON chunk.")
        return text


def _without_nulls(data: dict[str, Any]) -> dict[str, Any]:
    """An object of JSON; a key that is null is one that is missing."""
    return {key: value for key, value in data.items() if value is not None}


def _whole_number(text: str) -> int | float:
    return int(text) if len(text) < _MOST_DIGITS else float(text)


_KINDS: dict[type, str] = {dict: "an object", list: "a list", int: "a whole number", str: "a text"}

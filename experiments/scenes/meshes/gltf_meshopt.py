"""Buffers of glTF files that meshoptimizer has compressed (EXT_meshopt_compression), decoded by its own library."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np

from experiments.scenes.meshes.reading import MeshError
from wkernels.errors import one_line

NAMES = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL")


def decoded(encoded: bytes, data: dict[str, Any], what: str) -> bytes:
    """The ``count`` times ``byteStride`` bytes that a compressed buffer view stands for.

    Args:
        encoded: Its bytes.
        data: The extension's JSON.
        what: The view, for messages.

    Raises:
        MeshError: The library is not installed, the extension says nothing that it can decode, or the bytes are wrong.
    """
    if importlib.util.find_spec("meshoptimizer") is None:
        raise MeshError(f"{what} is compressed by {NAMES[0]}, which needs an extra: pip install 'wkernels[meshopt]'.")
    import meshoptimizer

    mode, kind = data.get("mode"), data.get("filter", "NONE")
    count, stride = data.get("count"), data.get("byteStride")
    if mode not in _MODES or kind not in _FILTERS:
        raise MeshError(f"{what} is compressed in an unknown way: {str(mode)[:20]}, {str(kind)[:20]}.")
    largest = 256 if mode == "ATTRIBUTES" else 4
    if not (isinstance(count, int) and isinstance(stride, int) and count >= 0 and 0 < stride <= largest):
        raise MeshError(f"{what} is compressed with a count or stride that cannot be: {count}, {stride}.")
    decode = {
        "ATTRIBUTES": meshoptimizer.decode_vertex_buffer,
        "TRIANGLES": meshoptimizer.decode_index_buffer,
        "INDICES": meshoptimizer.decode_index_sequence,
    }[mode]
    try:
        found = decode(count, stride, encoded)
    except Exception as error:  # wrong bytes, or more of them than the library allows
        raise MeshError(f"{what} cannot be decompressed: {one_line(error)}.") from None
    filters = {
        "OCTAHEDRAL": meshoptimizer.decode_filter_oct,
        "QUATERNION": meshoptimizer.decode_filter_quat,
        "EXPONENTIAL": meshoptimizer.decode_filter_exp,
    }
    if kind in filters:
        _check_filter(kind, mode, stride, what)
        found = filters[kind](found, count, stride)
    return np.ascontiguousarray(found).tobytes()[: count * stride]


def _check_filter(kind: str, mode: str, stride: int, what: str) -> None:
    """Raises MeshError where a filter would write beyond its elements (the library asserts, or does not look)."""
    fits = {"OCTAHEDRAL": stride in (4, 8), "QUATERNION": stride == 8, "EXPONENTIAL": stride % 4 == 0}[kind]
    if mode != "ATTRIBUTES" or not fits:
        raise MeshError(f"{what} has the filter {kind} on elements of {stride} bytes, which it cannot have.")

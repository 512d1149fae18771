"""glTF animations, sampled once per frame (glTF 2.0, sections 3.11 and appendix C)."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from experiments.scenes.importing.description import Asked, frame_count
from experiments.scenes.meshes.gltf_document import Document
from experiments.scenes.meshes.gltf_nodes import local_matrix
from experiments.scenes.meshes.reading import MeshError
from wkernels.errors import nearest

DEFAULT_FPS = 24.0
_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
_REST: dict[str, list[float]] = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}


class Animation:
    """One animation of a file at every frame.

    Args:
        document: The file.
        asked: Frames per second, and which animation.

    Attributes:
        name: Its name; empty where the file has none, or none is wanted.
        frames: How many, from time 0 to its last keyframe.
        fps: Of these.
    """

    def __init__(self, document: Document, asked: Asked) -> None:
        self._document = document
        self._values: dict[tuple[int, str], np.ndarray] = {}
        self.fps = asked.fps or DEFAULT_FPS
        self.frames = 1
        self.name = ""
        data = self._chosen(asked)
        if data is None:
            return
        samplers = document.objects(data, "samplers")
        channels = []
        for channel in document.objects(data, "channels"):
            target = document.get(channel, "target", dict, {})
            at, path = document.get(channel, "sampler", int), document.get(target, "path", str)
            if at is None or not 0 <= at < len(samplers):
                raise MeshError(f"animation {self.name!r} uses sampler {at}, of which there are {len(samplers)}.")
            if path not in (*_WIDTHS, "weights"):
                asked.tell(f"left out: the animation of {str(path)[:40]!r}.")
            elif target.get("node") is not None:
                document.item("nodes", target["node"])
                channels.append(((target["node"], path), self._keys(samplers[at])))
        last = max((times[-1] for _, (times, _, _) in channels), default=0.0)
        self.frames = frame_count(last, self.fps)
        seconds = np.arange(self.frames) / self.fps
        for (node, path), keys in channels:
            if (node, path) in self._values:
                raise MeshError(f"animation {self.name!r} moves the {path} of node {node} twice.")
            self._values[node, path] = sampled(*keys, path, seconds)

    def local(self, index: int) -> np.ndarray:
        """Node to parent space: float64 (frames, 4, 4) of a node that is animated, else (4, 4)."""
        document = self._document
        if not any((index, path) in self._values for path in _WIDTHS):
            return local_matrix(document, index)
        node, what = document.item("nodes", index), f"node {index}"
        if "matrix" in node:
            raise MeshError(f"{what} is animated and has a matrix, which the format does not allow.")
        values = {
            path: self._values.get((index, path), document.numbers(node, path, width, _REST[path], what)[None])
            for path, width in _WIDTHS.items()
        }
        if not np.all(np.linalg.norm(values["rotation"], axis=1) > 0.0):
            raise MeshError(f"the rotation of {what} is no quaternion.")
        out = np.tile(np.eye(4), (self.frames, 1, 1))
        out[:, :3, :3] = Rotation.from_quat(values["rotation"]).as_matrix() * values["scale"][:, None, :]
        out[:, :3, 3] = values["translation"]
        return out

    def weights(self, node: int) -> np.ndarray | None:
        """Of the node's morph targets, (frames, T); None where they are not animated."""
        return self._values.get((node, "weights"))

    def _chosen(self, asked: Asked) -> dict[str, Any] | None:
        items = self._document.items("animations")
        names = [str(item.get("name", i)) for i, item in enumerate(items)]
        wanted = asked.animation
        if wanted == "none":
            return None
        if wanted is not None and wanted not in names:
            raise MeshError(f"has no animation {wanted!r}." + (nearest(wanted, names) if names else " It has none."))
        if not items:
            return None
        at = 0 if wanted is None else names.index(wanted)
        self.name = names[at]
        others = [repr(name) for i, name in enumerate(names) if i != at]
        if others and wanted is None:
            asked.tell(f"animation {self.name!r} is shown; left out: {', '.join(others)} (animation: NAME chooses).")
        return items[at]

    def _keys(self, sampler: Any) -> tuple[np.ndarray, np.ndarray, str]:
        document, what = self._document, f"a sampler of animation {self.name!r}"
        times = document.accessor(sampler.get("input"))[:, 0].astype(np.float64)
        values = document.accessor(sampler.get("output")).astype(np.float64)
        kind = sampler.get("interpolation", "LINEAR")
        if kind not in ("LINEAR", "STEP", "CUBICSPLINE"):
            raise MeshError(f"{what} has the unknown interpolation {str(kind)[:40]!r}.")
        if not len(times) or not np.all(np.isfinite(times)) or times[0] < 0.0 or np.any(np.diff(times) <= 0.0):
            raise MeshError(f"{what} has times that do not rise from 0.")
        if not np.isfinite(values).all():
            raise MeshError(f"{what} has values that are not finite.")
        return times, values, kind


def sampled(times: np.ndarray, values: np.ndarray, kind: str, path: str, at: np.ndarray) -> np.ndarray:
    """The values (n, width) of a sampler at times ``at`` (n,), seconds; its first and last key are held.

    Args:
        times: Of the keys, (k,), rising.
        values: (k, width), three for each key (in-tangent, value, out-tangent) of a cubic spline; those of morph
            weights have a width of 1 and follow one another.
        kind: ``LINEAR``, ``STEP`` or ``CUBICSPLINE``.
        path: What is animated; rotations are turned the shorter way round.

    Raises:
        MeshError: There are not as many values as keys need.
    """
    keys = len(times) * (3 if kind == "CUBICSPLINE" else 1)
    width = _WIDTHS.get(path, max(values.size // keys, 1))
    if values.size != keys * width or (path in _WIDTHS and values.shape[1] != width):
        raise MeshError(f"an animation of a {path} has {values.size} numbers for {len(times)} keys.")
    values = values.reshape(keys, width)
    at = np.clip(at, times[0], times[-1])
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, max(len(times) - 2, 0))
    if kind == "STEP":
        return values[np.searchsorted(times, at, side="right") - 1]
    if len(times) == 1:
        return np.tile(values[1 if kind == "CUBICSPLINE" else 0], (len(at), 1))
    if path == "rotation" and kind == "LINEAR":
        if not np.all(np.linalg.norm(values, axis=1) > 0.0):
            raise MeshError("an animation of a rotation has a key that is no quaternion.")
        return np.asarray(Slerp(times, Rotation.from_quat(values))(at).as_quat())
    after = before + 1
    span = (times[after] - times[before])[:, None]
    t = (at - times[before])[:, None] / span
    if kind == "LINEAR":
        return (1.0 - t) * values[before] + t * values[after]
    t2, t3 = t * t, t * t * t
    return (
        (2.0 * t3 - 3.0 * t2 + 1.0) * values[3 * before + 1]
        + span * (t3 - 2.0 * t2 + t) * values[3 * before + 2]
        + (3.0 * t2 - 2.0 * t3) * values[3 * after + 1]
        + span * (t3 - t2) * values[3 * after]
    )

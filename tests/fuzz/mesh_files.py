"""Mesh files made wrong, read alone and imported as scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

import mutations
import yaml
from mesh_seeds import BESIDE, seeds
from pictures import HEIGHT, WIDTH, check_empty, check_picture, check_scene, check_triangles

from experiments.api import reference_visibility, render_visibility
from experiments.config.source import from_dict
from experiments.scenes import load_scene
from experiments.scenes.files import READERS, read_triangles
from experiments.scenes.importing.building import FORMATS
from experiments.scenes.place import Place
from wkernels.errors import InputError

Mutate = Callable[[Random, bytes, Sequence[bytes]], bytes]
_BYTES, _TEXT = mutations.mutated_bytes, mutations.mutated_text
_XML, _GLTF = mutations.mutated_xml, mutations.mutated_gltf
WAYS: dict[str, tuple[Mutate, ...]] = {
    ".obj": (_TEXT, _TEXT, _BYTES),
    ".off": (_TEXT, _TEXT, _BYTES),
    ".stl": (_TEXT, _BYTES),
    ".ply": (_TEXT, _TEXT, _BYTES),
    ".dae": (_XML, _XML, _TEXT, _BYTES),
    ".xml": (_XML, _XML, _TEXT, _BYTES),
    ".gltf": (_GLTF, _GLTF, _GLTF, _TEXT, _BYTES),
    ".glb": (_GLTF, _GLTF, _BYTES),
    ".usda": (_TEXT, _TEXT, _BYTES),
    ".usdc": (_BYTES,),
    ".usdz": (_BYTES,),
}
PICTURED = 16
"""Of so many scenes that can be read one is rendered."""


SELDOM = {".usdc": 0.2, ".usdz": 0.2}
"""How often a format is chosen that costs half a second, beside the others."""


def chosen_suffix(rng: Random, suffixes: Sequence[str]) -> str:
    """One of those suffixes of which there are healthy files."""
    there = [suffix for suffix in suffixes if suffix in seeds()]
    return rng.choices(there, [SELDOM.get(suffix, 1.0) for suffix in there])[0]


def mutated(rng: Random, suffix: str) -> bytes:
    """A file of a format, with faults."""
    healthy = seeds()[suffix]
    return rng.choice(WAYS[suffix])(rng, rng.choice(healthy), healthy)


class MeshFiles:
    """A mesh file, as the key ``file`` of a mesh names it."""

    name = "mesh"
    _suffixes = tuple(suffix for suffix in WAYS if suffix in READERS)

    def write(self, seed: int, index: int, folder: Path) -> None:
        """A file called ``a``, of one format or of another than its name says."""
        rng = Random(f"mesh {seed} {index}")
        suffix = chosen_suffix(rng, self._suffixes)
        named = suffix if rng.random() < 0.98 else rng.choice(self._suffixes)
        (folder / f"a{named}").write_bytes(mutated(rng, suffix))
        _write_beside(folder)

    def check(self, folder: Path, out: Path) -> str:
        """Triangles, or a message."""
        (path,) = folder.glob("a.*")
        try:
            vertices, faces = read_triangles(path.name, Place(from_dict({}), folder))
        except InputError as error:
            check_message(error)
            return "refused"
        check_triangles(vertices, faces)
        return "read"


class ImportedFiles:
    """A file with lights and cameras, as the key ``import`` of a scene names it."""

    name = "import"

    def write(self, seed: int, index: int, folder: Path) -> None:
        """A file ``a``, and a scene file that imports it with or without a camera and a light of its own."""
        rng = Random(f"import {seed} {index}")
        suffix = chosen_suffix(rng, list(FORMATS))
        (folder / f"a{suffix}").write_bytes(mutated(rng, suffix))
        scene: dict = {"import": f"a{suffix}"}
        if rng.random() < 0.7:
            scene["camera"] = {"eye": [3, 5, 9], "target": [0, 0, 0]}
        if rng.random() < 0.7:
            light = {"kind": "rectangle", "center": [0, 9, 1], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}
            scene["lights"] = ["from_file", light]
        if rng.random() < 0.3:
            scene |= {"fps": rng.choice((1, 30, 1000)), "light_size": 0.5}
        (folder / "scene.yaml").write_text(yaml.safe_dump(scene))
        _write_beside(folder)

    def check(self, folder: Path, out: Path) -> str:
        """A scene, now and then a picture, or a message."""
        try:
            scene = load_scene(folder / "scene.yaml")
        except InputError as error:
            check_message(error)
            return "refused"
        check_scene(scene)
        chosen = sum(map(len, (path.read_bytes() for path in folder.glob("a.*")))) % PICTURED
        if chosen:
            return "read"
        frame = scene.frames - 1
        try:
            size = {"width": WIDTH, "height": HEIGHT, "threads": 1}
            result = render_visibility(scene, "pcss", frame=frame, **size)
            reference, _ = reference_visibility(scene, samples=4, frame=frame, cache=False, **size)
        except InputError as error:
            check_message(error)
            return "not rendered"
        receivers = _numbers(result.world_position)
        check_picture(result.visibility, receivers)
        check_picture(reference, receivers)
        check_empty(scene, frame, result.visibility)
        return "rendered"


def _numbers(positions):
    import numpy as np

    return np.isfinite(positions).all(axis=2)


def _write_beside(folder: Path) -> None:
    for name, path in BESIDE.items():
        (folder / name).write_bytes(path.read_bytes())


def check_message(error: InputError) -> None:
    """Raises Fault unless a message is one short line that can be printed."""
    from isolation import Fault

    text = str(error)
    if not error.message.strip() or "\n" in text or len(text) > 1000:
        raise Fault(f"the message is empty, long or of several lines: {text[:300]!r}")

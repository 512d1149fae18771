"""Experiment files: right ones are run, ones with a broken rule and ones made wrong anyhow are refused."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from random import Random
from typing import Any

import mutations
import numpy as np
from experiment_strategies import FILES, experiments, plugins
from hypothesis import strategies as st
from isolation import Fault
from mesh_files import check_message
from model_strategies import Breakage, breakages, broken, examples
from pictures import check_empty, check_scene
from pool import BATCH

from experiments.config.source import dump_yaml
from experiments.kinds.convergence.run import run_convergence
from experiments.kinds.kind import kind_of_file
from experiments.kinds.sweep.run import run_sweep
from experiments.kinds.walkthrough.run import run
from experiments.results.failures import TechniquesFailed
from experiments.results.images import read_exr
from experiments.scenes import load_scene, schema
from wkernels.errors import InputError

CONFIGS = Path(__file__).parents[2] / "configs"
REPORTED = 20
"""Of so many experiments that run one is run as the command does, report and all."""
FEW = ("pcss", "pcf", "shadow_map")
_LARGE = ("paris", "winter", "bunny", "rocks", "overlap", "elongated")


class RightExperiments:
    """An experiment that its models accept is run, or refused for a rule that spans several keys.

    Args:
        names: Techniques to choose from; all unless given.
    """

    name = "experiment"

    def __init__(self, names: tuple[str, ...] | None = None) -> None:
        self._names = names or tuple(plugins())

    def write(self, seed: int, index: int, folder: Path) -> None:
        """An experiment file ``a.yaml``."""
        (folder / "a.yaml").write_text(dump_yaml(_right(seed, self._names)[index]), encoding="utf-8")

    def check(self, folder: Path, out: Path) -> str:
        """Results, whose pictures are looked at, or a message."""
        path = folder / "a.yaml"
        try:
            kind = kind_of_file(path)
            loaded = kind.load(path, [], plugins())
            kind.explain(loaded, plugins())
            whole = path.stat().st_size % REPORTED == 0
            _run(kind, loaded, out / "a", whole)
        except InputError as error:
            check_message(error)
            return "refused"
        except TechniquesFailed as error:
            raise Fault(f"a technique failed: {_failures(out)}") from error
        for experiment, results in _experiments_in(kind.name, loaded, out / "a"):
            check_scene(experiment.load_scene())
            check_results(experiment, results)
        return f"{kind.name} run"


@lru_cache(maxsize=2)
def _right(seed: int, names: tuple[str, ...]) -> list[dict[str, Any]]:
    kinds = ["walkthrough"] * 5 + ["convergence", "sweep", "analysis", "stability"]
    return examples(st.one_of([experiments(kind, names) for kind in kinds]), seed, BATCH)


def _run(kind: Any, loaded: Any, out: Path, whole: bool) -> None:
    options: dict[str, Any] = {"device": "cpu", "threads": 1, "resume": False, "skips": True}
    if kind.name == "stability":
        return  # its scenes are its own; files have nothing to say about them
    if whole or kind.name == "analysis":
        kind.run(loaded, out, plugins(), lambda done, total, what: None, **options)
    elif kind.name == "sweep":
        run_sweep(loaded, out, plugins=plugins(), report=False, **options)
    elif kind.name == "convergence":
        run_convergence(loaded, out, plugins=plugins(), report=False, **options)
    else:
        run(loaded, out, plugins=plugins(), report=False, **options)


def _experiments_in(kind: str, loaded: Any, out: Path) -> list[tuple[Any, Path]]:
    if kind == "walkthrough":
        return [(loaded, out)]
    if kind == "sweep":
        return [(scene.experiment, out / scene.experiment.name) for scene in loaded.scenes]
    return []


def _failures(out: Path) -> str:
    return " | ".join(path.read_text(errors="replace").strip().splitlines()[-1] for path in out.rglob("failures/*.txt"))


def check_results(experiment: Any, out: Path) -> None:
    """Raises Fault where the pictures of one frame do not show the same receivers, or hold no visibility."""
    for frame in experiment.frames:
        shown = {path.parent.name: read_exr(path) for path in out.glob(f"images/*/visibility_{frame:04d}.exr")}
        masks = {label: np.isfinite(picture) for label, picture in shown.items()}
        first = next(iter(masks.values()), None)
        for label, picture in shown.items():
            seen = masks[label]
            if not np.array_equal(seen, first):
                raise Fault(f"'{label}' shows other receivers than '{next(iter(masks))}' on frame {frame}")
            if seen.any() and not (picture[seen].min() >= -1e-4 and picture[seen].max() <= 1.0 + 1e-4):
                raise Fault(f"visibility of '{label}' runs from {picture[seen].min()} to {picture[seen].max()}")
            check_empty(experiment.load_scene(), frame, picture)


class BrokenExperiments:
    """An experiment with one rule of its models broken is refused, with file, line and key."""

    name = "broken"

    def write(self, seed: int, index: int, folder: Path) -> None:
        """The file ``a.yaml``, and ``note.txt``, which says what is broken."""
        data = _right(seed, FEW)[index]
        rng = Random(f"broken {seed} {index}")
        breakage = rng.choice(_all_breakages(data))
        (folder / "a.yaml").write_text(dump_yaml(broken(data, breakage)), encoding="utf-8")
        (folder / "note.txt").write_text(f"{'.'.join(map(str, breakage.loc))}: {breakage.what}: {breakage.value!r}")

    def check(self, folder: Path, out: Path) -> str:
        """A message."""
        path = folder / "a.yaml"
        try:
            kind_of_file(path).load(path, [], plugins())
        except InputError as error:
            check_message(error)
            if error.file is None or error.line is None:
                raise Fault(f"the message names no file or no line: {error}") from None
            return "refused"
        what = (folder / "note.txt").read_text().split(": ", 1)
        raise Fault(f"accepted, though {what[-1]} at {_without_index(what[0])}")


def _without_index(loc: str) -> str:
    return ".".join(part for part in loc.split(".") if not part.isdigit())


def _all_breakages(data: dict[str, Any]) -> list[Breakage]:
    """Those of the file itself, of its scene's meshes and lights, and of its techniques' parameters."""
    out = list(breakages(FILES[data["kind"]], data))
    out = [one for one in out if one.loc != ("kind",) and one.loc[0] not in ("scene", "techniques")]
    for i, entry in enumerate(data.get("techniques") or ()):
        if isinstance(entry, dict):
            ((name, options),) = entry.items()
            out += breakages(plugins()[name].Params, options, ("techniques", i, name))
    scene = data.get("scene")
    if isinstance(scene, dict):
        out += [one for one in breakages(schema.SceneFile, scene, ("scene",)) if len(one.loc) > 1]
        for i, mesh in enumerate(scene["meshes"]):
            out += _but(breakages(schema.PRIMITIVES[mesh["primitive"]], mesh, ("scene", "meshes", i)), "primitive")
        for i, light in enumerate(scene["lights"]):
            out += _but(breakages(schema.LIGHTS[light["kind"]], light, ("scene", "lights", i)), "kind")
    return out


def _but(found: Any, key: str) -> list[Breakage]:
    return [one for one in found if one.loc[-1] != key]


class MadeWrong:
    """Scene and experiment files with words, lines, bytes or values changed: they are read, or refused."""

    name = "config"

    def write(self, seed: int, index: int, folder: Path) -> None:
        """A file ``a.yaml``, experiment or scene."""
        rng = Random(f"config {seed} {index}")
        if rng.random() < 0.5:
            healthy: Any = _right(seed, FEW)[index]
            healthy = healthy.get("scene", healthy) if rng.random() < 0.5 else healthy
            if rng.random() < 0.6:
                text = dump_yaml(mutations.mutated_tree(rng, healthy)).encode("utf-8", errors="surrogatepass")
                (folder / "a.yaml").write_bytes(text)
                return
            data = dump_yaml(healthy).encode()
        else:
            data = rng.choice(_written())
        way = rng.choice((mutations.mutated_text, mutations.mutated_bytes))
        (folder / "a.yaml").write_bytes(way(rng, data, _written()))

    def check(self, folder: Path, out: Path) -> str:
        """What the file will do, or a message."""
        path = folder / "a.yaml"
        try:
            if b"techniques" in path.read_bytes() or b"curves" in path.read_bytes():
                kind = kind_of_file(path)
                kind.explain(kind.load(path, [], plugins()), plugins())
                return f"{kind.name} read"
            check_scene(load_scene(path))
            return "scene read"
        except InputError as error:
            check_message(error)
            return "refused"


@lru_cache(maxsize=1)
def _written() -> list[bytes]:
    """The files of configs that are small and whose scenes are."""
    found = [path.read_bytes() for path in sorted(CONFIGS.rglob("*.yaml"))]
    return [data for data in found if len(data) < 4000 and not any(name.encode() in data for name in _LARGE)]


def as_json(data: Any) -> str:
    """Data as one line, for messages."""
    return json.dumps(data)[:200]

"""What environment.json records: where results come from, and what must not change between the parts of one run."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import inspect
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import algorithms
import wkernels
from algorithms.plugins import FAMILIES
from algorithms.projections.schema import PARTS
from algorithms.projections.table import outside_files
from experiments.metrics.registry import METRICS
from wkernels import __version__

if TYPE_CHECKING:
    from experiments.rendering.engine import Engine
    from experiments.schema.experiment import Experiment

_PACKAGES = ("warp-lang", "numpy", "scipy", "trimesh", "OpenImageIO", "pydantic", "matplotlib", "pandas")


def describe_run(experiment: Experiment, engine: Engine, *, skips: bool) -> dict[str, Any]:
    """environment.json of a run.

    Returns:
        ``identity``: what rows must share to be comparable (a resumed run checks it); ``run``: what was run, for
        reports; ``environment``: software and machine; ``metrics``: version of each metric's definition.
    """
    light = engine.scene.lights[experiment.light]
    parts = {str((run.projection or {}).get(key)) for run in experiment.runs for key in PARTS}
    outside = {f"plugin {what}": file_digest(path) for what, path in outside_files(parts).items()}
    return {
        "identity": describe_identity(
            experiment.to_yaml(),
            engine.scene.content_hash,
            {run.name: engine.plugins[run.name] for run in experiment.runs},
            device=engine.device,
            threads=engine.threads,
            skips=skips,
            processor=device_name(engine.device),
            **outside,
        ),
        "run": {
            "name": experiment.name,
            "scene": engine.scene.name,
            "triangles": int(sum(len(mesh.faces) for mesh in engine.scene.meshes)),
            "light": light.kind,
            "width": experiment.image.width,
            "height": experiment.image.height,
            "frames": list(experiment.frames),
            "reference_samples": experiment.reference.samples if experiment.reference else None,
            "reference_light": experiment.reference.light if experiment.reference else None,
            "repeats": experiment.repeats,
            "baseline": experiment.baseline,
            "labels": [
                {"label": run.label, "technique": run.name, **declared(engine.plugins[run.name])}
                for run in experiment.runs
            ],
        },
        "environment": describe_machine(engine.device, engine.threads),
        "metrics": {metric.name: metric.version for metric in METRICS.values()},
    }


def describe_identity(
    config: str, scene: str | None, plugins: Mapping[str, type] | None = None, **more: Any
) -> dict[str, Any]:
    """What rows must share to be comparable, for environment.json; a resumed run checks that nothing of it has changed.

    Args:
        config: Text of the resolved experiment.
        scene: Digest of the scene's content; None where nothing is rendered.
        plugins: The techniques that are used, by name.
        more: Further items: device, threads, ...
    """
    files = {f"plugin {name}": file_digest(inspect.getfile(cls)) for name, cls in sorted((plugins or {}).items())}
    versions = {"code": code_digest(), "wkernels": __version__, "warp": package_version("warp-lang")}
    return {"config": text_digest(config), "scene": scene, **files, **more, **versions}


@functools.cache
def code_digest() -> str:
    """Short SHA-256 of the code that techniques share: wkernels, and what of algorithms is no technique."""
    digest = hashlib.sha256()
    for package, left_out in ((wkernels, ()), (algorithms, FAMILIES)):
        root = Path(package.__file__ or "").parent
        for path in sorted(root.rglob("*.py")):
            name = path.relative_to(root)
            if name.parts[0] not in left_out:
                digest.update(f"{root.name}/{name.as_posix()}".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def describe_machine(device: str, threads: int) -> dict[str, Any]:
    """Software and machine that numbers were measured with."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "wkernels": __version__,
        "git": git_commit(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_model(),
        "cores": os.cpu_count(),
        "threads": threads,
        "device": device,
        "device_name": device_name(device),
        "packages": {name: package_version(name) for name in _PACKAGES},
    }


def declared(cls: Any) -> dict[str, Any]:
    """What a technique declares of itself, for reports."""
    paper = getattr(cls, "paper", ())
    return {
        "family": getattr(cls, "family", None),
        "paper": [paper] if isinstance(paper, str) else list(paper),
        "bias_sign": getattr(cls, "bias_sign", None),
        "history": bool(getattr(getattr(cls, "needs", None), "history", False)),
    }


def text_digest(text: str) -> str:
    """Short SHA-256 of a text."""
    return _digest(text.encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def file_digest(path: str | Path) -> str:
    """Short SHA-256 of a file's content."""
    return _digest(Path(path).read_bytes())


def package_version(name: str) -> str | None:
    """Installed version of a distribution, None where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def cpu_model() -> str:
    """The processor's name as the system gives it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.lower().startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def device_name(device: str) -> str:
    """The device's marketing name; the processor's for the CPU."""
    if device == "cpu":
        return cpu_model()
    import warp as wp

    return str(wp.get_device(device).name)


def git_commit() -> str | None:
    """Commit of the source tree that runs, with ``+changes`` where files differ from it; None outside a repository."""
    root = Path(__file__).resolve().parents[2]

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=10
        )
        return done.stdout.strip()

    try:
        if Path(git("rev-parse", "--show-toplevel")) != root:  # installed inside somebody else's repository
            return None
        return git("rev-parse", "HEAD") + ("+changes" if git("status", "--porcelain") else "")
    except (OSError, subprocess.SubprocessError):
        return None

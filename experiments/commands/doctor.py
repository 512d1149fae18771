"""``wkernels doctor``: what this installation has and whether kernels give right numbers on it."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import warp as wp

from wkernels import __version__
from wkernels.device.launch import default_threads, launch

_EXTRAS = {
    "view": {"viser": "viser"},
    "distributed": {"distributed": "distributed"},
    "formats": {"pxr": "usd-core", "collada": "pycollada", "DracoPy": "DracoPy"},
    "meshopt": {"meshoptimizer": "meshoptimizer"},
    "peers": {"mitsuba": "mitsuba", "moderngl": "moderngl", "embreex": "embreex"},
}
_REQUIRED = (
    "warp-lang",
    "numpy",
    "scipy",
    "trimesh",
    "matplotlib",
    "OpenImageIO",
    "pydantic",
    "PyYAML",
    "pandas",
    "mapbox_earcut",
)


@dataclass(frozen=True)
class Finding:
    """One line of the examination; ``ok`` is None for a fact that is neither good nor bad."""

    subject: str
    text: str
    ok: bool | None = None


@wp.kernel
def fill_halves(first: int, values_out: wp.array(dtype=float)):
    """values_out[i] = i / 2."""
    i = first + wp.tid()
    values_out[i] = 0.5 * float(i)


def examine() -> bool:
    """Prints every finding; returns whether nothing that is needed failed."""
    found = findings()
    width = max(len(finding.subject) for finding in found)
    for finding in found:
        mark = {True: "ok  ", False: "FAIL", None: "    "}[finding.ok]
        print(f"{mark}  {finding.subject:<{width}}  {finding.text}")
    failed = sum(finding.ok is False for finding in found)
    print("\nEverything needed works." if not failed else f"\n{failed} problem(s) found.")
    return not failed


def findings() -> list[Finding]:
    """The examination: versions, packages, extras, devices, cache folder, FLIP, and kernels on 1 and 2 threads."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return [
        Finding("wkernels", __version__),
        Finding("python", f"{platform.python_version()} on {platform.platform()}"),
        Finding("cpus", f"{cpus} usable; {default_threads()} threads by default"),
        *(_package(name) for name in _REQUIRED),
        *(_extra(name, modules) for name, modules in _EXTRAS.items()),
        Finding("devices", ", ".join(_device(device) for device in wp.get_devices())),
        _attempt("cache folder", _check_cache),
        _attempt("warp cache", _check_warp_cache),
        _attempt("techniques", _check_plugins),
        _attempt("FLIP", _check_flip),
        _attempt("kernel, 1 thread", partial(_check_kernel, 1)),
        _attempt("kernel, 2 threads", partial(_check_kernel, 2)),
    ]


def _package(name: str) -> Finding:
    try:
        return Finding(name, importlib.metadata.version(name), True)
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, "is not installed", False)


def _extra(name: str, modules: dict[str, str]) -> Finding:
    absent = [package for module, package in modules.items() if importlib.util.find_spec(module) is None]
    text = f"absent: {', '.join(absent)}; pip install 'wkernels[{name}]'" if absent else "present"
    return Finding(f"extra {name}", text)


def _device(device: wp.Device) -> str:
    return f"{device.alias} ({device.name})"


def _attempt(subject: str, check: Callable[[], str]) -> Finding:
    """Runs one check; whatever it raises is its finding, because the others are wanted all the same."""
    try:
        return Finding(subject, check(), True)
    except Exception as error:
        return Finding(subject, f"{type(error).__name__}: {error}", False)


def _check_cache() -> str:
    import platformdirs

    return _writable(Path(platformdirs.user_cache_dir("wkernels", appauthor=False)))


def _check_warp_cache() -> str:
    wp.init()  # fills in the default folder
    return _writable(Path(wp.config.kernel_cache_dir))


def _writable(folder: Path) -> str:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=folder):
        return f"{folder} is writable"


def _check_plugins() -> str:
    from algorithms.plugins import load_all

    return f"{len(load_all())} found"


def _check_flip() -> str:
    import OpenImageIO as oiio

    black, grey = (oiio.ImageBuf(oiio.ImageSpec(16, 16, 3, oiio.FLOAT)) for _ in range(2))
    oiio.ImageBufAlgo.fill(black, (0.0, 0.0, 0.0))
    oiio.ImageBufAlgo.fill(grey, (0.5, 0.5, 0.5))
    mean = oiio.ImageBufAlgo.computePixelStats(oiio.ImageBufAlgo.FLIP_diff(black, grey)).avg[0]
    if not 0.0 < mean <= 1.0:
        raise ValueError(f"OpenImageIO finds a difference of {mean} between black and grey")
    return f"OpenImageIO {oiio.VERSION_STRING}"


def _check_kernel(threads: int) -> str:
    count = 10_000
    values = wp.zeros(count, dtype=float, device="cpu")
    launch(fill_halves, count, [], [values], device="cpu", threads=threads)
    if not np.array_equal(values.numpy(), 0.5 * np.arange(count, dtype=np.float32)):
        raise ValueError("a kernel gave wrong numbers")
    return "right numbers"

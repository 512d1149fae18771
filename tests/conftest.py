from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import small_scenes
import warp as wp

import wkernels  # fixes Warp's options before any test module defines a kernel
from algorithms.projections import table
from experiments import kinds
from experiments.kinds.stability.cases import CASES
from experiments.metrics.registry import METRICS
from experiments.scenes import generators
from experiments.scenes.files import READERS
from wkernels.device import launch as launching
from wkernels.scene.lights import LIGHT_KINDS
from wkernels.scene.model import Scene

assert wkernels.__version__


# Test images are small enough for one tile; cut all the same, so that what is tested is what large ones do.
launching.WORTH_SHARING_S = 0.0

WORKER = os.environ.get("PYTEST_XDIST_WORKER")
if WORKER is not None:  # the workers share the cores; what is about threads asks for them
    os.environ.setdefault("WKERNELS_THREADS", "1")

BY_FIRST_PARAMETER = ("test_conformance.py", "test_checks_can_fail.py", "test_cuda_compiles.py")
"""Files whose tests are many and need nothing from each other: each value of the first parameter may go elsewhere."""
LONG = ("test_twins.py", "test_cuda_compiles.py")
"""Files that come first, as a core that began one of them last would keep all others waiting. Twins send nearly all
kernels to work, which compiles them while the others are at CUDA: hardly any is compiled by two processes at a time."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Hands out whole files, so that what a file's fixtures make is made once; some files in parts."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduler(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file, _, test = nodeid.partition("::")
            return nodeid.partition("-")[0] if file.endswith(BY_FIRST_PARAMETER) and "[" in test else file

    return Scheduler(config, log)


@pytest.fixture(scope="module", autouse=True)
def _own_parts_alone() -> Iterator[None]:
    """Parts of projections that a file's tests add are gone after it: which file comes next in a process is chance."""
    before = {folder: dict(parts) for folder, parts in table._added.items()}
    yield
    for folder, parts in before.items():
        table._added[folder] = parts


OWN_KINDS = (Path(kinds.__path__[0]), Path(kinds.__path__[0]).parent)
"""Where modules of kinds stand: in folders of their own, but for those that all share."""
OURS = ("WKERNELS_", "WARP_", "XDG_", "HOME", "PATH", "PYTHON", "OPENBLAS_")
"""How variables begin that change what is tested; libraries set others when they are imported."""


def _state_of_process() -> dict[str, Any]:
    """What all test files of a process share, and none may change for those that come after it."""
    return {
        "environment": {name: value for name, value in os.environ.items() if name.startswith(OURS)},
        "current folder": os.getcwd(),
        "sys.path": list(sys.path),
        "warnings.showwarning": warnings.showwarning,
        "Warp's options": {
            name: value for name, value in vars(wp.config).items() if isinstance(value, bool | int | str)
        },
        "how launches are cut": (launching.WORTH_SHARING_S, launching.default_threads()),
        "kinds of experiment": (list(kinds.__path__), _strangers()),
        "stiff cases": list(CASES),
        "generators": list(generators.__path__),
        "mesh readers": dict(READERS),
        "metrics": dict(METRICS),
        "light kinds": dict(LIGHT_KINDS),
    }


def _strangers() -> list[str]:
    """Kinds of experiment that have been imported from elsewhere than our folder."""
    files = {name: getattr(item, "__file__", None) for name, item in vars(kinds).items() if name[0] != "_"}
    return sorted(name for name, file in files.items() if file and Path(file).parents[1] not in OWN_KINDS)


@pytest.fixture(scope="module", autouse=True)
def _leaves_nothing_behind() -> Iterator[None]:
    """A file that changes what others share fails at its own end, and not one that happens to come after it."""
    before = _state_of_process()
    yield
    for name in [name for name in sys.modules if name.startswith("wkernels_plugin_")]:
        del sys.modules[name]  # of folders that are gone: the next file of that name is another plugin
    for what, value in _state_of_process().items():
        assert value == before[what], f"{what} is changed for the files that come after this one"


@pytest.fixture(scope="session", autouse=True)
def _shared_references(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """References are traced once in a run, by whichever worker comes first, and never read from an earlier run."""
    folder = tmp_path_factory.getbasetemp()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("WKERNELS_CACHE", str((folder if WORKER is None else folder.parent) / "references"))
        yield


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--device", default="cpu", help="Warp device of the kernel and conformance tests (cpu, cuda:0)")
    parser.addoption("--plugin", action="append", default=[], help="technique file that tests/conformance is about")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> str:
    """The device that kernels run on; it must exist."""
    name: str = request.config.getoption("--device")
    return str(wp.get_device(name))


@pytest.fixture
def box_on_ground() -> Scene:
    """A floating box over a plane under a square light."""
    return small_scenes.box_on_ground(small_scenes.light("rectangle"))


@pytest.fixture
def cluttered() -> Scene:
    """Terrain, boxes and a sphere under a square light."""
    return small_scenes.cluttered(small_scenes.light("rectangle"))

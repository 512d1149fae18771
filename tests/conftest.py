from __future__ import annotations

import pytest
import small_scenes
import warp as wp

import wkernels  # fixes Warp's options before any test module defines a kernel
from wkernels.device import launch as launching
from wkernels.scene.model import Scene

assert wkernels.__version__


# Test images are small enough for one thread; shared all the same, so that what is tested is what large ones do.
launching.WORTH_SHARING_S = 0.0


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

"""A healthy technique passes every check; for every check there are ill ones that it refuses."""

from __future__ import annotations

from pathlib import Path

import declared  # noqa: F401  (registers its checks)
import numpy as np
import over_time  # noqa: F401
import pytest
import rendered  # noqa: F401
import skips  # noqa: F401
import warp as wp
from rig import CHECKS, Check, run_check

from algorithms.plugins import load_all
from algorithms.technique import ExpectedFailure, Technique
from wkernels.frame.session import Session

HONEST = Path(__file__).with_name("honest.py")


@pytest.fixture(scope="module")
def honest() -> type[Technique]:
    return load_all([HONEST])["honest"]


@pytest.mark.parametrize("check", CHECKS.values(), ids=lambda check: check.name)
def test_the_healthy_technique_passes(check: Check, honest: type[Technique], device: str) -> None:
    if not check.applies(honest):
        assert check.name in {
            "a_still_view_converges",
            "disoccluded_pixels_ignore_history",
            "a_reset_forgets_everything",
        }
        return
    check.run(honest, device)


def broken_techniques() -> list:
    from broken import BROKEN

    return [pytest.param(name, technique, id=f"{name}-{technique.__doc__}") for name, technique in BROKEN]


@pytest.mark.parametrize(("name", "technique"), broken_techniques())
def test_an_ill_technique_is_refused(name: str, technique: type[Technique], device: str) -> None:
    assert CHECKS[name].applies(technique), "the fault is never looked at"
    with pytest.raises((AssertionError, ValueError, IndexError)):  # the latter two from the technique itself
        CHECKS[name].run(technique, device)


SLAB = CHECKS["behind_an_opaque_slab_all_is_dark"]


def leaky(honest: type[Technique], message: str, leak: float = 0.01) -> type[Technique]:
    """A technique that lets light through and expects a failure with such a message."""

    def render(self: Technique, frame: Session) -> wp.array:
        if leak < 0.0:
            raise AttributeError("up to nothing")
        visibility = honest.render(self, frame)
        return wp.array(np.maximum(visibility.numpy(), leak), dtype=float, device=frame.device)

    expected = (ExpectedFailure(check=SLAB.name, because="it leaks", message=message),)
    return type("Leaky", (honest,), {"render": render, "expected_failures": expected})


def test_an_expected_failure_is_the_one_that_is_named(honest: type[Technique], device: str) -> None:
    assert run_check(SLAB, leaky(honest, r"^up to 0\.0"), device) == "it leaks"
    with pytest.raises(AssertionError, match="up to"):
        run_check(SLAB, leaky(honest, "down to"), device)
    with pytest.raises(AttributeError):
        run_check(SLAB, leaky(honest, "up to", leak=-1.0), device)
    with pytest.raises(AssertionError, match="passes now"):
        run_check(SLAB, leaky(honest, "up to", leak=0.0), device)


def test_every_check_refuses_something() -> None:
    refused = {param.values[0] for param in broken_techniques()}
    assert refused == set(CHECKS)

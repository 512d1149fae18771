"""Every check on every technique; both are found by themselves."""

from __future__ import annotations

import declared  # noqa: F401  (registers its checks)
import over_time  # noqa: F401
import pytest
import rendered  # noqa: F401
import skips  # noqa: F401
from rig import CHECKS, Check

from algorithms.plugins import load_all
from algorithms.technique import Technique

TECHNIQUES = load_all()


@pytest.mark.parametrize(
    ("technique", "check"),
    [
        pytest.param(technique, check, id=f"{name}-{check.name}")
        for name, technique in TECHNIQUES.items()
        for check in CHECKS.values()
        if check.applies(technique)
    ],
)
def test_technique_conforms(technique: type[Technique], check: Check, device: str) -> None:
    reason = technique.expected_failures.get(check.name)
    try:
        check.run(technique, device)
    except Exception:
        if reason is None:
            raise
        pytest.xfail(reason)
    assert reason is None, f"'{check.name}' passes now: take it out of expected_failures"


@pytest.mark.parametrize("check", CHECKS.values(), ids=lambda check: check.name)
def test_every_check_is_exercised(check: Check) -> None:
    """A check that no technique runs and passes guards nothing."""
    runs = [name for name, t in TECHNIQUES.items() if check.applies(t) and check.name not in t.expected_failures]
    assert runs, f"no technique exercises '{check.name}'"


def test_there_are_techniques() -> None:
    assert len(TECHNIQUES) >= 8

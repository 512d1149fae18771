"""Every check on every technique; both are found by themselves."""

from __future__ import annotations

import declared  # noqa: F401  (registers its checks)
import over_time  # noqa: F401
import pytest
import rendered  # noqa: F401
import skips  # noqa: F401
from rig import CHECKS, Check, run_check

from algorithms.plugins import FAMILIES, ROOT, load_all
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
    reason = run_check(check, technique, device)
    if reason is not None:
        pytest.xfail(reason)


@pytest.mark.parametrize("check", CHECKS.values(), ids=lambda check: check.name)
def test_every_check_is_exercised(check: Check) -> None:
    """A check that no technique runs and passes guards nothing."""
    runs = [
        name
        for name, technique in TECHNIQUES.items()
        if check.applies(technique) and check.name not in {failure.check for failure in technique.expected_failures}
    ]
    assert runs, f"no technique exercises '{check.name}'"


def test_every_file_is_checked() -> None:
    files = [path for family in FAMILIES for path in (ROOT / family).glob("*.py") if path.stem[0] != "_"]
    assert len(TECHNIQUES) == len(files) > 0

"""Every check on every technique; both are found by themselves. With ``--plugin FILE``, on that file's alone."""

from __future__ import annotations

from pathlib import Path

import declared  # noqa: F401  (registers its checks)
import over_time  # noqa: F401
import pytest
import rendered  # noqa: F401
import skips  # noqa: F401
from rig import CHECKS, Check, run_check

from algorithms.plugins import FAMILIES, ROOT, file_of, load_all
from algorithms.technique import Technique

TECHNIQUES = load_all()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "technique" in metafunc.fixturenames:
        files = [Path(file).resolve() for file in metafunc.config.getoption("--plugin")]
        cases = [
            pytest.param(technique, check, id=f"{name}-{check.name}")
            for name, technique in (load_all(files) if files else TECHNIQUES).items()
            if not files or file_of(technique).resolve() in files
            for check in CHECKS.values()
            if check.applies(technique)
        ]
        metafunc.parametrize(("technique", "check"), cases)


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

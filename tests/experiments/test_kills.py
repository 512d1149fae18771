"""Runs that are killed and resumed are as if they had not been; ``killed_runs.py`` kills more often, at any moment."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("killed_runs.py")
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="children are forked")


def kill(*arguments: str) -> str:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = [sys.executable, str(SCRIPT), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the resumed runs are the same" in done.stdout
    return done.stdout


def test_the_real_renderer_killed_at_random_moments() -> None:
    """The whole of it is ``python tests/experiments/killed_runs.py 20 1``."""
    assert "5 kills in " in kill("5", "3")


def test_a_run_killed_while_it_writes() -> None:
    """Before files are replaced, flushed, reserved and deleted, and in the middle of lines; the whole has stride 1."""
    assert "one in 17 of about" in kill("--each-write", "17")

"""``kind: convergence`` with the real renderer: sampling over time converges, and its own error says how far off it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.kinds.convergence.config import Convergence, load_convergence
from experiments.kinds.convergence.report import load_convergence_rows
from experiments.kinds.convergence.run import run_convergence
from experiments.kinds.convergence.store import ConvergenceStore

SCENE = Path(__file__).parents[2] / "configs" / "scenes" / "static_moving_overlap.yaml"
TEXT = f"""\
kind: convergence
scene: {SCENE.as_posix()}
image: {{width: 48, height: 36}}
frame: 40
reference: {{samples: 4096, every: 255}}
steps: [1, 16, 256]
techniques:
- tc_soft_paper: {{label: sampling alone, start: sample, filter: false}}
- reference_multisample
- shadow_map
"""


def test_a_still_camera_converges_to_the_reference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WKERNELS_CACHE", str(tmp_path / "cache"))
    (tmp_path / "c.yaml").write_text(TEXT)
    convergence = load_convergence(tmp_path / "c.yaml")
    assert isinstance(convergence, Convergence)
    out = run_convergence(convergence, tmp_path / "out", report=False)
    table = load_convergence_rows(ConvergenceStore(out)).set_index(["label", "step"])
    alone, rays = table.loc["sampling alone"], table.loc["reference_multisample"]
    assert alone["rmse"].is_monotonic_decreasing
    assert alone.loc[256, "rmse"] < 1.0 / 128.0  # issue 5: maps of 1024 texels do not limit a picture of this size
    assert alone.loc[256, "n"] == 256 and alone.loc[256, "n_effective"] == pytest.approx(256, rel=1e-3)
    for label in (alone, rays):
        assert 0.9 <= label.loc[256, "coverage_2se"] <= 0.999
        # Low-discrepancy samples do better than the independent ones that the standard error assumes.
        assert label.loc[256, "penumbra_rmse"] < label.loc[256, "penumbra_standard_error"]
    assert table.loc[("shadow_map", 1), "rmse"] > 10.0 * alone.loc[256, "rmse"]

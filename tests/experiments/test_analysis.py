"""``kind: analysis``: files, numbers and messages."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments import cli
from experiments.kinds.analysis.config import load_analysis
from experiments.kinds.analysis.run import STEPS, errors_of
from wkernels.errors import InputError

PAPERS = Path(__file__).parents[2] / "configs" / "papers"
TEXT = """\
kind: analysis
camera: {fov_deg: 60, near: 1, far: 40}
light_angle_deg: 90
curves:
- {label: uniform}
- {label: lispsm, warp: lispsm_nopt}
- {label: pssm, splits: 4, scheme: practical, lambda: 0.5}
"""


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    Path("a.yaml").write_text(TEXT)

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["wkernels", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return int(ended.value.code or 0), captured.out, captured.err

    return call


def table(path: Path) -> dict[str, np.ndarray]:
    with open(path, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    labels = dict.fromkeys(row["label"] for row in rows)
    columns = ("z", "m_x", "m_z")
    return {label: np.array([[float(r[c]) for c in columns] for r in rows if r["label"] == label]) for label in labels}


def test_a_run_writes_the_table_the_plot_and_what_made_them(run) -> None:
    status, out, _ = run("run", "a.yaml", "--out", "o")
    assert status == 0 and "analysis.csv" in out
    assert Path("o/analysis.csv").read_text().splitlines()[0] == "label,z,m_x,m_z"
    curves = table(Path("o/analysis.csv"))
    assert list(curves) == ["uniform", "lispsm", "pssm"]
    np.testing.assert_allclose(curves["uniform"][0], (1.0, 40.0, 33.7749907), rtol=1e-6)
    np.testing.assert_allclose(curves["lispsm"][[0, -1], 2], 5.34029, rtol=1e-6)
    borders = np.array([1.0, *(0.5 * (1 + 39 * i / 4) + 0.5 * 40 ** (i / 4) for i in (1, 2, 3)), 40.0])
    np.testing.assert_allclose(curves["pssm"][::STEPS, 0], borders[:-1], rtol=1e-6)
    np.testing.assert_allclose(curves["pssm"][STEPS - 1 :: STEPS, 0], borders[1:], rtol=1e-6)
    before, after = curves["pssm"][STEPS - 1 : -1 : STEPS, 1], curves["pssm"][STEPS::STEPS, 1]
    np.testing.assert_allclose(before, 1.0, rtol=1e-6)
    np.testing.assert_allclose(after, borders[2:] / borders[1:-1], rtol=1e-6)
    assert Path("o/plots/perspective_error.png").stat().st_size > 10_000
    assert json.loads(Path("o/environment.json").read_text())["run"]["kind"] == "analysis"
    status, _, _ = run("run", "o/config.yaml", "--out", "again")
    assert status == 0 and Path("again/analysis.csv").read_text() == Path("o/analysis.csv").read_text()


def test_explain_and_overrides(run) -> None:
    status, out, _ = run("explain", "a.yaml", "--set", "light_angle_deg=20")
    assert status == 0 and "pssm" in out and "20 degrees" in out
    assert run("run", "a.yaml", "--out", "o", "--set", "camera.far=100")[0] == 0
    assert table(Path("o/analysis.csv"))["uniform"][0, 1] == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("warp: lispsm_nopt", "warp: lispsm_nop", "a.yaml:6: curves.1.warp: "),
        ("warp: lispsm_nopt", "warp: arbitrary", "a.yaml:6: curves.1.warp_distance: is required by"),
        ("splits: 4", "splits: 17", "a.yaml:7: curves.2.splits: must be at most 16, not 17."),
        ("splits: 4", "split: 4", "a.yaml:7: curves.2.split: is not a known key. Did you mean 'splits'?"),
        ("label: pssm", "label: uniform", "a.yaml:7: curves.2.label: the label 'uniform' is taken already."),
        ("lambda: 0.5", "pseudo_near: 0.1", "a.yaml:7: curves.2.pseudo_near: needs the scheme 'pseudo'."),
        (
            "scheme: practical, lambda: 0.5",
            "scheme: pseudo, pseudo_near: 0.5, pseudo_far: 0.5",
            "a.yaml:7: curves.2.pseudo_near: pseudo_near and pseudo_far together must be less than 1.",
        ),
        ("lambda: 0.5", "far: 41", "a.yaml:7: curves.2.far: the range 1 to 41"),
        ("far: 40", "far: 1", "a.yaml:2: camera.far: must be greater than near."),
        ("angle_deg: 90", "angle_deg: 181", "a.yaml:3: light_angle_deg: must be at most 180, not 181"),
        ("fov_deg: 60", "fov_deg: .nan", "a.yaml:2: camera.fov_deg: must be a"),
        ("camera: {fov_deg: 60, near: 1, far: 40}\n", "", "a.yaml:1: camera: is required."),
    ],
)
def test_a_mistake_is_one_message_with_file_line_and_key(run, old: str, new: str, expected: str) -> None:
    assert old in TEXT
    Path("a.yaml").write_text(TEXT.replace(old, new))
    for command in ("run", "explain"):
        status, _, err = run(command, "a.yaml")
        assert status == 2 and expected in err and len(err.strip().splitlines()) == 1, err


# Published in the figures, or found from their formulas; the comments of the files give them.
PUBLISHED = {
    "s2_fig_2_8": {"uniform": (40.0, 33.7749907), "LiSPSM": (6.32455532, 5.34029493), "PSM": (1.0, 33.7749907)},
    "s2_fig_3_9": {"uniform": (40.0, 33.7749907), "LiSPSM": (6.32455532, 5.34029493)},
    "s2_fig_4_2": {"LiSPSM": (17.3205081, 14.9497), "pseudo planes": (None, 61.1)},
}


@pytest.mark.parametrize("path", sorted(PAPERS.glob("s2_*.yaml")), ids=lambda path: path.stem)
def test_paper_configs_run_and_give_the_published_numbers(path: Path) -> None:
    if "kind: analysis" not in path.read_text(encoding="utf-8"):
        pytest.skip("rendered; see its own test")
    analysis = load_analysis(path)
    found = {curve.label: errors_of(curve, analysis.camera.fov_deg) for curve in analysis.curves}
    assert all(np.isfinite(e.m_x).all() and np.isfinite(e.m_z).all() for e in found.values())
    for label, (m_x, m_z) in PUBLISHED.get(path.stem, {}).items():
        assert m_x is None or found[label].m_x.max() == pytest.approx(m_x, rel=1e-6)
        assert found[label].m_z.max() == pytest.approx(m_z, rel=1e-3)


def test_every_analysed_figure_has_its_file() -> None:
    figures = ("2_8", "3_5", "3_8", "3_9", "3_12", "3_15", "3_18", "3_19", "4_2", "4_3")
    assert {f"s2_fig_{figure}" for figure in figures} <= {path.stem for path in PAPERS.glob("*.yaml")}


def test_slanted_light_and_the_limits_of_the_angle() -> None:
    for angle in (0.0, 1e-3, 0.5, 1.0, 45.0, 179.5, 180.0):
        for warp in ("none", "psm", "lispsm_nopt", "lispsm_nrepar"):
            from experiments.kinds.analysis.config import Curve

            curve = Curve("c", warp, None, 4, "log", 0.5, 0.0, 0.0, 1e-3, 1e3, angle)
            errors = errors_of(curve, 60.0)
            assert np.isfinite(errors.m_x).all() and np.isfinite(errors.m_z).all() and (errors.m_x > 0.0).all()


def test_no_analysis_is_still_a_walkthrough(run) -> None:
    Path("a.yaml").write_text("kind: analysys\n")
    status, _, err = run("run", "a.yaml")
    assert status == 2 and "Did you mean 'analysis'" in err
    with pytest.raises(InputError, match="no such file"):
        load_analysis("absent.yaml")

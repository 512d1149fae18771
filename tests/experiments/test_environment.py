"""environment.json of every kind of run: what it was made with, and what a resumed run must share with it."""

from __future__ import annotations

import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from fake_engine import FakeEngine, make_experiment

from algorithms.plugins import file_of, find, load_all
from experiments.kinds.analysis.config import load_analysis
from experiments.kinds.analysis.run import run_analysis
from experiments.kinds.convergence.config import Estimates, load_convergence
from experiments.kinds.convergence.estimates import run_estimates
from experiments.kinds.convergence.run import run_convergence
from experiments.kinds.stability import run as stability_run
from experiments.kinds.stability.config import Stability
from experiments.kinds.stability.run import StabilityStore, run_stability
from experiments.kinds.stability.table import COLUMNS
from experiments.kinds.walkthrough.run import run
from experiments.results import environment
from experiments.results.store import Store
from wkernels.errors import InputError

CONFIGS = Path(__file__).parents[2] / "configs"
CONVERGENCE = f"""\
kind: convergence
scene: {(CONFIGS / "scenes" / "a1_half_plane.yaml").as_posix()}
image: {{width: 24, height: 16}}
reference: {{samples: 1}}
steps: [1]
techniques: [shadow_map]
"""
ONE_CASE = Stability("s", ("shadow_map", "pcss"), ("eye_place", "contact_receiver"))


def one_row_each(techniques: Any, cases: Any, **options: Any) -> Any:
    """In the place of ``examine``: as many rows, without rendering."""
    for case in cases:
        for level in stability_run.CASES[case].levels:
            for name in techniques:
                yield dict(zip(COLUMNS, (name, case, level, "ok", ""), strict=True))


def make(kind: str, folder: Path, patch: pytest.MonkeyPatch) -> dict[str, Any]:
    out = folder / "out"
    if kind == "walkthrough":
        e = make_experiment()
        run(e, out, engine=FakeEngine(e), report=False)
    elif kind == "convergence":
        (folder / "c.yaml").write_text(CONVERGENCE)
        c = load_convergence(folder / "c.yaml")
        engine = FakeEngine(c.experiment)
        engine.plugins = {"shadow_map": find("shadow_map")}  # type: ignore[assignment]
        engine.open = lambda lane: FakeEngine(e := make_experiment()).open(e.runs[0])  # type: ignore[method-assign]
        run_convergence(c, out, engine=engine, report=False)
    elif kind == "stability":
        patch.setattr(stability_run, "examine", one_row_each)
        run_stability(ONE_CASE, out, load_all())
    elif kind == "analysis":
        run_analysis(load_analysis(CONFIGS / "papers" / "s2_fig_2_8.yaml"), out)
    else:
        run_estimates(Estimates("t", (1, 0, 1)), out)
    return Store(out).environment()


@pytest.mark.parametrize("kind", ["walkthrough", "convergence", "stability", "analysis", "estimates"])
def test_every_run_says_what_it_was_made_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    data = make(kind, tmp_path, monkeypatch)
    identity = data["identity"]
    assert {"config", "scene", "code", "wkernels", "warp"} <= set(identity)
    assert identity["config"] == environment.text_digest((tmp_path / "out" / "config.yaml").read_text())
    assert identity["code"] == environment.code_digest() and len(identity["code"]) == 16
    assert data["environment"]["git"] == environment.git_commit() and data["environment"]["cpu"]
    plugins = {key for key in identity if key.startswith("plugin ")}
    rendered = kind in ("walkthrough", "convergence", "stability")
    assert bool(identity["scene"]) is bool(plugins) is rendered
    if kind == "stability":
        assert plugins == {"plugin shadow_map", "plugin pcss"}
        own = file_of(find("pcss"))
        assert identity["plugin pcss"] == environment.file_digest(own)
    assert ("processor" in identity) is (kind == "walkthrough")


def test_the_commit_and_whether_files_differ_from_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*arguments: str) -> str:
        own = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
        done = subprocess.run(
            ["git", "-C", str(tmp_path), *own, *arguments], capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    monkeypatch.setattr(environment, "__file__", str(tmp_path / "experiments" / "results" / "environment.py"))
    assert environment.git_commit() is None
    git("init", "-q")
    (tmp_path / "a").write_text("1")
    git("add", "a")
    git("commit", "-qm", "one")
    head = git("rev-parse", "HEAD")
    assert environment.git_commit() == head
    (tmp_path / "a").write_text("2")
    assert environment.git_commit() == f"{head}+changes"


def test_the_code_that_techniques_share_has_a_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = (
        "wkernels/rays/single_rays.py",
        "algorithms/projections/projection.py",
        "algorithms/projections/fits/a.py",
        "algorithms/hard/x.py",
    )
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1")
    for package in ("wkernels", "algorithms"):
        there = SimpleNamespace(__file__=str(tmp_path / package / "__init__.py"))
        monkeypatch.setattr(environment, package, there)
    digests = [environment.code_digest.__wrapped__()]
    for name in names:
        (tmp_path / name).write_text("2")
        digests.append(environment.code_digest.__wrapped__())
    assert len(set(digests[:4])) == 4 and digests[4] == digests[3]  # a technique has a digest of its own


def test_another_processor_or_commit_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    e = make_experiment()
    run(e, tmp_path, engine=FakeEngine(e), report=False)
    run(e, tmp_path, engine=FakeEngine(e), report=False, resume=True)
    assert "resumed" not in Store(tmp_path).environment()
    for commit in ("abc", "abc", "def"):
        monkeypatch.setattr(environment, "git_commit", lambda commit=commit: commit)
        run(e, tmp_path, engine=FakeEngine(e), report=False, resume=True)
    assert [part["git"] for part in Store(tmp_path).environment()["resumed"]] == ["abc", "def"]
    monkeypatch.setattr(environment, "device_name", lambda device: "another")
    with pytest.raises(InputError, match=r"the run cannot be resumed.*processor was .* is another"):
        run(e, tmp_path, engine=FakeEngine(e), report=False, resume=True)


def test_a_stability_run_keeps_what_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also when it is killed at any place of its resuming, and against other configurations and code."""
    make("stability", tmp_path, monkeypatch)
    out, plugins = tmp_path / "out", load_all()
    whole = (out / "stability.csv").read_text()
    with pytest.raises(InputError, match="holds results of another configuration"):
        run_stability(Stability("s", ("pcss",), ONE_CASE.cases), out, plugins)
    (out / "stability.csv").write_text(whole[: len(whole) - 20])  # killed in the second case
    kept = [row for row in Store(out).rows("stability") if row["case"] == "eye_place"]
    monkeypatch.setattr(stability_run, "examine", lambda *args, **options: iter(()))  # killed before the next row
    run_stability(ONE_CASE, out, plugins, resume=True)
    assert Store(out).rows("stability") == kept
    monkeypatch.setattr(stability_run, "examine", one_row_each)
    run_stability(ONE_CASE, out, plugins, resume=True)
    assert (out / "stability.csv").read_text() == whole
    record = StabilityStore(out).environment()
    StabilityStore(out).update_environment(identity={**record["identity"], "plugin pcss": "another"})
    with pytest.raises(InputError, match="plugin pcss was another"):
        run_stability(ONE_CASE, out, plugins, resume=True)


def test_a_disk_that_is_full_is_one_message_where_nothing_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, text: str) -> None:
        raise OSError(28, "No space left on device", str(path))

    for module in ("analysis.run", "convergence.estimates"):
        monkeypatch.setattr(f"experiments.kinds.{module}.write_text", full)
    for kind in ("analysis", "estimates"):
        with pytest.raises(InputError, match=rf"cannot write results here \(No space left on device: {kind}\.csv\)"):
            (tmp_path / kind).mkdir()
            make(kind, tmp_path / kind, monkeypatch)

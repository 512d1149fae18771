"""``kind: stability``: cases that have something to lose, verdicts, the table, resuming, and what is declared."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
import warp as wp

from algorithms.plugins import load_all
from algorithms.technique import Technique
from experiments.kinds.stability.cases import CASES
from experiments.kinds.stability.config import Stability, load_stability
from experiments.kinds.stability.explain import explain_stability
from experiments.kinds.stability.judge import Truth, judge
from experiments.kinds.stability.run import run_stability, summary_text
from experiments.kinds.stability.table import COLUMNS, Stage, breaking_points, concerned, examine
from experiments.results.tables import read_table
from wkernels.errors import InputError
from wkernels.frame.session import Session

NO_SHADOW = {("light_place", "behind the receiver"), ("emptiness", "no casters")}
NO_RECEIVER = {("emptiness", what) for what in ("no receivers", "nothing", "all behind the eye")}
HALF = np.array([[0.0, 1.0], [0.0, 1.0]], np.float32)
QUICK = ("shadow_map", "pcss", "reference_multisample")


# ---- cases -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_every_level_shows_a_shadow_that_can_be_lost(name: str) -> None:
    case = CASES[name]
    for level in case.levels if case.needs is None else case.levels[:1]:
        truth = Stage(case.build(level, "rectangle"), "cpu", None).truth.hard
        seen = truth[np.isfinite(truth)]
        if (name, level) in NO_RECEIVER:
            assert not len(seen)
            continue
        dark = int((seen < 0.5).sum())
        assert len(seen) > 150 and (dark == 0) == ((name, level) in NO_SHADOW), f"{level}: {dark} of {len(seen)} dark"
        # a picture of one value must be told from a good one
        assert dark == 0 or dark == len(seen) or seen.std() > 0.1, f"{level}: {dark} of {len(seen)} dark"


def test_stiffness_is_what_it_says() -> None:
    depth = [CASES["depth_range"].build(level, "point").scene.camera(0) for level in CASES["depth_range"].levels]
    np.testing.assert_allclose([view.far / view.near for view in depth], CASES["depth_range"].levels)
    for name, side in (("light_behind_eye", 1.0), ("light_before_eye", -1.0)):
        for level in CASES[name].levels:
            scene = CASES[name].build(level, "directional").scene
            view = scene.camera(0)
            along = (view.target - view.eye) / np.linalg.norm(view.target - view.eye)
            travels = -scene.lights[0].centre[:3]
            angle = np.degrees(np.arccos(np.clip(side * along @ travels, -1.0, 1.0)))
            assert angle == pytest.approx(level, abs=2e-6)  # arccos of a rounded cosine
    for level in CASES["grazing"].levels:
        assert CASES["grazing"].build(level, "directional").scene.lights[0].centre[1] == pytest.approx(level)
    offset = CASES["world_offset"].build(1e7, "rectangle").scene
    assert offset.lights[0].centre[0] == 1e7 and offset.camera(0).eye[0] == 1e7


# ---- verdicts --------------------------------------------------------------------------------------------------------


def seen(visibility: Any, error: Any = None) -> Any:
    return SimpleNamespace(visibility=np.asarray(visibility, np.float32), standard_error=error)


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (seen([[0.0, np.nan], [0.0, 1.0]]), "not finite in 1 of 4"),
        (seen([[0.0, 1.5], [0.0, 1.0]]), "from 0 to 1.5"),
        (seen([[-0.1, 1.0], [0.0, 1.0]]), "from -0.1 to 1"),
        (seen([[0.0, 1.0]]), "has the size"),
        (seen(HALF, np.full((2, 2), np.inf)), "standard error"),
        (seen(1.0 - HALF), "rmse 1.0000, easy 0.0100"),
    ],
)
def test_what_is_wrong_is_broken_and_says_how(picture: Any, says: str) -> None:
    verdict = judge(picture, Truth(HALF, HALF), 0.01, True)
    assert verdict.broken and says in verdict.detail, verdict


def test_what_may_be_is_not_broken() -> None:
    soft = np.full((2, 2), 0.5, np.float32)
    assert judge(seen(soft), Truth(HALF, soft), 0.0, True).rmse == 0.0  # the nearer truth counts
    assert not judge(seen(1.0 - HALF), Truth(HALF, HALF), 0.01, False).broken  # not judged
    assert not judge(seen(1.0 - HALF), Truth(HALF, HALF), None, True).broken  # the easy level itself
    blank = np.full((2, 2), np.nan, np.float32)
    assert judge(seen(blank), Truth(blank, blank), 0.0, True).detail == "nothing receives"
    assert judge(seen(HALF), Truth(blank, blank), 0.0, True).broken


class Bad(Technique):
    """Sees no shadow, refuses what is far away and raises at what is farther."""

    name, family, paper, bias_sign = "bad", "hard", ("williams1978",), "none"
    stability_limits: ClassVar[dict[str, str]] = {"unit_length": "units are too much for it"}

    def render(self, frame: Session) -> wp.array:
        far = float(np.abs(frame.geometry.origin_ws).max())
        if far > 1e5:
            raise ValueError("too far")
        if far > 1e3:
            raise InputError("farther than it can see.")
        out = frame.visibility_buffer(frame.gbuffer())
        out.fill_(1.0)
        return out


def test_exceptions_refusals_and_declared_limits_are_told_apart() -> None:
    rows = list(examine({"bad": Bad}, ["world_offset"], device="cpu", threads=None))
    assert [row["status"] for row in rows] == ["ok", "ok", "ok", "broken", "broken"]
    assert rows[2]["detail"] == "refused: farther than it can see." and "ValueError: too far" in rows[3]["detail"]
    found = breaking_points(rows)
    assert found["bad", "world_offset"] == ("broken", "1000000")
    assert "2 broken" in summary_text(rows) and "broken: bad, world_offset" in summary_text(rows)


# ---- the run ---------------------------------------------------------------------------------------------------------


def test_a_run_writes_the_contract_and_goes_on_where_it_was_cut(tmp_path: Path) -> None:
    plugins = load_all()
    stability = Stability("s", QUICK, ("eye_place", "few_samples", "contact_receiver"))
    path = run_stability(stability, tmp_path / "o", plugins)
    text = path.read_text()
    assert text.splitlines()[0] == ",".join(COLUMNS) == "technique,case,level,status,detail"
    rows = read_table(path)
    assert len(rows) == 3 * 4 + 3 + 3 * 5 and {row["status"] for row in rows} == {"ok"}
    assert (tmp_path / "o" / "plots" / "stability.png").stat().st_size > 5000
    page = (tmp_path / "o" / "report.html").read_text()
    assert "No technique fails without a declared reason." in page and all(name in page for name in QUICK)
    lines = text.splitlines(keepends=True)
    path.write_text("".join(lines[:15]) + lines[15][:9])  # killed in the middle of a row of the second case
    told: list[str] = []
    run_stability(stability, tmp_path / "o", plugins, resume=True, progress=lambda done, total, what: told.append(what))
    assert path.read_text() == text and told == ["eye_place", "few_samples", "contact_receiver", "done"]


def test_files_say_what_to_run(tmp_path: Path) -> None:
    path, plugins = tmp_path / "s.yaml", load_all()
    path.write_text("kind: stability\n")
    everything = load_stability(path, [], plugins)
    assert everything.techniques == tuple(plugins) and everything.cases == tuple(CASES)
    path.write_text(everything.to_yaml())
    assert load_stability(path, [], plugins).cases == everything.cases
    text = explain_stability(everything, plugins)
    assert "X1: far / near" in text and "pcss, light_grows" in text
    for written, message in (
        ("cases: [eye_plase]", r"s\.yaml:2.*there is no case 'eye_plase'.*'eye_place'"),
        ("techniques: [shadow_map, shadow_map]", r"s\.yaml:2.*listed twice"),
        ("techniques: []", r"s\.yaml:2.*at least one technique"),
        ("levels: 3", r"s\.yaml:2.*levels"),
    ):
        path.write_text(f"kind: stability\n{written}\n")
        with pytest.raises(InputError, match=message):
            load_stability(path, [], plugins)


def test_declared_limits_name_cases_and_concern_their_technique() -> None:
    for technique in load_all().values():
        for case, reason in technique.stability_limits.items():
            assert case in CASES and concerned(technique, CASES[case]) and len(reason) > 20, technique.name


@pytest.mark.parametrize("case", ["depth_range", "light_place", "light_grows", "mesh_damage", "grazing"])
def test_no_technique_breaks_unless_it_says_so(case: str) -> None:
    """The whole table is ``configs/experiments/stability.yaml``; these are the cases in which something may break."""
    rows = list(examine(load_all(), [case], device="cpu", threads=None))
    assert [row for row in rows if row["status"] == "broken"] == []
    declared = {row["technique"] for row in rows if row["status"] == "declared"}
    assert declared == {t.name for t in load_all().values() if case in t.stability_limits}, "a limit that does not bind"

"""A small and always equal part of ``make fuzz``, and proof that what it looks for would be found."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import mischief
import mutations
import pool
import pytest
import run_fuzz
import targets
from experiment_files import FEW, _all_breakages
from experiment_strategies import FILES, experiments
from mesh_seeds import seeds
from model_strategies import broken, examples
from pydantic import BaseModel, ValidationError
from trying import Job, Limits

SEED = 20_260
COUNTS = {"mesh": 250, "import": 100, "broken": 150, "config": 100}


def fuzzed(make: Any, jobs: list[Job], out: Path, **options: Any) -> pool.Tally:
    return pool.run(make, jobs, out, caches=run_fuzz.caches_below(out), **options)


def shown(tally: pool.Tally) -> str:
    return "\n".join(f"{finding.target} {finding.kind} {finding.where}\n{finding.text}" for finding in tally.findings)


def test_nothing_that_is_wrong_does_harm(tmp_path: Path) -> None:
    jobs = [
        Job(name, SEED + begin // pool.BATCH, 0, pool.BATCH)
        for name, count in COUNTS.items()
        for begin in range(0, count, pool.BATCH)
    ]
    tally = fuzzed(targets.targets, jobs, tmp_path)
    assert not tally.findings, shown(tally)
    assert {name: sum(outcomes.values()) for name, outcomes in tally.outcomes.items()} == COUNTS
    assert tally.outcomes["broken"] == Counter(refused=COUNTS["broken"])  # whatever breaks a rule of a model
    for name in ("mesh", "import"):  # both ways are gone: what is wrong, and what can be read still
        assert tally.outcomes[name]["refused"] > 0.3 * COUNTS[name]
        assert tally.outcomes[name]["read"] > 0.1 * COUNTS[name]


def test_what_models_accept_runs(tmp_path: Path) -> None:
    tally = fuzzed(targets.few, [Job("experiment", SEED + i, 0, 16) for i in range(3)], tmp_path)
    assert not tally.findings, shown(tally)
    outcomes = tally.outcomes["experiment"]
    ran = {outcome.removesuffix(" run") for outcome in outcomes if outcome.endswith(" run")}
    assert ran == {"walkthrough", "sweep", "convergence", "analysis", "stability"}, outcomes
    assert outcomes["refused"] < 20, outcomes  # of 48, for rules that span several keys


def test_harm_is_named_and_kept(tmp_path: Path) -> None:
    limits = Limits(seconds=0.5, idle=0.5)
    tally = fuzzed(mischief.targets, [Job("mischief", 3, 0, len(mischief.DEEDS))], tmp_path, limits=limits)
    kinds = {mischief.DEEDS[finding.index]: finding.kind for finding in tally.findings}
    assert kinds == {
        "raises": "KeyError",
        "is wrong": "wrong",
        "crashes": "crash",
        "hangs": "hang",
        "sleeps": "hang",
        "swells": "memory",
        "strays": "stray",
        "litters": "stray",
    }
    assert tally.outcomes["mischief"] == Counter(read=2, refused=1, fault=8)
    for finding in tally.findings:
        assert (finding.folder / "input" / "deed").read_text() == mischief.DEEDS[finding.index]
        assert f"seed 3, index {finding.index}" in (finding.folder / "what.txt").read_text()


def test_inputs_are_the_same_again(tmp_path: Path) -> None:
    for target in targets.few().values():
        if target.name == "results":  # its folders hold times
            continue
        folders = [tmp_path / f"{target.name}{i}" for i in range(2)]
        for folder in folders:
            folder.mkdir()
            target.write(SEED, 3, folder)
        first, second = ({p.name: p.read_bytes() for p in folder.iterdir()} for folder in folders)
        assert first == second


@pytest.mark.parametrize("kind", FILES)
def test_strategies_keep_their_models_and_breakages_break_them(kind: str) -> None:
    model: type[BaseModel] = FILES[kind]
    rng = Random(SEED)
    for data in examples(experiments(kind, FEW), SEED, 12):
        model.model_validate(data, strict=False)
        own = [one for one in _all_breakages(data) if one.loc[0] in model.model_fields and len(one.loc) == 1]
        for breakage in rng.sample(own, min(6, len(own))):
            with pytest.raises(ValidationError):
                model.model_validate(broken(data, breakage))


@pytest.mark.parametrize("suffix", sorted(seeds()))
def test_mutations_change_files(suffix: str) -> None:
    from mesh_files import WAYS, mutated

    assert suffix in WAYS
    found = {mutated(Random(i), suffix) for i in range(40)}
    assert len(found - set(seeds()[suffix])) > 25


def test_trees_are_changed_and_not_shared() -> None:
    tree = {"a": [1, {"b": 2.0}], "c": "word"}
    kept = {"a": [1, {"b": 2.0}], "c": "word"}
    found = [mutations.mutated_tree(Random(i), tree) for i in range(50)]
    assert tree == kept and sum(one != kept for one in found) > 40

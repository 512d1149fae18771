"""What an experiment of ``kind: savings`` will do, for people."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.kinds.savings.config import Savings
from experiments.kinds.walkthrough.explain import left_out_lines


def explain_savings(savings: Savings, plugins: Mapping[str, type]) -> str:
    """What ``run_savings`` will do, for people."""
    lines = [f"Experiment {savings.name} (savings)"]
    for experiment in savings.experiments:
        scene = experiment.loaded_scene
        walk = savings.walk(experiment)
        lines += [
            f"\n{scene.name}: {', '.join(run.label for run in experiment.runs)}",
            f"  {len(walk)} frames of {experiment.image.width} x {experiment.image.height}, {experiment.repeats} times "
            "each: with skips, without, and without each single one that turns out to be taken",
            *(f"  not {label}: {why}" for (name, label), why in savings.unmet.items() if name == scene.name),
            "  Left out",
            *(f"    {line}" for line in left_out_lines(experiment, scene, plugins)),
        ]
    return "\n".join(lines)

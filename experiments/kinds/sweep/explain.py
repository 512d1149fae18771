"""What an experiment of ``kind: sweep`` will do, for people."""

from __future__ import annotations

from collections.abc import Mapping

from experiments.kinds.sweep.config import Sweep
from experiments.kinds.walkthrough.explain import explain


def explain_sweep(sweep: Sweep, plugins: Mapping[str, type]) -> str:
    """What ``run_sweep`` will do, for people: an overview, then each scene's walkthrough."""
    experiments = [scene.experiment for scene in sweep.scenes]
    renderings = sum(len(e.runs) * len(e.frames) * e.repeats for e in experiments)
    compared = [sweep.baseline, *(b if isinstance(b, str) else f"{b:g} ms" for b in sweep.budgets)]
    lines = [
        f"Experiment {sweep.name} (sweep)",
        "",
        f"{len(sweep.runs)} labels on {len(experiments)} scene{'s' if experiments[1:] else ''}: "
        f"{renderings:,} timed renderings",
        f"compared at equal time and equal error with: {', '.join(dict.fromkeys(compared))}",
    ]
    for scene in sweep.scenes:
        lines += ["", f"==== {scene.name}", "", *explain(scene.experiment, plugins).splitlines()[2:]]
        if scene.unserved:
            lines += ["", "Not run here", *(f"  {run.label}: {why}" for run, why in scene.unserved)]
    return "\n".join(lines)

"""What an experiment of ``kind: stability`` will do, for people."""

from __future__ import annotations

from collections.abc import Mapping

from algorithms.technique import Technique
from experiments.kinds.stability.cases import CASES
from experiments.kinds.stability.config import Stability


def explain_stability(stability: Stability, plugins: Mapping[str, type[Technique]]) -> str:
    """What ``run_stability`` will do, for people."""
    width = max(len(name) for name in stability.cases)
    lines = [
        f"Experiment {stability.name} (stability)",
        "",
        f"Techniques: {', '.join(stability.techniques)}",
        "",
        "Cases",
    ]
    for name in stability.cases:
        case = CASES[name]
        levels = ", ".join(level if isinstance(level, str) else f"{level:g}" for level in case.levels)
        lines.append(f"  {name:<{width}}  {case.source}: {case.title}: {levels}")
    declared = [
        f"  {technique}, {case}: {reason}"
        for technique in stability.techniques
        for case, reason in plugins[technique].stability_limits.items()
        if case in stability.cases
    ]
    return "\n".join([*lines, "", "Declared limits", *(declared or ["  none"])])

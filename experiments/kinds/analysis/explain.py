"""What an experiment of ``kind: analysis`` will do, for people."""

from __future__ import annotations

from experiments.kinds.analysis.config import Analysis


def explain_analysis(analysis: Analysis) -> str:
    """What ``run_analysis`` will do, for people."""
    lines = [f"Experiment {analysis.name} (analysis)", "", "What will run"]
    width = max(len(curve.label) for curve in analysis.curves)
    for curve in analysis.curves:
        split = f"{curve.splits} splits, {curve.scheme}" if curve.splits > 1 else "1 split"
        lines.append(
            f"  {curve.label:<{width}}  warp {curve.warp}; {split}; depths {curve.near:g} to {curve.far:g}; "
            f"light at {curve.light_angle_deg:g} degrees to the view"
        )
    return "\n".join([*lines, "", "Left out", "  everything that is rendered: the curves are closed forms"])

"""What an experiment of ``kind: convergence`` will do, for people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from algorithms.plugins import load_all
from experiments.kinds.convergence.config import SAMPLES, Convergence
from experiments.kinds.walkthrough.explain import run_lines, scene_lines, sections_text


def explain_convergence(convergence: Convergence, plugins: Mapping[str, type] | None = None) -> str:
    """What ``run_convergence`` will do, for people; renders nothing."""
    plugins = load_all() if plugins is None else plugins
    e, c = convergence.experiment, convergence
    last = c.steps[-1]
    where = f"frame {c.frame}, held" if c.camera == "still" else f"frames {c.frame} to {c.frame + last - 1} of the path"
    # The baseline of costs is no matter here.
    technique_lines = run_lines(replace(e, baseline=""), plugins)
    work = []
    for run in e.runs:
        rows = len(c.measured(run.label))
        amount = {"frames": f"over {last} frames", SAMPLES: f"{rows} times, with 1 to {last} samples", "none": "once"}
        work.append(f"{run.label}: rendered {amount[c.axes[run.label]]}; {rows} row{'' if rows == 1 else 's'}")
    references = {c.frame_of(s) for run in e.runs for s in c.measured(run.label)} if c.camera == "path" else {0}
    pixels = e.image.width * e.image.height
    work.append(
        f"reference on {len(references)} frame{'' if len(references) == 1 else 's'}: {c.reference.samples} light "
        f"samples, at most {len(references) * pixels * c.reference.samples:,} rays; "
        "what the cache holds is not traced again"
    )
    work.append(f"pictures at steps {', '.join(map(str, c.steps))}")
    sections = [
        ("Scene", [*scene_lines(e, e.load_scene(), plugins), where]),
        ("What will run", technique_lines),
        ("Amount of work", work),
        ("Left out", ["times: nothing is timed, so nothing is warmed up or repeated"]),
    ]
    return sections_text(f"Experiment {c.name} (convergence)", sections)

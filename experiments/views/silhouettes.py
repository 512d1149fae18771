"""What volumes and outer penumbrae begin with: the casters' silhouettes as the light's centre sees them."""

from __future__ import annotations

import colorsys

import numpy as np

from experiments.views.lines import draw_lines
from experiments.views.sheet import Chips, Panel, Sheet
from experiments.views.subject import Subject
from experiments.views.surfaces import base, draw_frustum
from wkernels.casters.pulls import pull_edges, pull_loops, pull_silhouettes

COLORS = 12
"""How many colours loops have in turn."""
OFTEN = (0.05, 0.06, 0.10)
"""Of edges that count more than once."""


def loop_color(index: int) -> tuple[float, float, float]:
    """Colour of a loop; neighbours in the list are far apart on the wheel."""
    return colorsys.hsv_to_rgb((index * 5 % COLORS) / COLORS, 0.85, 0.9)


def silhouettes(subject: Subject, place: str) -> Sheet:
    """Silhouette edges, loop by loop; those that count more than once in black over their loop's colour."""
    shot, session, geometry = subject.shot(place), subject.session, subject.geometry
    image = base(shot)
    found = pull_silhouettes(session, geometry, session.light.centre)
    loops = pull_loops(session, found)
    ends = geometry.points_ws.numpy().astype(np.float64)[found.ends]
    of_edge = np.zeros(len(found.edge), int)
    of_edge[loops.member] = np.repeat(np.arange(len(loops.closed)), np.diff(loops.begin))
    for tone in range(min(COLORS, len(loops.closed))):
        draw_lines(image, shot.view, ends[of_edge % COLORS == tone], loop_color(tone), depth=shot.depth, width=2.0)
    several = found.weight > 1
    draw_lines(image, shot.view, ends[several], OFTEN, depth=shot.depth, width=1.0, hidden=0.0, halo=False)
    if place == "third":
        draw_frustum(image, subject, shot)
    counts = pull_edges(session, geometry).counts
    share = 100.0 * len(found.edge) / max(1, len(pull_edges(session, geometry).edges))
    notes = [
        f"{len(found.edge)} of the casters' edges ({share:.3g} %) in {len(loops.closed)} loops, "
        f"{int(several.sum())} of them count more than once. Dashed: behind a surface.",
        " ".join(counts.sentences) or "All casters are closed bodies.",
    ]
    chips = [(loop_color(i), name) for i, name in enumerate(("a loop", "another", "and so on"))]
    if several.any():
        chips.append((OFTEN, "counts more than once: a fold of an open surface, or several faces at one edge"))
    return Sheet([Panel(image)], [Chips(chips)], notes)

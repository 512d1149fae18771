"""Penumbra wedges as bodies in space, and what their halves do in each pixel."""

from __future__ import annotations

import numpy as np

from experiments.views.lines import draw_lines
from experiments.views.sheet import Bar, Chips, Panel, Sheet
from experiments.views.silhouettes import loop_color
from experiments.views.subject import Subject
from experiments.views.surfaces import base, draw_frustum
from wkernels.casters.wedges.bodies import corners_each
from wkernels.casters.wedges.halves import see_halves
from wkernels.casters.wedges.light_shapes import shape_of
from wkernels.casters.wedges.passes import Prepared, Stage, prepare

SHOWN = 8
"""Wedges of one caster that are drawn, at most."""
EDGE = (0.05, 0.06, 0.10)


def _prepared(subject: Subject) -> Prepared | None:
    """The light's wedges, not split: those that the session keeps, or made for the picture."""
    session = subject.session
    stage = Stage(
        session,
        session.rasteriser,
        session.geometry,
        session.gbuffer(),
        session.eye(),
        session.caster_mesh().mesh,
        session.reach,
        "tight",
        True,
    )
    usable = session.geometry.caster_triangles and shape_of(session.light, np.zeros(3)) is not None
    return prepare(stage, session.light, "picture") if usable else None


def wedges(subject: Subject) -> Sheet:
    """Edges, and from both ends of some of them the mirror images of the light's border, as far as the scene goes."""
    shot, image = subject.shot("third"), base(subject.shot("third"))
    prepared = _prepared(subject)
    drawn, total = 0, 0
    if prepared is not None and len(prepared.wedges.component):
        made = prepared.wedges
        each, total = corners_each(made), len(made.component)
        corners = made.points_ws.numpy().astype(np.float64).reshape(total, each, 4)
        far = 0.5 * prepared.stage.reach
        for caster in np.unique(made.component):
            own = np.flatnonzero(made.component == caster)
            chosen = own[:: max(1, -(-len(own) // SHOWN))]
            drawn += len(chosen)
            color = loop_color(int(caster))
            draw_lines(image, shot.view, corners[own][:, :2, :3], EDGE, depth=shot.depth, width=1.0)
            for body in corners[chosen]:
                draw_lines(image, shot.view, _outline(body, far), color, depth=shot.depth, width=1.0, hidden=0.25)
            draw_lines(image, shot.view, corners[chosen][:, :2, :3], color, depth=shot.depth, width=2.5)
    draw_frustum(image, subject, shot)
    notes = [f"{drawn} of {total} wedges. Dashed: behind a surface. They reach to infinity and are cut here."]
    return Sheet([Panel(image)], [Chips([(EDGE, "silhouettes"), (loop_color(0), "wedges of a caster")])], notes)


def _outline(body: np.ndarray, far: float) -> np.ndarray:
    """Segments (n, 2, 3) of a body's pyramids: from its ends along its ways, and around their bases."""
    ends, ways = body[:2, :3], body[2:, :3]
    around = len(ways) // 2
    out = []
    for i, end in enumerate(ends):
        # a sun's ways are the same at both ends
        own = ways[i * around : (i + 1) * around] if around > 2 else ways
        base_ = end + far * own
        out += [np.stack([end, corner]) for corner in base_]
        out += [np.stack(pair) for pair in zip(base_, np.roll(base_, -1, axis=0), strict=True)]
    return np.array(out)


def v_buffer(subject: Subject) -> Sheet:
    """Three panels: added, taken away, and wedges that a pixel lies in."""
    prepared = _prepared(subject)
    shot = subject.shot("eye")
    if prepared is None:
        return Sheet([Panel(base(shot))], [], ["The light has no area: no wedges."])
    added, taken, inside, listed = (image.numpy() for image in see_halves(prepared))
    most = max(1, int(inside.max()))
    panels = [
        Panel(_shaded(added, np.array((0.16, 0.55, 0.35))), "added by inner halves"),
        Panel(_shaded(taken, np.array((0.75, 0.25, 0.20))), "taken by outer halves"),
        Panel(_shaded(inside / most, np.array((0.20, 0.30, 0.70))), f"wedges, up to {most}"),
    ]
    some = inside > 0
    share = 100.0 * float(some.mean())
    notes = [
        f"{share:.3g} % of the pixels lie in a wedge, those in {float(inside[some].mean()) if some.any() else 0.0:.3g} "
        f"on average; a tile with any lists {float(listed[listed > 0].mean()) if (listed > 0).any() else 0.0:.3g}."
    ]

    def colors(place: np.ndarray) -> np.ndarray:
        out: np.ndarray = _shaded(place[None], np.array((0.35, 0.35, 0.40)))[0]
        return out

    bar = Bar("share of the light, or of the most wedges", colors, [(0.0, "0"), (0.5, "1/2"), (1.0, "1 or more")])
    return Sheet(panels, [bar], notes, columns=3)


def _shaded(values: np.ndarray, color: np.ndarray) -> np.ndarray:
    """White to a colour for 0 to 1, (H, W, 3)."""
    strength = np.clip(values, 0.0, 1.0)[..., None] ** 0.5
    out: np.ndarray = 1.0 - strength * (1.0 - color)
    return out

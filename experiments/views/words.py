"""A projection in words, for the heading of a picture."""

from __future__ import annotations

from algorithms.projections.schema import Projection
from algorithms.projections.table import fits, warps
from wkernels.scene.views import HostView, ProjectiveView

_TOLD = {"fit", "warp", "splits", "scheme", "lambda"}


def projection_in_words(chosen: Projection, views: list[HostView], light: str) -> str:
    """One line: fit, warp, splits, whatever else is not at its default, maps and light.

    Args:
        chosen: What the light map was asked for.
        views: The maps in use, one a layer; may be empty.
        light: Kind of light.
    """
    if views and fits()[chosen.fit].follows_eye and not any(isinstance(view, ProjectiveView) for view in views):
        # the light is amid what is seen, or nothing is: then no plane map holds it (``projections.composition``)
        chosen = Projection()
    parts = [fits()[chosen.fit].title or f"fit {chosen.fit}", warps()[chosen.warp].title or f"warp {chosen.warp}"]
    if chosen.splits > 1:
        blend = f", lambda {chosen.lambda_:g}" if chosen.scheme in ("practical", "pseudo") else ""
        parts.append(f"{chosen.splits} splits ({chosen.scheme}{blend})")
    others = {key: value for key, value in chosen.changed().items() if key not in _TOLD}
    parts += [f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in others.items()]
    if views:
        size = views[0].width
        parts.append(f"{len(views)} map{'s' if len(views) > 1 else ''} of {size} x {size}")
    else:
        parts = ["no light map"]
    return "; ".join([*parts, f"{light} light"])

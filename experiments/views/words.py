"""A projection in words, for the heading of a picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from wkernels.scene.views import HostView, ProjectiveView

_FITS = {"focused": "focused on what the eye sees", "scene": "fitted to the whole scene"}
_WARPS = {
    "none": "uniform",
    "psm": "PSM warp",
    "lispsm_nopt": "LiSPSM warp (n_opt)",
    "lispsm_nrepar": "LiSPSM warp (n_repar)",
    "arbitrary": "warp of arbitrary strength",
}
_TOLD = {"fit", "warp", "splits", "scheme", "lambda"}


def projection_in_words(settings: Mapping[str, Any], views: list[HostView], light: str) -> str:
    """One line: fit, warp, splits, whatever else is not at its default, maps and light.

    Args:
        settings: Keys of ``algorithms.projections.composition.DEFAULTS``; what is missing is at its default.
        views: The maps in use, one a layer; may be empty.
        light: Kind of light.
    """
    from algorithms.projections.composition import DEFAULTS

    chosen = {**DEFAULTS, **settings}
    if views and chosen["fit"] != "scene" and not any(isinstance(view, ProjectiveView) for view in views):
        # the light is amid what is seen, or nothing is: then no plane map holds it (``projections.composition``)
        chosen = dict(DEFAULTS)
    parts = [_FITS.get(str(chosen["fit"]), f"fit {chosen['fit']}")]
    parts.append(_WARPS.get(str(chosen["warp"]), str(chosen["warp"])))
    if chosen["splits"] > 1:
        scheme = str(chosen["scheme"])
        blend = f", lambda {chosen['lambda']:g}" if scheme in ("practical", "pseudo") else ""
        parts.append(f"{chosen['splits']} splits ({scheme}{blend})")
    others = {key: value for key, value in chosen.items() if key not in _TOLD and value != DEFAULTS.get(key)}
    parts += [f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in others.items()]
    if views:
        size = views[0].width
        parts.append(f"{len(views)} map{'s' if len(views) > 1 else ''} of {size} x {size}")
    else:
        parts = ["no light map"]
    return "; ".join([*parts, f"{light} light"])

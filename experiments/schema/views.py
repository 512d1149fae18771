"""The key ``views`` of a walkthrough, resolved against its frames and labels."""

from __future__ import annotations

from collections.abc import Sequence

from experiments.config.source import Source
from experiments.schema.models import FrameRange, RunFile, Views
from experiments.schema.view_kinds import KINDS
from wkernels.errors import nearest


def resolve_views(source: Source, file: RunFile, frames: Sequence[int], labels: Sequence[str]) -> Views | None:
    """The pictures that a file asks for, with every default filled in; None where it asks for none.

    Args:
        source: The experiment file; names file and line in messages.
        file: Its content.
        frames: The frames that will be rendered.
        labels: The labels that will be rendered.

    Raises:
        InputError: A frame that is not rendered, a kind or label that does not exist, or anything that is listed twice.
    """
    views = file.views
    if views is None:
        return None
    wanted = views.frames
    if isinstance(wanted, FrameRange):
        chosen = [frame for frame in wanted.indices() if frame in frames]
        if not chosen:
            raise source.error("none of these frames is rendered; see the key frames.", ("views", "frames"))
    else:
        chosen = list(frames[:1]) if wanted is None else wanted
        for i, frame in enumerate(chosen):
            if frame not in frames:
                message = f"frame {frame} is not rendered; the frames of this experiment are {_shown(frames)}."
                raise source.error(message, ("views", "frames", i))
    for i, label in enumerate(views.labels or ()):
        if label not in labels:
            message = f"no technique has the label '{label}'." + nearest(label, labels)
            raise source.error(message, ("views", "labels", i))
    kinds = [views.kinds] if isinstance(views.kinds, str) else list(views.kinds)
    for i, kind in enumerate(kinds):
        if kind not in KINDS and views.kinds != "all":
            place = ("views", "kinds") if isinstance(views.kinds, str) else ("views", "kinds", i)
            raise source.error(f"there is no view '{kind}'." + nearest(kind, KINDS), place)
    if views.kinds == "all":
        kinds = list(KINDS)
    for key, values in (("frames", chosen), ("kinds", kinds), ("labels", views.labels or []), ("modes", views.modes)):
        for i, value in enumerate(values):
            if value in values[:i]:
                raise source.error(f"{value} is listed twice.", ("views", key, i))
    image = views.image or file.image
    return views.model_copy(update={"frames": sorted(chosen), "kinds": kinds, "image": image})


def _shown(frames: Sequence[int]) -> str:
    return ", ".join(map(str, frames)) if len(frames) <= 4 else f"{frames[0]}, {frames[1]}, ..., {frames[-1]}"

"""Makes every picture that an experiment asks for of one label's frame, outside all timing."""

from __future__ import annotations

import contextlib
import functools
import traceback
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from experiments.results.images import write_png
from experiments.results.store import Store
from experiments.results.tables import write_text
from experiments.schema.view_kinds import KINDS, picture_names
from experiments.views import error_plot, light_maps, silhouettes, space, surfaces, wedges
from experiments.views.sheet import Sheet, composed
from experiments.views.subject import Subject
from experiments.views.words import projection_in_words

if TYPE_CHECKING:
    import numpy as np

    from experiments.rendering.engine import FrameLike, WarpEngine
    from experiments.schema.experiment import Experiment
    from experiments.schema.techniques import TechniqueRun
    from wkernels.frame.session import Session

Skipped = tuple[str, str, int]
"""What, why, and how many: a row of left_out.csv."""

_DRAW: Mapping[str, Callable[[Subject], Sheet]] = {
    "texel_borders_eye": lambda subject: surfaces.texel_borders(subject, "eye"),
    "texel_borders_third": lambda subject: surfaces.texel_borders(subject, "third"),
    "split_colours_eye": lambda subject: surfaces.split_colours(subject, "eye"),
    "split_colours_third": lambda subject: surfaces.split_colours(subject, "third"),
    **{
        f"sampling_frequency_{mode}_{place}": functools.partial(surfaces.sampling_frequency, place=place, mode=mode)
        for mode in ("det", "x", "y")
        for place in ("eye", "third")
    },
    "difference_eye": lambda subject: surfaces.difference(subject, "eye"),
    "difference_third": lambda subject: surfaces.difference(subject, "third"),
    "silhouettes_eye": lambda subject: silhouettes.silhouettes(subject, "eye"),
    "silhouettes_third": lambda subject: silhouettes.silhouettes(subject, "third"),
    "wedges_third": wedges.wedges,
    "v_buffer_eye": wedges.v_buffer,
    "intersection_bodies_third": space.intersection_bodies,
    "frusta_third": space.frusta,
    "minimap_third": space.minimap,
    "light_views": light_maps.light_views,
    "depth_map": light_maps.depth_map,
    "shadow_area_waste": light_maps.shadow_area_waste,
    "shadow_area_waste_third": surfaces.wasted_surfaces,
    "perspective_error": error_plot.perspective_error,
}


def make_views(
    experiment: Experiment,
    engine: WarpEngine,
    run: TechniqueRun,
    session: Session,
    result: FrameLike,
    frame: int,
    reference: np.ndarray | None,
    store: Store,
) -> list[Skipped]:
    """Writes the pictures of one label's frame.

    Args:
        experiment: What is run; its ``views`` say what is wanted.
        engine: Its renderer.
        run: The label.
        session: The label's session, which has just rendered the frame.
        result: What it rendered.
        frame: Frame number.
        reference: The frame's reference visibility (H, W), if one was made.
        store: Where they go.

    Returns:
        What was not made, and why.
    """
    views = experiment.views
    if views is None or frame not in (views.frames or ()) or (views.labels and run.label not in views.labels):
        return []
    kinds = [kind for kind in KINDS if kind in views.kinds]
    skipped: list[Skipped] = []
    foreign = [kind for kind in kinds if KINDS[kind].pulls not in {None, *session.pulled}]
    if foreign:
        kinds = [kind for kind in kinds if kind not in foreign]
        skipped.append((f"views {', '.join(foreign)}", f"{run.name} pulls none of what they show", len(foreign)))
    if session.shown is None:
        # unless the label was asked for by name, the pictures that are left would not be about it
        about = [kind for kind in kinds if KINDS[kind].pulls is not None]
        dropped = [kind for kind in kinds if KINDS[kind].needs_map or not (views.labels or kind in about)]
        kinds = [kind for kind in kinds if kind not in dropped]
        if dropped:
            skipped.append((f"views {', '.join(dropped)}", f"{run.name} reads no light map here", len(dropped)))
    if not kinds:
        return skipped
    subject = Subject(experiment, engine, run, session, result, frame, reference)
    words = projection_in_words(subject.settings, subject.views, session.light.kind)
    for kind in kinds:
        for name in picture_names(kind, list(views.modes)):
            try:
                sheet = _DRAW[name](subject)
            except Exception as error:
                # one picture must not cost the run: it is recorded, with its traceback, and the others are made
                skipped.append((f"view {name}", f"it could not be drawn: {type(error).__name__}: {error}", 1))
                text = "".join(traceback.format_exception(error))
                with contextlib.suppress(OSError):
                    (store.out / "failures").mkdir(exist_ok=True)
                    write_text(store.out / "failures" / f"{run.label}, {name}, frame {frame}.txt", text)
                continue
            title = f"{KINDS[kind].title}{_place(name)}: {run.label}, frame {frame}"
            with store.files(run.name, run.label, frame) as put:
                put(write_png, store.picture(run.label, name, frame), composed(sheet, title, words))
    return skipped


def _place(name: str) -> str:
    if name.endswith("_third"):
        return ", third-person view"
    return ", eye's view" if name.endswith("_eye") else ""

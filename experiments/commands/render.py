"""``wkernels render``: one visibility image of one technique."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from algorithms.plugins import load_all
from experiments.api import render_visibility
from experiments.config.source import parse_yaml
from experiments.results.images import check_path, visibility_view, write_exr, write_png
from experiments.scenes import load_scene
from experiments.scenes.sight import why_nothing_is_seen
from wkernels.errors import InputError

_SUFFIXES = (".exr", ".png")


def render_image(
    scene: Path,
    technique: str,
    out: Path,
    *,
    param_texts: Sequence[str],
    plugin_files: Sequence[Path],
    width: int,
    height: int,
    frame: int,
    frames: int,
    light: int,
    device: str,
    threads: int | None,
    seed: int,
) -> None:
    """Renders and writes ``out``; wrong input is found before anything is rendered."""
    if out.suffix.lower() not in _SUFFIXES:
        raise InputError(f"--out {out}: the name must end in {' or '.join(_SUFFIXES)}.")
    check_path(out)
    if not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: there is no folder {out.resolve().parent}.")
    loaded = load_scene(scene)
    visibility = render_visibility(
        loaded,
        technique,
        parse_params(param_texts),
        frame=frame,
        frames=frames,
        width=width,
        height=height,
        light=light,
        device=device,
        seed=seed,
        threads=threads,
        plugins=load_all(plugin_files),
    ).visibility
    _write(out, visibility)
    seen = np.isfinite(visibility)
    lit = f"mean visibility {visibility[seen].mean():.4f}" if seen.any() else ""
    lit = lit or f"no receiver is seen: {why_nothing_is_seen(loaded, frame, width, height)}"
    print(f"{out}: {technique}, {width} x {height}, frame {frame}; {lit}")


def parse_params(texts: Sequence[str]) -> dict[str, Any]:
    """``["taps=16", "bias=slope"]`` as a mapping; values are YAML.

    Raises:
        InputError: No ``=``, no name, a name twice, or a value that is no YAML.
    """
    params: dict[str, Any] = {}
    for text in texts:
        origin = f"--param {text}"
        name, equals, value = text.partition("=")
        name = name.strip()
        if not equals or not name:
            raise InputError("must have the form key=value.", file=origin)
        if name in params:
            raise InputError(f"'{name}' is given twice.", file=origin)
        params[name] = parse_yaml(value, origin).data if value.strip() else None
    return params


def _write(out: Path, visibility: np.ndarray) -> None:
    try:
        if out.suffix.lower() == ".png":
            write_png(out, visibility_view(visibility))
        else:
            write_exr(out, visibility, "visibility: 1 = lit, 0 = umbra, NaN = no receiver")
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror or error}.") from None

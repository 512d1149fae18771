"""Which kind of experiment a file is, before anything else in it is looked at."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from experiments.config.overrides import apply_overrides
from experiments.config.source import load_yaml
from wkernels.errors import InputError


def kind_of(path: str | Path, overrides: Iterable[str] = ()) -> str | None:
    """The value of the key ``kind``; None where it is no text or the file cannot be read, which loaders say better."""
    own = [text for text in overrides if text.partition("=")[0].strip() == "kind"]
    try:
        source = load_yaml(Path(path))
        if not isinstance(source.data, Mapping):
            return None
        kind = apply_overrides(source, own).data.get("kind")
    except InputError:
        return None
    return kind if isinstance(kind, str) else None

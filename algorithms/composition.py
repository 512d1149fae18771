"""Composing a projection from its parts, as the key ``projection`` of an experiment file names them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from algorithms.projection import fits
from wkernels.errors import InputError, nearest
from wkernels.frame import LightViews

SPLIT_KEYS = frozenset({"scheme", "lambda", "selection", "storage"})
"""Keys that say how several splits are spaced, chosen and stored: without effect while there is one."""


def compose(settings: Mapping[str, Any] | None = None) -> LightViews:
    """The projection that a mapping with the keys of an experiment file's ``projection`` stands for.

    Args:
        settings: ``fit``, ``warp``, ``splits``, ``stabilise`` and the keys of ``SPLIT_KEYS``; what is left out is the
            plainest value (``scene``, ``none``, 1, ``none``).

    Raises:
        InputError: An unknown key, or a value that does not exist; the message lists those that do.
    """
    settings = dict(settings or {})
    table = fits()
    known: dict[str, list[Any]] = {"fit": list(table), "warp": ["none"], "splits": [1], "stabilise": ["none"]}
    for key, value in settings.items():
        if key not in known and key not in SPLIT_KEYS:
            raise InputError(f"is not a known key.{nearest(str(key), [*known, *SPLIT_KEYS])}", key=f"projection.{key}")
        # a bool compares equal to 1 and is no number of splits
        if key in known and (isinstance(value, bool) or value not in known[key]):
            choices = ", ".join(str(choice) for choice in known[key])
            raise InputError(f"{value!r} is not available; available: {choices}.", key=f"projection.{key}")
    return table[settings.get("fit", "scene")]().views

"""Kernels' structs made whole: a field that is forgotten would be 0, and nobody would say so."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def filled(kind: Callable[[], T], /, **fields: Any) -> T:
    """A struct with all of its fields.

    Args:
        kind: A class made by ``wp.struct``.
        fields: Value of each; None for an array that no kernel reads.

    Raises:
        TypeError: One is missing, or is none of the struct's.
    """
    wanted = set(kind.vars)  # type: ignore[attr-defined]
    if wrong := wanted ^ set(fields):
        raise TypeError(f"{kind.key} is made of {sorted(wanted)}, not of {sorted(fields)}: {sorted(wrong)}")  # type: ignore[attr-defined]
    out = kind()
    for name, value in fields.items():
        setattr(out, name, value)
    return out

"""What outlives a frame while its inputs stay the same: maps, ray structures, tables; built when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

UNCHANGED = "its inputs have not changed since it was built"
UNASKED = "nothing asks for it"
OPTIONAL = ("light depth map", "light samples", "caster ray structure", "caster tree", "history")
"""Names of what a frame may do without, and which is worth saying: history buffers are no product, but alike."""


@dataclass
class _Product:
    value: Any
    stamp: Hashable
    visit: int


class Products:
    """The products of one session.

    Args:
        timed: Charges what happens in its context to the pass of that name.
        leave_out: Asked, with what and why, before a product of an earlier visit is taken for this one's.

    Attributes:
        visit: Number of the present stay at a frame; what was built during it is taken without asking.
        asked: Names of what this frame has asked for.
    """

    def __init__(
        self, timed: Callable[[str], AbstractContextManager[None]], leave_out: Callable[[str, str], bool]
    ) -> None:
        self._timed, self._leave_out = timed, leave_out
        self._held: dict[Hashable, _Product] = {}
        self.visit = 0
        self.asked: set[str] = set()

    def pull(self, name: str, key: Hashable, inputs: Hashable, build: Callable[[Any], Any]) -> Any:
        """The product, built anew where its inputs differ; ``Session.product``."""
        self.asked.add(name)
        held = self._held.get(key)
        if held is not None and held.stamp is not None and held.stamp == inputs:
            if held.visit == self.visit or self._leave_out(name, UNCHANGED):
                return held.value
        with self._timed(name):
            value = build(held.value if held else None)
        self._held[key] = _Product(value, inputs, self.visit)
        return value

    def expire(self) -> None:
        """Makes the content of what was built during this visit invalid; its memory stays."""
        for product in self._held.values():
            if product.visit == self.visit:
                product.stamp = None

    def clear(self) -> None:
        """Forgets all."""
        self._held.clear()

"""What outlives a frame while its inputs stay the same: maps, ray structures, tables; built when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum
from typing import Any

from wkernels.workspace.left_out import Omission

UNCHANGED = "its inputs have not changed since it was built"


class Product(Enum):
    """What a frame offers and a technique declares to pull; the value is the name of the pass that builds it."""

    G_BUFFER = "g-buffer"
    LIGHT_MAP = "light depth map"
    KEPT_MAPS = "maps"  # of many light samples, over frames
    LIGHT_SAMPLES = "light samples"
    RAY_STRUCTURE = "caster ray structure"
    CASTER_TREE = "caster tree"
    CASTER_EDGES = "caster edges"
    SILHOUETTES = "silhouettes"
    VOLUMES = "volumes"
    WEDGES = "wedges"
    HISTORY = "history"


class Unasked(Omission):
    """What a frame may do without, and which is worth saying."""

    LIGHT_MAP = Product.LIGHT_MAP.value, "nothing asks for it"
    LIGHT_SAMPLES = Product.LIGHT_SAMPLES.value, "nothing asks for it"
    RAY_STRUCTURE = Product.RAY_STRUCTURE.value, "nothing asks for it"
    CASTER_TREE = Product.CASTER_TREE.value, "nothing asks for it"
    HISTORY = Product.HISTORY.value, "nothing asks for it"

    @property
    def product(self) -> Product:
        """What is done without."""
        return Product(self.pair[0])


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
        asked: Names of what this frame has asked for; history buffers are no product, but alike.
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

"""What a frame did not do, why and how often; and what of it is done all the same, to measure what it saves.

What may be left out is listed where it is left out, as members of an ``Omission``: what, and for which reason.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from enum import Enum

Reasoned = tuple[str, str]
"""What was left out, and the reason, as results tell it."""


class Because(Enum):
    """Reasons that a scene alone decides, so that ``explain`` can tell beforehand what is left out for them."""

    NOTHING_CASTS = "nothing casts"
    NO_CASTER_MOVES = "no caster moves"
    NO_AREA = "the light has no area"


class Omission(Enum):
    """Base of lists of what may be left out; the value of a member is what, and a reason: a ``Because`` or a text."""

    @property
    def pair(self) -> Reasoned:
        """What is left out, and why it is not needed."""
        what, reason = self.value
        return what, reason.value if isinstance(reason, Because) else reason

    @property
    def because(self) -> Because | None:
        """The reason, where a scene alone decides it."""
        reason = self.value[1]
        return reason if isinstance(reason, Because) else None


class LeavesOut:
    """Keeps the list; the base of workspaces.

    What is left out is named by a member of an ``Omission``, or by two words, ``what`` and ``reason``, where only the
    program's data know them.

    Args:
        skips: Whether work that the scene cannot need may be left out at all.
        done_anyway: What is done nevertheless.

    Attributes:
        left_out: How often what was left out of the frame for which reason.
        inherent: What of all that was told with no choice: the method itself does not do it.
    """

    def __init__(self, skips: bool, done_anyway: Collection[Reasoned] = ()) -> None:
        self.skips, self.done_anyway = skips, frozenset(done_anyway)
        self.left_out: dict[Reasoned, int] = {}
        self.inherent: set[Reasoned] = set()
        self._to_count: list[tuple[Reasoned, Callable[[], int]]] = []

    def may_leave_out(self, what: Omission | str, reason: str = "") -> bool:
        """Whether ``what`` may be left out: for work that finds out itself how much of it."""
        return self.skips and _pair(what, reason) not in self.done_anyway

    def leave_out(self, what: Omission | str, reason: str = "", count: int = 1) -> bool:
        """Records that ``what`` is not needed here and returns True; False, unrecorded, where it is to be done."""
        if not self.may_leave_out(what, reason):
            return False
        self.record(what, reason, count)
        return True

    def count_later(self, what: Omission, count: Callable[[], int]) -> None:
        """Records, if it may be left out, what only an image tells the number of; counted when times are taken."""
        if self.may_leave_out(what):
            self._to_count.append((what.pair, count))

    def tell(self, what: Omission | str, reason: str = "", count: Callable[[], int] = lambda: 1) -> None:
        """Records, with skips on, what the method itself does not do here; counted when times are taken."""
        if self.skips:
            pair = _pair(what, reason)
            self.inherent.add(pair)
            self._to_count.append((pair, count))

    def record(self, what: Omission | str, reason: str = "", count: int = 1) -> None:
        """Notes that ``what`` was not done, whether skips are on or not: there was no other way to go."""
        pair = _pair(what, reason)
        self.left_out[pair] = self.left_out.get(pair, 0) + count

    def forget_left_out(self) -> None:
        """Begins a new list."""
        self.left_out.clear()
        self._to_count.clear()

    def count_left_out(self) -> None:
        """Completes the list; what turns out not to have happened is none of it."""
        for pair, count in self._to_count:
            if number := count():
                self.record(*pair, number)
        self._to_count.clear()


def _pair(what: Omission | str, reason: str) -> Reasoned:
    return what.pair if isinstance(what, Omission) else (what, reason)

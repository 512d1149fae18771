"""What a frame did not do, why and how often; and what of it is done all the same, to measure what it saves."""

from __future__ import annotations

from collections.abc import Callable, Collection

Omission = tuple[str, str]
"""What was left out, and the reason."""


class LeavesOut:
    """Keeps the list; the base of sessions.

    Args:
        skips: Whether work that the scene cannot need may be left out at all.
        done_anyway: What is done nevertheless.

    Attributes:
        left_out: How often what was left out of the frame for which reason.
        inherent: What of all that was told with no choice: the method itself does not do it.
    """

    def __init__(self, skips: bool, done_anyway: Collection[Omission] = ()) -> None:
        self.skips, self.done_anyway = skips, frozenset(done_anyway)
        self.left_out: dict[Omission, int] = {}
        self.inherent: set[Omission] = set()
        self._to_count: list[tuple[Omission, Callable[[], int]]] = []

    def may_leave_out(self, what: str, reason: str) -> bool:
        """Whether ``what`` may be left out: for work that finds out itself how much of it."""
        return self.skips and (what, reason) not in self.done_anyway

    def leave_out(self, what: str, reason: str, count: int = 1) -> bool:
        """Records that ``what`` is not needed here and returns True; False, unrecorded, where it is to be done."""
        if not self.may_leave_out(what, reason):
            return False
        self.record(what, reason, count)
        return True

    def count_later(self, what: str, reason: str, count: Callable[[], int]) -> None:
        """Records, if it may be left out, what only an image tells the number of; counted when times are taken."""
        if self.may_leave_out(what, reason):
            self._to_count.append(((what, reason), count))

    def tell(self, what: str, reason: str, count: Callable[[], int] = lambda: 1) -> None:
        """Records, with skips on, what the method itself does not do here; counted when times are taken."""
        if self.skips:
            self.inherent.add((what, reason))
            self._to_count.append(((what, reason), count))

    def record(self, what: str, reason: str, count: int = 1) -> None:
        """Notes that ``what`` was not done, whether skips are on or not: there was no other way to go."""
        self.left_out[what, reason] = self.left_out.get((what, reason), 0) + count

    def forget_left_out(self) -> None:
        """Begins a new list."""
        self.left_out.clear()
        self._to_count.clear()

    def count_left_out(self) -> None:
        """Completes the list; what turns out not to have happened is none of it."""
        for (what, reason), count in self._to_count:
            if number := count():
                self.record(what, reason, number)
        self._to_count.clear()

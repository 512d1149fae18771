"""Two kernels that do the same: one cell by cell, which CUDA runs, and one in lanes, which the CPU runs.

``launch`` takes a twin wherever it takes a kernel, with the plain kernel's inputs and grid, and runs whichever suits
the device. One test watches all twins at work and has both kernels run on the same inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar

import warp as wp

from wkernels.device.lanes import runs_per_row, uses_lanes

Grid = tuple[int, ...]
Observer = Callable[["Twin", Callable[[Sequence[Any]], None], Sequence[Any]], Callable[[], None]]
"""Called with a twin whose lanes are about to run, what runs the plain kernel on given outputs, and the outputs.

What it returns is called when the lanes have run.
"""


def in_runs(grid: Grid) -> Grid:
    """The grid of a kernel that handles a run of the last axis in each cell."""
    return (*grid[:-1], runs_per_row(grid[-1]))


def cell_by_cell(grid: Grid) -> Grid:
    """The grid of a kernel whose cells are the plain kernel's, for lanes within a cell."""
    return grid


@dataclass(frozen=True, eq=False)
class Twin:
    """A plain kernel and one in lanes.

    Attributes:
        plain: The plain kernel.
        lanes: The kernel in lanes.
        inputs: The lanes' inputs, made of the plain ones; the same unless given.
        outputs: Likewise.
        grid: The lanes' grid, made of the plain one.
        fits: Whether lanes can take these plain inputs and outputs; always, unless given.
        compared: Which of the plain outputs must be alike; all, unless given.
        tolerance: Largest difference of what is compared.
        flips: Share of values that may differ by more, where rounding decides a comparison.
        known: All twins there are, by module and name of the plain kernel.
    """

    plain: wp.Kernel
    lanes: wp.Kernel
    inputs: Callable[..., list] | None = None
    outputs: Callable[..., list] | None = None
    grid: Callable[[Grid], Grid] = in_runs
    fits: Callable[..., bool] | None = None
    compared: Callable[..., list] | None = None
    tolerance: float = 0.0
    flips: float = 0.0
    known: ClassVar[dict[str, Twin]] = {}
    _observers: ClassVar[list[Observer]] = []
    name: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", f"{self.plain.module.name}.{self.plain.key}")
        Twin.known[self.name] = self

    def chosen(
        self, grid: Grid, inputs: Sequence[Any], outputs: Sequence[Any], device: str
    ) -> tuple[wp.Kernel, Grid, Sequence[Any], Sequence[Any]]:
        """The kernel for a device, with its grid, inputs and outputs."""
        if not uses_lanes(device) or (self.fits is not None and not self.fits(*inputs, *outputs)):
            return self.plain, grid, inputs, outputs
        made = self.inputs(*inputs) if self.inputs else inputs
        return self.lanes, self.grid(grid), made, self.outputs(*outputs) if self.outputs else outputs

    @property
    def is_watched(self) -> bool:
        """Whether anybody watches."""
        return bool(self._observers)

    @contextmanager
    def observed(self, run_plain: Callable[[Sequence[Any]], None], outputs: Sequence[Any]) -> Iterator[None]:
        """Tells whoever watches that the lanes are about to run, and that they have."""
        finishing = [observer(self, run_plain, outputs) for observer in self._observers]
        yield
        for finish in finishing:
            finish()

    @classmethod
    @contextmanager
    def watched(cls, observer: Observer) -> Iterator[None]:
        """Has ``observer`` called before each run of any twin's lanes, for tests."""
        cls._observers.append(observer)
        try:
            yield
        finally:
            cls._observers.remove(observer)

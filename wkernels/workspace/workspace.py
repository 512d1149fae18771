"""What code below a frame takes of it: where it runs, memory, what is kept, how long it takes, what is left out.

A function of a lower room that says ``work: Workspace`` needs neither scene nor light nor eye; those it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable
from contextlib import AbstractContextManager
from typing import Any

import warp as wp

from wkernels.device.launch import launch
from wkernels.device.timing import PassTimer
from wkernels.device.twin import Twin
from wkernels.workspace.left_out import LeavesOut, Reasoned
from wkernels.workspace.products import Product, Products


class Workspace(LeavesOut):
    """Memory, products and stopwatch of one technique label.

    Args:
        device: Warp device.
        threads: CPU threads; None for all. Never changes a result.
        seed: Shift of all sample sets; 1 is the plain, unshifted set.
        skips: Whether work that the scene cannot need may be left out.
        done_anyway: Pairs (what, reason) of it that are done nevertheless.

    Attributes:
        count: Frames since the last reset.
    """

    def __init__(
        self,
        device: str = "cpu",
        threads: int | None = None,
        seed: int = 1,
        skips: bool = True,
        done_anyway: Collection[Reasoned] = (),
    ) -> None:
        super().__init__(skips, done_anyway)
        self.device, self.threads, self.seed = device, threads, seed
        self.count = 0
        self._timer = PassTimer(device)
        self._products = Products(self.timed, self.leave_out)
        self._buffers: dict[Hashable, wp.array] = {}

    def timed(self, name: str) -> AbstractContextManager[None]:
        """Charges the block to the pass ``name``."""
        return self._timer.timed(name)

    def launch(self, kernel: wp.Kernel | Twin, dim: int | tuple[int, ...], inputs: list, outputs: list) -> None:
        """Launches on this device and its threads; the kernel's first argument is its tile's offset."""
        launch(kernel, dim, inputs, outputs, device=self.device, threads=self.threads)

    def buffer(self, name: str, shape: tuple[int, ...], dtype: type) -> wp.array:
        """Scratch memory that lives as long as the workspace; its content is whatever was left there."""
        key = (name, shape, dtype)
        if key not in self._buffers:
            self._buffers[key] = wp.zeros(shape, dtype=dtype, device=self.device)
        return self._buffers[key]

    def product(self, name: Product | str, key: Hashable, inputs: Hashable, build: Callable[[Any], Any]) -> Any:
        """Anything that outlives a frame while its inputs stay the same.

        Args:
            name: Pass name in the timings; what techniques may declare is a ``Product``.
            key: Identity of the product within the workspace.
            inputs: Everything it depends on, comparable; it is rebuilt when they differ.
            build: Called with the old value (or None), whose memory it may reuse; returns the new one.
        """
        return self._products.pull(name.value if isinstance(name, Product) else name, key, inputs, build)

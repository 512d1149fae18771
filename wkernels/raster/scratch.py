"""Memory that a rasteriser keeps between calls, and where it launches."""

from __future__ import annotations

from dataclasses import dataclass, field

import warp as wp

from wkernels.device.launch import launch


@dataclass
class Scratch:
    """Named arrays on one device, which grow when they must.

    Attributes:
        device: Warp device.
        threads: CPU threads; None for all.
    """

    device: str = "cpu"
    threads: int | None = None
    _arrays: dict[str, wp.array] = field(default_factory=dict, repr=False)

    def array(self, name: str, shape: tuple[int, ...], dtype: type) -> wp.array:
        """Scratch memory, its content undefined: at least one element; exactly ``shape`` where it has two axes."""
        held = self._arrays.get(name)
        fits = held is not None and (held.shape == shape if len(shape) > 1 else held.shape[0] >= shape[0])
        if not fits:
            room = shape if len(shape) > 1 else (max(1, shape[0] + shape[0] // 4),)
            held = self._arrays[name] = wp.empty(room, dtype=dtype, device=self.device)
        assert held is not None
        return held if len(shape) > 1 or held.shape == shape else held[: max(1, shape[0])]

    def launch(
        self, kernel: wp.Kernel, dim: int | tuple[int, ...], inputs: list, outputs: list, tile: int | None = None
    ) -> None:
        """``wkernels.device.launch.launch`` on this device and these threads."""
        launch(kernel, dim, inputs, outputs, device=self.device, threads=self.threads, tile=tile)

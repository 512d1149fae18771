"""Meshes that change their shape: morph targets and skins, or vertices that a file has for every frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np


class Deformation(Protocol):
    """Vertices of a mesh on every frame, in its own space."""

    def __call__(self, frame: int) -> np.ndarray:
        """float64 (V, 3); the first and the last frame are held outside their range."""

    def only(self, used: np.ndarray) -> Deformation:
        """The same of some vertices, by their indices (U,)."""

    @property
    def description(self) -> tuple[np.ndarray, ...]:
        """Arrays that determine the vertices on every frame."""


@dataclass(frozen=True, eq=False)
class Morph:
    """Morph targets, and then a skin: linear blend skinning (glTF 2.0, sections 3.7.2.2 and 3.7.3.3).

    Attributes:
        base: float64 (V, 3).
        offsets: Of the morph targets, (T, V, 3).
        weights: Of the targets on every frame, (n, T).
        joints: Joint indices of every vertex, (V, K); K is 0 without a skin.
        shares: How much each counts, (V, K).
        matrices: Of the joints on every frame, (m, J, 4, 4).
    """

    base: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray
    joints: np.ndarray
    shares: np.ndarray
    matrices: np.ndarray

    def __call__(self, frame: int) -> np.ndarray:
        weights = self.weights[_held(frame, len(self.weights))]
        out = self.base + np.tensordot(weights, self.offsets, axes=1) if len(self.offsets) else self.base.copy()
        if not self.joints.shape[1]:
            return out
        matrices = self.matrices[_held(frame, len(self.matrices)), :, :3]
        blended = np.zeros((len(out), 3, 4))
        for column in range(self.joints.shape[1]):
            blended += self.shares[:, column, None, None] * matrices[self.joints[:, column]]
        skinned: np.ndarray = np.einsum("vij,vj->vi", blended[:, :, :3], out) + blended[:, :, 3]
        return skinned

    def only(self, used: np.ndarray) -> Morph:
        return replace(
            self,
            base=self.base[used],
            offsets=self.offsets[:, used],
            joints=self.joints[used],
            shares=self.shares[used],
        )

    @property
    def description(self) -> tuple[np.ndarray, ...]:
        return self.base, self.offsets, self.weights, self.joints, self.shares, self.matrices


@dataclass(frozen=True, eq=False)
class SampledVertices:
    """Vertices on every frame, float32 or float64 (n, V, 3)."""

    positions: np.ndarray

    def __call__(self, frame: int) -> np.ndarray:
        return np.asarray(self.positions[_held(frame, len(self.positions))], np.float64)

    def only(self, used: np.ndarray) -> SampledVertices:
        return SampledVertices(self.positions[:, used])

    @property
    def description(self) -> tuple[np.ndarray, ...]:
        return (self.positions,)


def _held(frame: int, frames: int) -> int:
    return min(max(int(frame), 0), frames - 1)

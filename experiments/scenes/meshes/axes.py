"""Turns of files whose up axis is not y."""

from __future__ import annotations

import numpy as np

TO_Y_UP = {
    "X": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "Y": np.eye(3),
    "Z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
"""Rotations of a file's axes into ours by its up axis (COLLADA 1.4.1, ``up_axis``; USD has Y and Z)."""

"""The estimators of ``wkernels/sampling/estimators.py`` on shadow tests that are written down, one after the other."""

from __future__ import annotations

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.sampling.estimators import FLOAT32_LIMIT, add_test, hidden_share, share_variance, standard_error


@wp.kernel
def estimate_series(
    first: int,
    tests: wp.array2d(dtype=float),
    limit: float,
    psi_out: wp.array2d(dtype=float),
    variance_out: wp.array2d(dtype=float),
    error_out: wp.array2d(dtype=float),
):
    """Psi, its variance and standard error after each test of a series; a thread per series."""
    row = wp.tid()
    y = first + row
    rho = float(0.0)
    n = float(0.0)
    for i in range(tests.shape[1]):
        sums = add_test(rho, n, tests[y, i], 1.0, limit)
        rho = sums[0]
        n = sums[1]
        psi = hidden_share(rho, n)
        psi_out[y, i] = psi
        variance_out[y, i] = share_variance(psi, n)
        error_out[y, i] = standard_error(psi, n)


def estimates_of(tests: np.ndarray, device: str = "cpu") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Psi, variance and standard error (Scherzer et al. 2009, equations 2 and 3) after each test of several series.

    Args:
        tests: (S, N), 1 where the light sample is hidden, else 0.
        device: Warp device.

    Returns:
        Three float32 (S, N). The variance and standard error of one test are undefined (0 / 0); the first column holds
        the 1 that stands for them in every kernel.
    """
    on_device = wp.array(np.asarray(tests, np.float32), dtype=float, device=device)
    out = [wp.empty_like(on_device) for _ in range(3)]
    launch(estimate_series, (on_device.shape[0],), [on_device, FLOAT32_LIMIT], out, device=device)
    psi, variance, error = (array.numpy() for array in out)
    return psi, variance, error

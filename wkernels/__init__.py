"""Warp building blocks for shadow algorithms: rasterisation, rays, lights, views, sampling. Names no technique.

Importing this package fixes the Warp options that every kernel of the project is compiled with, so it must come before
any module that defines kernels (options set later are silently ignored for modules that exist already).
"""

import ctypes as _ctypes
import os as _os
import sys as _sys

# OpenBLAS keeps its threads spinning after a matrix product, which halves the speed of our own kernels on small
# machines.
if "numpy" not in _sys.modules:
    _os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import warp as _wp

_wp.config.enable_backward = False  # nothing here is differentiated; adjoint code would triple the compile time
_wp.config.max_unroll = 4
_wp.config.log_level = _wp.LOG_WARNING


def _initialise_quietly() -> None:
    """Starts Warp without the line that its native code prints on machines that simply have no CUDA driver."""
    try:
        _ctypes.CDLL("libcuda.so.1")
    except OSError:
        _sys.stderr.flush()
        keep, nowhere = _os.dup(2), _os.open(_os.devnull, _os.O_WRONLY)
        try:
            _os.dup2(nowhere, 2)
            _wp.init()
        finally:
            _os.dup2(keep, 2)
            _os.close(keep)
            _os.close(nowhere)
    else:
        _wp.init()


_initialise_quietly()

__version__ = "0.1.0"

"""Warp building blocks for shadow algorithms: rasterisation, rays, lights, views, sampling. Names no technique.

Importing this package fixes the Warp options that every kernel of the project is compiled with, so it must come before
any module that defines kernels (options set later are silently ignored for modules that exist already).
"""

import atexit as _atexit
import ctypes as _ctypes
import os as _os
import shutil as _shutil
import sys as _sys
import tempfile as _tempfile
import warnings as _warnings

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
            _initialise()
        finally:
            _os.dup2(keep, 2)
            _os.close(keep)
            _os.close(nowhere)
    else:
        _initialise()


def _initialise() -> None:
    """Starts Warp; kernels are kept in a folder of this process alone where the usual one cannot be written to."""
    try:
        _wp.init()
        with _tempfile.TemporaryFile(dir=_wp.config.kernel_cache_dir):
            return
    except OSError as error:
        reason, unusable = error.strerror or str(error), error.filename
    # A name that cannot be foreseen: kernels are native code, not to be loaded from where others may have put some.
    try:
        own = _tempfile.mkdtemp(prefix="wkernels-kernels-")
    except OSError as error:
        from wkernels.errors import InputError

        folders = f"neither the kernel cache ({reason}: '{unusable}') nor a temporary folder"
        raise InputError(f"{folders} can be written to; WARP_CACHE_PATH names another.") from error
    _atexit.register(_shutil.rmtree, own, ignore_errors=True)
    _wp.config.kernel_cache_dir = own
    _wp.init()
    _told.append(
        f"the kernel cache cannot be written to ({reason}: '{_os.path.dirname(unusable or '') or unusable}'); kernels "
        "are compiled anew for this process. WARP_CACHE_PATH names another folder."
    )


_told: list[str] = []
_initialise_quietly()
for _text in _told:  # now that stderr is as it was; on one line, as no line of this file would say more
    _warnings.warn_explicit(_text, UserWarning, "wkernels", 0)

__version__ = "0.1.0"

"""The vocabulary of lane kernels: CPU kernels that handle a run of 16 neighbouring pixels in one grid cell.

``docs/lanes.md`` is the page to read first.
"""

from __future__ import annotations

import warp as wp

LANES = wp.constant(16)  # what a run knows stays in registers; with 64 it is spilt, and pcss takes 1.5 times as long
Floats = wp.types.vector(length=LANES, dtype=wp.float32)
Ints = wp.types.vector(length=LANES, dtype=wp.int32)
Pairs = wp.types.vector(length=2 * LANES, dtype=wp.float32)  # of a run of vec2
Vectors = wp.types.vector(length=3 * LANES, dtype=wp.float32)  # x, y, z of a run of points, one after the other


def runs_per_row(width: int) -> int:
    """Grid cells that a row of ``width`` pixels takes."""
    return -(-width // LANES)


def uses_lanes(device: str) -> bool:
    """Whether lane kernels run on a device: the CPU; CUDA takes the plain ones."""
    return bool(wp.get_device(device).is_cpu)


def flat_floats(values: wp.array) -> wp.array:
    """The components of an array of float32, or of vectors of them, as one row; a view, which must not outlive it."""
    return wp.array(ptr=values.ptr, dtype=float, shape=values.capacity // 4, device="cpu")


def flat_pairs(values: wp.array) -> wp.array:
    """Pairs of float32 components as one row of int64, which is fetched at the cost of one; a view, as above.

    ``first_of`` and ``second_of`` take an entry apart.
    """
    return wp.array(ptr=values.ptr, dtype=wp.int64, shape=values.capacity // 8, device="cpu")


@wp.func
def first_of(pair: wp.int64):
    """The first float of an entry of ``flat_pairs``."""
    return wp.cast(wp.int32(pair), wp.float32)


@wp.func
def second_of(pair: wp.int64):
    """The second float of an entry of ``flat_pairs``."""
    return wp.cast(wp.int32(pair >> wp.int64(32)), wp.float32)


def runs_of(values: wp.array, dtype: type, padding: int = 0) -> wp.array:
    """Overlapping runs of an array: entry i is the 16 elements from the i-th component on, loaded at once.

    An index within a lane loop, ``values[begin + k]``, is a gather, even where the elements lie side by side; a whole
    run costs a quarter of that. A view, which must not outlive the array.

    Args:
        values: Contiguous, on the CPU, components of 4 bytes.
        dtype: ``Floats``, ``Ints``, ``Pairs`` for an array of vec2, or ``Vectors`` for one of vec3, whose entries begin
            at every second or third component; or another vector of components.
        padding: Components of memory behind the last one that may be read. A run that begins less than 16 elements
            before the end needs them.
    """
    entries = max(0, values.capacity // 4 + padding - dtype._length_ + 1)  # type: ignore[attr-defined]
    return wp.array(ptr=values.ptr, dtype=dtype, shape=entries, strides=(4,), device="cpu")


def row_runs(image: wp.array, dtype: type) -> wp.array:
    """Overlapping runs of each row of an image: entry (y, i) is the run from the i-th component of row y on.

    Args:
        image: (H, W) on the CPU, whose rows are dense, components of 4 bytes; a part of a larger one too.
        dtype: As for ``runs_of``, no longer than a row.

    Returns:
        (H, entries); a view, which must not outlive the image. The last entry of a row ends where the row does.
    """
    entries = image.shape[1] * (image.strides[1] // 4) - dtype._length_ + 1  # type: ignore[attr-defined]
    shape, strides = (image.shape[0], entries), (image.strides[0], 4)
    return wp.array(ptr=image.ptr, dtype=dtype, shape=shape, strides=strides, device="cpu")


def in_floats(*values: wp.array) -> list[wp.array]:
    """Arrays as runs of 16 floats each, whatever their type: what lanes make of outputs."""
    return [runs_of(array, Floats) for array in values]


@wp.func
def store_run(values: Floats, x0: int, y: int, image_out: wp.array2d(dtype=float)):
    """Writes a run to the pixels x0, x0 + 1, ... of row y, as far as the row goes."""
    for k in range(wp.min(LANES, image_out.shape[1] - x0)):
        image_out[y, x0 + k] = values[k]

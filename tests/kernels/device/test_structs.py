from __future__ import annotations

import pytest
import warp as wp

from wkernels.device.structs import filled


@wp.struct
class Inner:
    kind: int


@wp.struct
class Outer:
    inner: Inner
    taps: wp.array(dtype=float)


@wp.kernel
def read(first: int, outer: Outer, out: wp.array(dtype=int)):
    out[0] = outer.inner.kind + outer.taps.shape[0]


def test_a_struct_is_made_of_all_its_fields(device: str) -> None:
    """A field that is not given is an error, not 0; None is an array of no elements."""
    taps = wp.zeros(3, dtype=float, device=device)
    for given, expected in ((taps, 8), (None, 5)):
        out = wp.zeros(1, dtype=int, device=device)
        wp.launch(read, 1, [0, filled(Outer, inner=filled(Inner, kind=5), taps=given)], [out], device=device)
        assert out.numpy()[0] == expected
    with pytest.raises(TypeError, match=r"\['taps'\]"):
        filled(Outer, inner=Inner())
    with pytest.raises(TypeError, match=r"\['knd'\]"):
        filled(Outer, inner=Inner(), taps=taps, knd=5)

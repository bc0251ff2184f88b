"""Heights survive their packing."""

import base64
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.pages.page import FINEST, LARGEST, Pack, Packed, pack_terrain


def unpacked(packed: Packed, shape: tuple[int, int]) -> np.ndarray:
    """Do what the page's script does."""
    cells = shape[0] * shape[1]
    folded = packed.deltas[:cells].astype(int) | packed.deltas[cells:].astype(int) << 8
    deltas = (folded >> 1) ^ -(folded & 1)
    heights = packed.base + packed.step * np.cumsum(deltas.reshape(shape), axis=1)
    known = np.unpackbits(packed.known, bitorder="little")[:cells].reshape(shape)
    return np.where(known == 1, heights, np.nan)


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e5))
def test_heights_come_back_to_half_a_step(seed: int, relief: float) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 30)), int(rng.integers(1, 30)))
    heights = relief * rng.standard_normal(shape) - 3.0
    known = rng.random(shape) < rng.random()
    packed = pack_terrain(heights, known)
    back = unpacked(packed, shape)
    assert (np.isnan(back) == ~known).all()
    if known.any():
        assert np.abs(back - heights)[known].max() <= 0.5001 * packed.step + 1e-9 * relief
    assert packed.step >= FINEST
    assert packed.step <= max(FINEST, np.ptp(heights) / LARGEST)


def test_smooth_ground_takes_about_a_byte_a_cell() -> None:
    x, y = np.meshgrid(np.linspace(0, 12, 120), np.linspace(0, 12, 120))
    heights = 0.3 * np.sin(x) * np.cos(0.7 * y)
    pack = Pack()
    pack.add("heights", pack_terrain(heights, heights > -1).deltas)
    assert len(pack.text) < 1.0 * x.size


def test_arrays_begin_where_a_browser_can_read_them() -> None:
    pack = Pack()
    pack.add("one", np.arange(5, dtype=np.uint8))
    pack.add("two", np.array([1.5, np.nan], np.float32))
    raw = zlib.decompress(base64.b64decode(pack.text))
    assert pack.index == [("one", "uint8", 5), ("two", "float32", 8)]
    assert np.frombuffer(raw[8:16], "<f4")[0] == pytest.approx(1.5)

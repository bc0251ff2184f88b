"""Results become bytes and come back the same; damage is noticed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.packing import Damaged, pack, unpack
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Features, Registration

NUMBERS = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(allow_nan=False), st.text()
)
VALUES = st.recursive(
    NUMBERS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.text(max_size=5), inner, max_size=3),
    ),
    max_leaves=8,
)


@given(VALUES)
def test_plain_values_come_back(value: object) -> None:
    assert unpack(pack(value)) == value


@given(arrays(st.sampled_from(["f4", "f8", "u1", "i8", "?", "c8"]), array_shapes(min_side=0)))
def test_arrays_come_back_with_their_type_and_cannot_be_written(array: np.ndarray) -> None:
    made = unpack(pack((1, array)))
    assert isinstance(made, tuple)
    np.testing.assert_array_equal(made[1], array)
    assert made[1].dtype == array.dtype
    assert not made[1].flags.writeable


def test_dataclasses_come_back_with_all_that_is_in_them() -> None:
    params = PipelineParams()
    assert unpack(pack(params)) == params
    registration = Registration(
        SE2(1.0, -2.0, 0.5), np.array([True, False]), np.inf, 3.0, 0.5, 2.5, covariance=np.eye(3)
    )
    made = unpack(pack(registration))
    assert isinstance(made, Registration)
    assert made.T_database_query == registration.T_database_query
    assert made.dissimilarity == np.inf
    assert made.agreement is None
    np.testing.assert_array_equal(made.inliers, [True, False])
    np.testing.assert_array_equal(made.covariance, np.eye(3))


def test_what_is_not_of_this_package_is_not_packed() -> None:
    with pytest.raises(TypeError, match="Generator cannot be packed"):
        pack((1, np.random.default_rng(0)))


def test_bytes_that_name_another_class_are_refused() -> None:
    some = Features(*(np.zeros(shape) for shape in ((0, 2), 0, 0, 0)), np.zeros((0, 4), np.uint8))
    data = pack(some)
    for other in (b"subprocess:Popen....", b"gpgrad_core.se2:abcde", b"gpgrad_core.types:cast"):
        with pytest.raises(Damaged):
            unpack(data.replace(b"gpgrad_core.types:Features"[: len(other)], other))


@given(st.data())
def test_a_changed_or_cut_byte_is_noticed_or_changes_nothing(data: st.DataObject) -> None:
    value = (1.5, "text", np.arange(40.0))
    packed = bytearray(pack(value))
    place = data.draw(st.integers(0, len(packed) - 1))
    if data.draw(st.booleans()):
        packed = packed[:place]
    else:
        packed[place] ^= data.draw(st.integers(1, 255))
    try:
        made = unpack(bytes(packed))
    except Damaged:
        return
    assert isinstance(made, tuple)
    assert made[:2] == value[:2]
    np.testing.assert_array_equal(made[2], value[2])

"""CI checks the shapes in signatures; if that were off, nobody would notice."""

import os

import jaxtyping
import numpy as np
import pytest

from gpgrad_core.params import Bounds
from gpgrad_core.se2 import SE2

pytestmark = pytest.mark.skipif(
    os.environ.get("GPGRAD_THOROUGH") != "1", reason="shapes are checked with GPGRAD_THOROUGH=1"
)


def test_a_wrong_shape_raises() -> None:
    with pytest.raises(jaxtyping.TypeCheckError, match="points"):
        SE2().apply(np.zeros((5, 3)))


def test_a_wrong_type_raises() -> None:
    with pytest.raises(jaxtyping.TypeCheckError, match="points"):
        SE2().apply(np.zeros((5, 2), dtype=np.int64))


def test_a_whole_number_is_a_float() -> None:
    assert Bounds(0, 1, 1).round(0) == 0.0

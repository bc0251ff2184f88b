"""The array types that signatures are written with; shapes are added by jaxtyping."""

from typing import Any, TypeVar

import numpy as np

_Scalar = TypeVar("_Scalar", bound=np.generic)

# Not `numpy.typing.NDArray`: from NumPy 2.5 on it is a `TypeAliasType`, which jaxtyping cannot
# subscript with a shape. Written out, the same type holds with every NumPy from 2.0 on.
NDArray = np.ndarray[tuple[Any, ...], np.dtype[_Scalar]]

Array = NDArray[np.float64]
Singles = NDArray[np.float32]
Floats = NDArray[np.floating]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

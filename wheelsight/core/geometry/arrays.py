"""Array types of the package, and the check of single numbers."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
BoolArray = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]
UInt16Array = NDArray[np.uint16]
UInt64Array = NDArray[np.uint64]


def is_number(value: Any) -> bool:
    """Whether a value is one real number, also of numpy, finite or not. Text and booleans are none."""
    return isinstance(value, Real) and not isinstance(value, bool)

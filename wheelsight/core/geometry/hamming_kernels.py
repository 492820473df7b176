"""Compiled Hamming distance of 256-bit descriptors of four 64-bit words."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import UInt64Array


@intrinsic
def _ctpop(typing_context: Any, word: Any) -> Any:
    """The processor's bit count, which numba lacks."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


count_bits: Any = _ctpop


@kernel
def hamming(a: UInt64Array, b: UInt64Array) -> Any:
    """Number of bits in which two descriptors (4,) differ."""
    bits = count_bits(a[0] ^ b[0]) + count_bits(a[1] ^ b[1]) + count_bits(a[2] ^ b[2]) + count_bits(a[3] ^ b[3])
    return np.int64(bits)

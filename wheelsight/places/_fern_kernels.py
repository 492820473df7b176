"""Compiled comparison of fern codes: in how many ferns two views differ, 16 ferns of 4 bits a word."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import Float32Array, UInt64Array
from wheelsight.geometry.hamming_kernels import count_bits

_ONE, _TWO = np.uint64(1), np.uint64(2)
_LOWEST_OF_FOUR = np.uint64(0x1111111111111111)


@kernel
def likeness(codes: UInt64Array, code: UInt64Array, out: Float32Array) -> Any:
    """Share (N,) of the ferns in which a code (W,) is the same as each of (N, W): 1 less the block Hamming distance."""
    words = len(code)
    for i in range(len(out)):
        differing = np.uint64(0)
        for w in range(words):
            bits = codes[i, w] ^ code[w]
            bits |= bits >> _ONE
            bits |= bits >> _TWO
            differing += count_bits(bits & _LOWEST_OF_FOUR)
        out[i] = 1.0 - np.float32(differing) / np.float32(16 * words)

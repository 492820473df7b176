"""Compiled comparison of fern codes, 16 ferns of 4 bits a word, and the choice of the best rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from wheelsight.compiled import kernel
from wheelsight.geometry.arrays import Float32Array, IntArray, UInt64Array
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


@kernel
def best(scores: Float32Array, chosen: IntArray) -> Any:
    """Write the rows of the largest scores (N,) above 0, the largest first, to (K,); how many there are.

    Of equal ones the earlier comes first.
    """
    found, most = 0, len(chosen)
    for row in range(len(scores)):
        score = scores[row]
        if score <= 0 or (found == most and score <= scores[chosen[most - 1]]):
            continue
        place = min(found, most - 1)
        found = min(found + 1, most)
        while place > 0 and scores[chosen[place - 1]] < score:
            chosen[place] = chosen[place - 1]
            place -= 1
        chosen[place] = row
    return found

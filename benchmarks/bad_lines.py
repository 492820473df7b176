"""Lines as bad as they come: random bytes, and frames with flipped bits, missing frames and repeats."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from wheelsight.io.devices.wire_formats import Counts, FrameDecoder, encode_message

_DAMAGED, _DROPPED, _REPEATED = 0.10, 0.05, 0.05
_MOST_FLIPS = 8
_CHUNK = 4096


@dataclass
class Outcome:
    """What a decoder made of a bad line.

    Attributes:
        damaged: frames of which bits were flipped.
        wrong: messages handed on that were never sent.
        missed: good frames that did not come through, though neither they nor the two before were damaged.
        undamaged: good frames that had to come through.
    """

    decoder: FrameDecoder = field(default_factory=FrameDecoder)
    damaged: int = 0
    wrong: int = 0
    missed: int = 0
    undamaged: int = 0


def decode_noise(byte_count: int, seed: int = 0) -> Outcome:
    """Random bytes; every message out of them is a wrong one."""
    rng = np.random.default_rng(seed)
    outcome = Outcome()
    for start in range(0, byte_count, _CHUNK):
        outcome.wrong += len(outcome.decoder.feed(rng.bytes(min(_CHUNK, byte_count - start))))
    return outcome


def decode_damaged(frame_count: int, seed: int = 0) -> Outcome:
    """Frames of growing counts, a tenth of them with one to eight bits flipped, some missing, some twice."""
    rng = np.random.default_rng(seed)
    outcome, line, due, sound_in_a_row = Outcome(), bytearray(), set[int](), 0
    received: set[int] = set()
    for n, (message, fate) in enumerate(zip(_counts(frame_count), rng.random(frame_count), strict=True)):
        frame = encode_message(message)
        if fate < _DAMAGED:
            line += _flipped(frame, rng)
            outcome.damaged += 1
            sound_in_a_row = 0
        elif fate >= _DAMAGED + _DROPPED:
            line += frame * (2 if fate > 1 - _REPEATED else 1)
            sound_in_a_row += 1
            if sound_in_a_row > 1:
                due.add(n)
        if len(line) > _CHUNK or n == frame_count - 1:
            _take(outcome, bytes(line), received)
            line.clear()
    outcome.undamaged, outcome.missed = len(due), len(due - received)
    return outcome


def _counts(frame_count: int) -> Iterator[Counts]:
    return (Counts(n & 0xFF, n, 3 * n, -2 * n) for n in range(frame_count))


def _flipped(frame: bytes, rng: np.random.Generator) -> bytes:
    flipped = bytearray(frame)
    for bit in rng.choice(8 * len(frame), rng.integers(1, _MOST_FLIPS + 1), replace=False).tolist():
        flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


def _take(outcome: Outcome, line: bytes, received: set[int]) -> None:
    for message in outcome.decoder.feed(line):
        n = message.clock_us if isinstance(message, Counts) else -1
        if isinstance(message, Counts) and message == (n & 0xFF, n, 3 * n, -2 * n):
            received.add(n)
        else:
            outcome.wrong += 1

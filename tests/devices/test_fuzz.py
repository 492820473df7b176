"""No crash, no wrong count beyond the checksum's own rate, and every second frame after damage comes through."""

from __future__ import annotations

import pytest

from benchmarks.bad_lines import decode_damaged, decode_noise

slow = pytest.mark.slow


@pytest.mark.parametrize("byte_count", [300_000, pytest.param(2_000_000, marks=slow)])
def test_random_bytes_become_no_messages(byte_count: int) -> None:
    """A message takes a right length (1 piece in 4000), a known type (1 in 256) and a right checksum (1 in 65 536)."""
    outcome = decode_noise(byte_count)
    assert outcome.wrong == 0
    assert outcome.decoder.statistics.bytes == byte_count


@pytest.mark.parametrize("frame_count", [20_000, pytest.param(200_000, marks=slow)])
def test_damaged_frames_are_refused_and_the_next_but_one_is_read(frame_count: int) -> None:
    outcome = decode_damaged(frame_count)
    assert outcome.damaged > 0.09 * frame_count
    assert outcome.undamaged > 0.6 * frame_count
    assert outcome.missed == 0
    expected = outcome.damaged / 65536
    assert outcome.wrong <= expected + 4 * expected**0.5 + 1

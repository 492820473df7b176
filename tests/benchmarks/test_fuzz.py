"""No input ends in a traceback, without end, in a gigabyte, or in a message longer than a screen.

`python -m benchmarks.fuzz --count 200000` does it for longer, and holds each input to five seconds.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import fuzz
from benchmarks.fuzz_files import targets


def test_every_reader_takes_its_sound_files(tmp_path: Path) -> None:
    for number, target in enumerate(targets()):
        folder = tmp_path / str(number)
        fuzz.write_sound(target, folder)
        target.read(folder)


@pytest.mark.slow
def test_readers_that_fail_hang_die_or_fill_memory_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "LONGEST_S", 4.0)
    outcome = fuzz.fuzz(6, are_controls=True)
    found = [(fault.number, fault.reader, fault.kind) for fault in outcome.faults]
    assert found == [
        (0, "traceback", "traceback"),
        (1, "memory", "memory"),
        (2, "hang", "hang"),
        (3, "end", "traceback"),
    ]
    assert (outcome.read, outcome.refused) == (0, 2)


def test_equal_numbers_make_equal_inputs(tmp_path: Path) -> None:
    target = targets()[0]
    for name in ("one", "other"):
        fuzz.make_input(target, tmp_path / name, seed=3, number=7)
    one, other = (
        {path.relative_to(tmp_path / name): path.read_bytes() for path in (tmp_path / name).rglob("*.png")}
        for name in ("one", "other")
    )
    assert one == other


@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.slow)])
def test_hostile_files_are_read_or_refused(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(fuzz, "LONGEST_S", 60.0)  # on a busy computer it is a hang that takes as long
    outcome = fuzz.fuzz(count, seed=1)
    assert outcome.faults == []
    assert outcome.count == count
    assert min(outcome.read, outcome.refused) > count / 10

"""No input ends in a traceback, a crash, without end, in a gigabyte, or in a message longer than a screen.

`python -m benchmarks.fuzz --inputs 10000` does it for longer, and holds each input to five seconds.
"""

from __future__ import annotations

import bz2
import sys
import zlib
from pathlib import Path
from typing import Any

import lz4.frame
import pytest

from benchmarks import fuzz, fuzz_records
from benchmarks.fuzz_files import controls, targets

READERS = tuple(target.name for target in targets())


def test_every_reader_takes_its_sound_files(tmp_path: Path) -> None:
    for target in targets():
        folder = tmp_path / target.name
        fuzz.write_sound(target, folder)
        target.read(folder)


@pytest.mark.slow
def test_readers_that_fail_hang_crash_or_fill_memory_or_disk_are_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(fuzz, "LONGEST_S", 4.0)
    names = tuple(control.name for control in controls())
    tallies = fuzz.fuzz(fuzz.Plan(names, are_controls=True, keep=tmp_path))
    kinds = {name: [fault.kind for fault in tally.faults] for name, tally in tallies.items()}
    assert kinds == {
        "traceback": ["traceback"],
        "memory": ["memory"],
        "disk": ["disk"],
        "hang": ["time"],
        "crash": ["crash"],
        "end": ["crash"],
        "long_message": [],
        "escape": [],
    }
    assert tallies["long_message"].refused == tallies["escape"].refused == 1
    (crash,) = tallies["crash"].faults
    assert "Segmentation fault" in crash.what
    for tally in tallies.values():
        assert all(fault.kept is not None and fault.kept.is_dir() for fault in tally.faults)


@pytest.mark.slow
def test_an_input_that_was_kept_fails_again_where_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "map-edits" / "0-0"
    target = next(target for target in targets() if target.name == "map-edits")
    fuzz.write_sound(target, folder)
    assert fuzz.main(["--replay", str(folder)]) == 0
    assert "accepted" in capsys.readouterr().out
    assert (folder / "edits.json").exists()


def test_equal_numbers_make_equal_inputs(tmp_path: Path) -> None:
    target = targets()[0]
    for name in ("one", "other"):
        fuzz.make_input(target, tmp_path / name, seed=3, number=7)
    one, other = (
        {path.relative_to(tmp_path / name): path.read_bytes() for path in (tmp_path / name).rglob("*.png")}
        for name in ("one", "other")
    )
    assert one
    assert one == other


def test_each_reader_gets_each_number_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "_BLOCK", 4)
    plan = fuzz.Plan(("a", "b", "c"), inputs=10, begin=5)
    jobs = [plan.at(job) for job in range(plan.count)]
    assert sorted(jobs) == [(reader, number) for reader in "abc" for number in range(5, 15)]
    assert jobs[:5] == [("a", 5), ("a", 6), ("a", 7), ("a", 8), ("b", 5)]


def unpacked(way: str, data: bytes) -> Any:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    ways = {
        "bz2": bz2.decompress,
        "lz4": lz4.frame.decompress,
        "zlib": lambda data: zlib.decompressobj().decompress(data),
    }
    return ways.get(way, zstd.decompress)(data)


@pytest.mark.parametrize("way", ["bz2", "lz4", "zlib", "zstd", "zstd-mute"])
def test_bombs_unpack_to_what_they_say(way: str) -> None:
    packed = fuzz_records.bomb(way, 32)
    assert len(packed) < 200_000
    found = unpacked(way, packed)
    assert not found.strip(b"\0")
    assert len(found) == pytest.approx(32 << 20, rel=0.25 if way == "bz2" else 0)  # whole blocks of bz2


QUICK = (
    "tum",
    "wheels",
    "rosbag1",
    "mcap",
    "scannet",
    "calibration",
    "trajectory",
    "ticks",
    "named-poses",
    "telemetry",
)


@pytest.mark.parametrize("name", QUICK)
def test_some_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    target = next(target for target in targets() if target.name == name)
    for number in range(3):
        fuzz.make_input(target, tmp_path / str(number), 5, number)
        _, fault = fuzz.answer(target, tmp_path / str(number))
        assert fault is None


@pytest.mark.slow
@pytest.mark.parametrize(("readers", "count"), [((), 8), (("oni",), 4)], ids=["all", "oni"])
def test_damaged_files_are_read_or_refused(
    readers: tuple[str, ...], count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a minute on one free core; each .oni file needs a process of its own, so there are fewer of them."""
    monkeypatch.setattr(fuzz, "LONGEST_S", 60.0)  # on a busy computer it is a hang that takes as long
    chosen = tuple(name for name in READERS if (name in readers if readers else name != "oni"))
    tallies = fuzz.fuzz(fuzz.Plan(chosen, inputs=count, seed=1))
    assert [fault for tally in tallies.values() for fault in tally.faults] == []
    assert {name: tally.count for name, tally in tallies.items()} == dict.fromkeys(chosen, count)
    accepted, refused = (sum(getattr(tally, name) for tally in tallies.values()) for name in ("accepted", "refused"))
    assert min(accepted, refused) >= count * len(chosen) / 10

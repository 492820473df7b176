from __future__ import annotations

import errno
import struct
import zlib
from pathlib import Path

import pytest
from full_disk import FullDisk
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.errors import MapError, OutputError
from wheelsight.slam.maps.journal import FIRST_RECORD, HEAD_BYTES, VERSION, JournalWriter, read_journal, read_record

CONTENTS = (b"first", b"", b"\xf5WSR" * 9, bytes(range(256)))
SIZES = [HEAD_BYTES + len(content) for content in CONTENTS]
BORDERS = [FIRST_RECORD + sum(SIZES[:k]) for k in range(len(SIZES) + 1)]


def written(path: Path) -> bytes:
    journal = JournalWriter(path)
    for key, content in enumerate(CONTENTS):
        journal.append(7, key, content)
    journal.close()
    return path.read_bytes()


def keys_in(path: Path) -> list[int]:
    return [record.key for record, _ in read_journal(path).records]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("journal") / "a.journal"
    written(path)
    return path


def test_what_was_appended_is_read_in_its_order(whole: Path) -> None:
    found = read_journal(whole)
    assert [(record.kind, record.key, bytes(content)) for record, content in found.records] == [
        (7, key, content) for key, content in enumerate(CONTENTS)
    ]
    assert [record.offset for record, _ in found.records] == BORDERS[:-1]
    assert (found.damages, found.torn_bytes) == ((), 0)
    assert all(read_record(whole, record) == CONTENTS[record.key] for record, _ in found.records)


@given(cut=st.integers(0, BORDERS[-1]))
def test_a_torn_end_is_dropped_and_counted(whole: Path, cut: int) -> None:
    path = whole.with_name("cut.journal")
    path.write_bytes(whole.read_bytes()[:cut])
    found = read_journal(path)
    kept = sum(border <= cut for border in BORDERS[1:])
    assert [record.key for record, _ in found.records] == list(range(kept))
    assert found.torn_bytes == (cut if cut < FIRST_RECORD else cut - BORDERS[kept])
    assert found.damages == ()


def test_every_border_loses_nothing_before_it(whole: Path) -> None:
    path = whole.with_name("border.journal")
    for count, border in enumerate(BORDERS):
        path.write_bytes(whole.read_bytes()[:border])
        found = read_journal(path)
        assert (len(found.records), found.torn_bytes) == (count, 0)


@given(at=st.integers(0, BORDERS[-1] - 1), bit=st.integers(0, 7))
def test_a_flipped_bit_costs_one_record_and_is_reported(whole: Path, at: int, bit: int) -> None:
    path = whole.with_name("flipped.journal")
    data = bytearray(whole.read_bytes())
    data[at] ^= 1 << bit
    path.write_bytes(data)
    hit = sum(border <= at for border in BORDERS) - 1  # -1: the head of the file
    found = read_journal(path)
    assert [record.key for record, _ in found.records] == [key for key in range(len(CONTENTS)) if key != hit]
    if hit == len(CONTENTS) - 1:  # nothing whole behind it: it may as well be torn
        assert (found.damages, found.torn_bytes) == ((), SIZES[hit])
    else:
        begin, length = (0, FIRST_RECORD) if hit < 0 else (BORDERS[hit], SIZES[hit])
        assert [(damage.offset, damage.length) for damage in found.damages] == [(begin, length)]
        assert found.torn_bytes == 0


def test_what_is_damaged_after_it_was_opened_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    data = bytearray(written(path))
    record, _ = read_journal(path).records[3]
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(MapError, match=rf"a\.journal: its record at byte {BORDERS[3]} is damaged"):
        read_record(path, record)
    path.unlink()
    with pytest.raises(MapError, match="cannot be read: No such file"):
        read_record(path, record)


def test_a_newer_version_and_what_is_no_journal_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    journal = written(path)
    head = struct.pack("<8sI", b"WSJOURNL", VERSION + 1)
    path.write_bytes(head + struct.pack("<I", zlib.crc32(head)) + journal[FIRST_RECORD:])
    with pytest.raises(MapError, match=f"is of version {VERSION + 1}, newer than {VERSION}"):
        read_journal(path)
    path.write_bytes(b"some text that is longer than a head\n")
    with pytest.raises(MapError, match="is no journal of a map"):
        read_journal(path)


def test_nothing_is_overwritten_and_a_full_disk_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.journal"
    written(path)
    with pytest.raises(OutputError):
        JournalWriter(path)
    FullDisk("b.journal", BORDERS[2] + 5).take_over(monkeypatch)
    journal = JournalWriter(tmp_path / "b.journal")
    journal.append(7, 0, CONTENTS[0])
    journal.append(7, 1, CONTENTS[1])
    with pytest.raises(OutputError, match="no space left on the disk") as reported:
        journal.append(7, 2, CONTENTS[2])
    assert isinstance(reported.value.__cause__, OSError)
    assert reported.value.__cause__.errno == errno.ENOSPC
    journal.close()
    found = read_journal(tmp_path / "b.journal")
    assert ([record.key for record, _ in found.records], found.torn_bytes) == ([0, 1], 5)


def test_what_was_appended_is_in_the_file_before_it_is_flushed(tmp_path: Path) -> None:
    journal = JournalWriter(tmp_path / "a.journal")
    journal.append(1, 2, b"content")
    assert keys_in(tmp_path / "a.journal") == [2]
    journal.close()
    assert (tmp_path / "a.journal").stat().st_size == FIRST_RECORD + HEAD_BYTES + 7


def test_sound_heads_of_overlapping_records_are_not_all_gone_through(tmp_path: Path) -> None:
    """Each names nearly all of the file as its content: to checksum them all would take the square of their number."""
    heads, apart, path = 200, 10_000, tmp_path / "a.journal"
    data = bytearray(written(path)[:FIRST_RECORD])
    for number in range(heads):
        head = struct.pack("<4sHHQII", b"\xf5WSR", 6, 0, number, (heads - number - 1) * apart + 100, 1)
        data += (head + struct.pack("<I", zlib.crc32(head))).ljust(apart, b"\0")
    path.write_bytes(data)
    with pytest.raises(MapError, match="is damaged in more places than a disk damages"):
        read_journal(path)


def test_marks_alone_are_not_all_gone_through(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    path.write_bytes(written(path)[:FIRST_RECORD] + b"\xf5WSR" * 50_000)
    with pytest.raises(MapError, match="is damaged in more places than a disk damages"):
        read_journal(path)


def test_more_records_than_a_writer_leaves_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "a.journal")
    monkeypatch.setattr("wheelsight.slam.maps.journal._MOST_RECORDS", len(CONTENTS) - 1)
    with pytest.raises(MapError, match="holds more than 3 records"):
        read_journal(tmp_path / "a.journal")

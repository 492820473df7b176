from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings.tables import keep_growing, read_file_list, read_lines


@dataclass
class Stamped:
    stamp_s: float


def write(folder, text, name="rgb.txt"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_comments_blank_lines_windows_line_ends_and_byte_order_mark_are_no_lines(tmp_path):
    path = write(
        tmp_path, b"\xef\xbb\xbf# color images\r\n\r\n1.0 rgb/1.png # the first\r\n   # indented\r\n2.0\trgb/2.png\r\n"
    )
    files, warnings = read_file_list(path)
    assert [(file.stamp_s, file.path) for file in files] == [
        (1.0, tmp_path / "rgb/1.png"),
        (2.0, tmp_path / "rgb/2.png"),
    ]
    assert warnings == []
    assert [line.number for line in read_lines(path)] == [3, 5]


def test_names_may_hold_spaces_and_number_signs(tmp_path):
    files, _ = read_file_list(write(tmp_path, "1.0 my images/no#1.png\n"))
    assert files[0].path == tmp_path / "my images/no#1.png"


@pytest.mark.parametrize(
    ("text", "where", "problem"),
    [
        ("# nothing\n", "", "lists no images"),
        ("", "", "lists no images"),
        ("1.0 a.png\nnoon b.png\n", ":2", "'noon' is not a stamp"),
        ("nan a.png\n", ":1", "'nan' is not a stamp"),
        ("# x\n1.0\n", ":2", "a stamp and a file are expected"),
        (b"\xff\xfe\x00 1", "", "is not a text file"),
    ],
)
def test_says_where_a_list_is_wrong(tmp_path, text, where, problem):
    path = write(tmp_path, text)
    with pytest.raises(RecordingError, match=re.escape(f"{path}{where}: {problem}")):
        read_file_list(path)


def test_a_missing_list_is_named(tmp_path):
    with pytest.raises(RecordingError, match=re.escape(f"{tmp_path / 'rgb.txt'}: is missing")):
        read_file_list(tmp_path / "rgb.txt")


@pytest.mark.parametrize(("stamps", "line"), [("1 2 2 3", 3), ("1 3 2 4 5", 2), ("3 2 1", 1), ("1 9 2 3", 2)])
def test_a_short_list_out_of_order_is_refused_at_its_first_line(tmp_path, stamps, line):
    path = write(tmp_path, "".join(f"{stamp} {i}.png\n" for i, stamp in enumerate(stamps.split())))
    with pytest.raises(RecordingError, match=rf"rgb.txt:{line}: .*out of order \(sort the lines"):
        read_file_list(path)


@pytest.mark.parametrize("bad", [50.0, 50.5 - 40, 5000.0])
def test_in_a_long_list_a_bad_stamp_costs_only_its_own_line(tmp_path, bad):
    stamps = [float(i) for i in range(200)]
    stamps.insert(52, bad)
    path = write(tmp_path, "# comment\n" + "".join(f"{stamp} {i}.png\n" for i, stamp in enumerate(stamps)))
    files, (warning,) = read_file_list(path)
    assert [file.stamp_s for file in files] == [float(i) for i in range(200)]
    assert warning.startswith("rgb.txt:5")
    assert "1 of 201 lines" in warning


@pytest.mark.parametrize("by_s", [0.5, 3.0, 86400.0])
def test_a_clock_that_was_set_back_is_reported_where_it_was(tmp_path, by_s):
    """Sorting would mix what was before with what came after; a bad stamp before it is not where."""
    stamps = [1e5 + 0.1 * i - (by_s if i >= 60 else 0.0) for i in range(100)]
    stamps[20] += 0.95
    path = write(tmp_path, "".join(f"{stamp:.3f} {i}.png\n" for i, stamp in enumerate(stamps)))
    reported = (
        rf"rgb.txt:61: stamp {stamps[60]:.6f} is {by_s - 0.1:.3g} s earlier .*: a clock was set back \(cut the file"
    )
    with pytest.raises(RecordingError, match=reported.replace("+", r"\+")):
        read_file_list(path)


def test_lines_that_lie_about_are_of_no_clock(tmp_path, rng):
    stamps = rng.permutation(100)
    path = write(tmp_path, "".join(f"{stamp} {i}.png\n" for i, stamp in enumerate(stamps)))
    with pytest.raises(RecordingError, match=r"out of order \(sort the lines"):
        read_file_list(path)


@given(st.lists(st.integers(0, 8), max_size=9))
def test_keeps_as_many_as_can_grow(stamps):
    stamps = [*range(-2000, 0), *stamps]
    kept, _ = keep_growing([Stamped(float(s)) for s in stamps], range(len(stamps)), Path("rgb.txt"))
    values = [item.stamp_s for item in kept]
    assert values == sorted(set(values))
    tail = stamps[2000:]
    longest = [0] * (len(tail) + 1)
    for i, stamp in enumerate(tail):
        longest[i] = 1 + max((longest[j] for j in range(i) if tail[j] < stamp), default=0)
    assert len(kept) == 2000 + max(longest)

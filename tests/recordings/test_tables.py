"""Tables as people's programs write them: what is unambiguous is read, and the rest refused with the fix."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from wheelsight.core.errors import RecordingError
from wheelsight.io.recordings.native import read_wheels

SOUND = "stamp_s,left,right\n0.0,1,2\n0.1,3,4\n0.2,5,-6\n"
READINGS = [(0.0, 1, 2), (0.1, 3, 4), (0.2, 5, -6)]


def read(folder: Path, text: str | bytes) -> tuple[list[tuple[float, int, int]], list[str]]:
    path = folder / "wheels.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    ticks, warnings = read_wheels(path)
    return [(reading.stamp_s, reading.left, reading.right) for reading in ticks], warnings


@pytest.mark.parametrize(
    "text",
    [
        SOUND + "\n\n",
        SOUND + "  \n\t",
        SOUND + "# the end",
        SOUND.replace(",", " , "),
        SOUND.replace("stamp_s,left", "Stamp_S,LEFT"),
        f"# {SOUND}",
        f"#{SOUND}",
        f"# robot 7\n\n{SOUND}",
        SOUND.replace(",", ";"),
        SOUND.replace(",", ";").replace(".", ","),
        SOUND.replace(",", "\t"),
        SOUND.replace(",", " "),
        SOUND.replace("\n", ",\n"),
        SOUND.replace("\n", "\r\n"),
        SOUND.replace("\n", "\r"),
        re.sub(r"[^,\n]+", r'"\g<0>"', SOUND),
        SOUND.replace("right\n", "right,note\n")
        .replace("2\n", "2,a word\n")
        .replace("4\n", "4,\n")
        .replace("6\n", "6,x\n"),
        SOUND.replace("4\n", "4.0\n"),
        SOUND.replace("stamp_s", "time [s]"),
        "timestamp_ns,left,right\n0,1,2\n100000000,3,4\n200000000,5,-6\n",
        "# Stamp (ms);left;right\n0;1;2\n100;3;4\n200;5;-6\n",
        "time [ms] left right\n0 1 2\n100 3 4\n200.0 5 -6.0\n",
        "left,right,t_us,note\n1,2,0,x\n3,4,100000,\n5,-6,200000,y\n",
        SOUND.encode("utf-16"),
        SOUND.encode("utf-8-sig"),
    ],
)
def test_tables_of_all_dialects_are_read(tmp_path: Path, text: str | bytes) -> None:
    assert read(tmp_path, text) == (READINGS, [])


@pytest.mark.parametrize("text", [SOUND[:-1], SOUND[:-1].encode("utf-16"), SOUND.replace("\n", "\r\n")[:-2]])
def test_a_last_line_that_does_not_end_is_left_out(tmp_path: Path, text: str | bytes) -> None:
    assert read(tmp_path, text) == (READINGS[:2], ["wheels.csv:4: the last line is cut off and was left out"])


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (
            SOUND.replace(".", ","),
            ":2: 4 values where 3 are expected (decimal commas need semicolons between the columns)",
        ),
        (SOUND.replace("3,4", "3"), ":3: 2 values where 3 are expected (correct or remove the line)"),
        (SOUND.replace("3,4", "3,"), ":3: right is '', not a whole number (correct or remove the line)"),
        (SOUND.replace("3,4", "3.5,4"), ":3: left is '3.5', not a whole number"),
        (SOUND.replace("3,4", "1" + "0" * 100 + ",4"), ":3: left is '1000"),
        (SOUND.replace("3,4", "nan,4"), ":3: left is 'nan', not a whole number"),
        (SOUND.replace("0.1", "1e100"), ":3: '1e100' is not a stamp in seconds"),
        (SOUND.replace("right", "left"), ":1: has no column right (the first line must name the columns stamp_s,"),
        (SOUND.replace("right\n", "right,left\n"), ":1: has column 'left' twice (name each once)"),
        ("\n".join(SOUND.splitlines()[1:]), ":1: has no column stamp_s"),
        ("", ":1: has no column stamp_s"),
        (SOUND.replace("stamp_s", "timestamp"), ":1: has no column stamp_s"),
        ("stamp_ms,stamp_ns,left,right\n0,0,1,2\n", ":1: has no column stamp_s"),
    ],
)
def test_the_rest_is_refused_with_the_fix(tmp_path: Path, text: str, reported: str) -> None:
    with pytest.raises(RecordingError, match=re.escape(f"{tmp_path / 'wheels.csv'}{reported}")):
        read(tmp_path, text)


@pytest.mark.slow
def test_many_readings_lose_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    """Read in pieces: none is lost between them."""
    count = 400_000
    left = np.cumsum(rng.integers(-3, 9, count)) + 2**53  # beyond what a float holds
    stamps_s = 1.7e9 + 0.001 * np.arange(count)
    rows = "".join(f"{s:.4f},{a},{i}\n" for i, (s, a) in enumerate(zip(stamps_s, left.tolist(), strict=True)))
    (tmp_path / "wheels.csv").write_text(f"stamp_s,left,right\n{rows}")
    ticks, warnings = read_wheels(tmp_path / "wheels.csv")
    assert warnings == []
    assert [reading.left for reading in ticks] == left.tolist()
    assert [reading.right for reading in ticks] == list(range(count))
    assert [reading.stamp_s for reading in ticks] == [float(f"{s:.4f}") for s in stamps_s]


def test_plain_and_odd_tables_name_the_same_line(tmp_path: Path) -> None:
    """Out of order by a few: the warning's line is right in both ways of reading."""
    lines = [f"{0.01 * i:.2f},{i},{i}" for i in range(1000)]
    lines[700] = "0.01,1,1"
    for odd in ("", "# the robot\n"):
        _, warnings = read(tmp_path, "stamp_s,left,right\n" + "\n".join(lines) + "\n" + odd)
        (warning,) = warnings
        assert warning.startswith("wheels.csv:702: stamp 0.010000 repeats another or is out of order; 1 of 1000 lines")

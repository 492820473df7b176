"""The progress line: at any width its numbers are whole."""

from __future__ import annotations

import re

import pytest

from wheelsight.cli._progress import FrameProgress


@pytest.mark.parametrize("columns", [80, 100, 160])
def test_numbers_are_whole_at_any_width(
    columns: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", str(columns))
    with FrameProgress("tracking", 25_000, unit="events") as progress:
        for _ in range(3):
            progress.reach(12_345, 25_000, "tracking · 1.23M surfels, 412k given up for want of room")
    lines = [re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line) for line in re.split(r"[\r\n]+", capfd.readouterr().err)]
    drawn = [line for line in lines if "12345/25000" in line]
    assert drawn
    for line in drawn:
        assert len(line.rstrip()) <= columns
        assert line.count("━") + line.count("╸") + line.count("╺") >= 10
        assert "tracking · 1.23M" in line
        assert re.search(r"(\d+:\d\d|--:--)", line)
    assert "\n\n" not in "".join(drawn)

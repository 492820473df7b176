"""A section takes its own place again, and what was measured once is kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.kept_records import KeptRecords
from benchmarks.navigation_page import sections_of, write_section
from benchmarks.table import Sheet
from wheelsight.core.errors import InputError


def sheet(figure: str) -> Sheet:
    return Sheet("Figures", ("what", "figure"), (("speed", figure),))


def test_a_section_that_is_measured_again_leaves_the_others(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    for title, figure in (("One", "1"), ("Two", "2"), ("One", "3")):
        write_section(page, title, "What it is.", {"Date": "today"}, [sheet(figure)])
    text = page.read_text(encoding="utf-8")
    assert list(sections_of(text)) == ["", "One", "Two"]
    assert "| speed | 3 |" in sections_of(text)["One"]
    assert "| speed | 2 |" in sections_of(text)["Two"]
    assert "| speed | 1 |" not in text
    assert text.startswith("# Navigation\n")
    before = text
    write_section(page, "Two", "What it is.", {"Date": "today"}, [sheet("2")])
    assert page.read_text(encoding="utf-8") == before


def test_what_is_kept_is_not_taken_for_what_was_measured_otherwise(tmp_path: Path) -> None:
    kept = KeptRecords(tmp_path / "kept", {"rate_hz": 10.0})
    assert kept.of("world-1") is None
    kept.keep("world-1", {"score": 0.25})
    assert kept.of("world-1") == {"score": 0.25}
    assert kept.of("world-2") is None
    with pytest.raises(InputError, match="measured otherwise"):
        KeptRecords(tmp_path / "kept", {"rate_hz": 5.0}).of("world-1")
    (tmp_path / "kept" / "old.json").write_text('{"measured_with": {"rate_hz": 10.0}, "score": 1}')
    with pytest.raises(InputError, match="measured otherwise"):
        kept.of("old")
    KeptRecords(None, {}).keep("world-1", {})
    assert KeptRecords(None, {}).of("world-1") is None

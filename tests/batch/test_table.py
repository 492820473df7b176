"""The table: median and worst over seeds; written, read back, and held against another."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from batch_jobs import FIGURES

from wheelsight.core.errors import ConfigError
from wheelsight_batch import BatchRow, Case, Outcome, Spread, compare, read_rows
from wheelsight_batch.batches import KeptOutcomes
from wheelsight_batch.table import csv_text, markdown_text, rows_of

CASES = (
    Case("a | b", "dense", "joined", ("1", "2", "3")),
    Case("blind", "dense", "dense", ("4",)),
    Case("broken", "dense", problem='no such file, "here"'),
    Case("half", "dense", "dense", ("5", "6")),
)
OUTCOMES = {
    "1": Outcome("1", figures=FIGURES | {"ate_m": 0.3, "tracked": 0.9}),
    "2": Outcome("2", figures=FIGURES | {"ate_m": 0.1, "tracked": 0.8}),
    "3": Outcome("3", figures=FIGURES | {"ate_m": 0.2, "tracked": 1.0}),
    "4": Outcome("4", figures=FIGURES | {"ate_m": None, "rpe_m": None, "rpe_deg": None}),
    "5": Outcome("5", "killed", is_killed=True),
    "6": Outcome("6", figures=FIGURES),
}
ROWS = rows_of(CASES, OUTCOMES)


def test_rows_have_the_median_and_the_worst() -> None:
    first, blind, broken, half = ROWS
    assert first.figures["ate_m"] == Spread(0.2, 0.3)
    assert first.figures["tracked"] == Spread(0.9, 0.8)
    assert (first.seeds, first.status, first.problem) == (3, "ok", "")
    assert "ate_m" not in blind.figures
    assert blind.figures["tracked"] == Spread(1.0, 1.0)
    assert blind.status == "ok"
    assert (broken.status, broken.seeds, broken.figures) == ("broken", 0, {})
    assert (half.status, half.seeds, half.problem) == ("1 of 2 broken", 1, "killed")


def test_a_table_is_read_back_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(csv_text(ROWS))
    assert read_rows(tmp_path / "table.csv") == ROWS


def test_a_page_shows_the_worst_of_several_and_each_reason() -> None:
    head, _, first, blind, *rest = markdown_text(ROWS).splitlines()
    assert head.count("|") == 12
    assert "| a \\| b | dense | joined | 3 | 0.2000 (0.3000) |" in first
    assert "| 90.0 (80.0) |" in first
    assert blind.startswith("| blind | dense | dense | 1 | – | – | – | 100.0 | 2.00 | 300 | ok |")
    assert '- broken, dense: no such file, "here"' in rest


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("a,b\n1,2\n", "is no table of a batch"),
        ("", "is no table of a batch"),
        (csv_text(ROWS).replace("0.3", "zero", 1), ":2: holds no numbers"),
        (csv_text(ROWS).replace("0.3", "nan", 1), ":2: holds no numbers"),
        (csv_text(ROWS).replace("0.3", "1e300", 1), ":2: holds no numbers"),
    ],
)
def test_what_is_no_table_is_refused(text: str, reported: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(ConfigError, match=reported):
        read_rows(tmp_path / "table.csv")


def test_a_table_that_is_missing_or_binary_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_rows(tmp_path / "none.csv")
    (tmp_path / "table.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="is not a text file"):
        read_rows(tmp_path / "table.csv")


def test_a_table_that_is_no_ordinary_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zeros.csv").symlink_to("/dev/zero")
    for name, problem in (("pipe.csv", "is a pipe"), ("zeros.csv", "is a device")):
        with pytest.raises(ConfigError, match=problem):
            read_rows(tmp_path / name)


def row(**figures: float | Spread) -> BatchRow:
    spreads = {name: value if isinstance(value, Spread) else Spread(value, value) for name, value in figures.items()}
    return BatchRow("drive", "dense", "dense", 3, "ok", "", spreads)


def worse(now: BatchRow, before: BatchRow, tolerance: float = 0.1, cost: float | None = None) -> tuple[str, ...]:
    return compare([now], [before], tolerance, cost).worse


def test_what_is_worse_by_more_than_is_allowed_is_named() -> None:
    assert worse(row(ate_m=0.109), row(ate_m=0.1)) == ()
    assert worse(row(ate_m=0.111), row(ate_m=0.1)) == ("drive, dense: ATE, m median 0.1110, was 0.1000",)
    assert worse(row(ate_m=0.05), row(ate_m=0.1)) == ()
    assert worse(row(ate_m=Spread(0.1, 0.3)), row(ate_m=Spread(0.1, 0.2))) == (
        "drive, dense: ATE, m worst 0.3000, was 0.2000",
    )
    assert worse(row(tracked=0.95), row(tracked=1.0)) == ()
    assert worse(row(tracked=0.89), row(tracked=1.0)) == ("drive, dense: posed, % median 89.0, was 100.0",)
    assert len(worse(row(tracked=0.5, ate_m=2.0), row(tracked=1.0, ate_m=1.0))) == 2


def test_what_is_too_small_to_count_does_not() -> None:
    assert worse(row(ate_m=9e-5), row(ate_m=1e-9)) == ()
    assert worse(row(ate_m=2e-4), row(ate_m=1e-9)) != ()
    assert worse(row(tracked=0.996), row(tracked=1.0), tolerance=0.0) == ()


def test_time_and_memory_are_judged_where_that_is_asked_for() -> None:
    now, before = row(frame_ms=30.0, memory_mb=100.0), row(frame_ms=10.0, memory_mb=100.0)
    assert worse(now, before) == ()
    assert worse(now, before, cost=0.5) == ("drive, dense: ms median 30.00, was 10.00",)


def test_what_is_gone_is_worse_and_what_is_new_or_missing_is_reported() -> None:
    assert worse(row(), row(ate_m=0.1)) == ("drive, dense: no ATE, m any more",)
    broken = replace(row(), seeds=0, status="broken")
    assert worse(broken, row(ate_m=0.1)) == ("drive, dense: broken",)
    assert worse(broken, broken) == ()
    found = compare([row(), replace(row(), config="new")], [row(), replace(row(), recording="old")], 0.1)
    assert found.unmatched == ("drive, new: not in the baseline", "old, dense: in the baseline alone")
    assert found.compared == 1


@pytest.mark.parametrize(
    "text",
    [
        '{"a": ' * 20_000,
        '{"version": 1, "outcome": {"job": "1", "figures": [1]}}',
        '{"version": 1, "outcome": {"job": "1", "figures": {"ate_m": "x"}}}',
        '{"version": 1, "outcome": 5}',
        "[]",
    ],
)
def test_a_kept_outcome_that_is_none_is_run_again(text: str, tmp_path: Path) -> None:
    kept = KeptOutcomes(tmp_path)
    (tmp_path / "jobs" / "1.json").write_text(text)
    os.mkfifo(tmp_path / "jobs" / "2.json")
    (tmp_path / "jobs" / "3.json").write_text('{"version": 1, "outcome": {"job": "3", "figures": {"ate_m": 0.5}}}')
    assert {job: found.figures for job, found in kept.found(["1", "2", "3"]).items()} == {"3": {"ate_m": 0.5}}

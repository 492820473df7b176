"""Targets, tables and the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks import contenders, machine
from benchmarks.__main__ import main
from benchmarks.contenders import Contender, open3d_odometry, opencv_odometry, wheelsight_dense, wheelsight_features
from benchmarks.published import judge_published
from benchmarks.run import Figures, Result
from benchmarks.sequences import Accuracy
from benchmarks.startup import Startup
from benchmarks.table import document, problems_of, results_sheets, targets_sheet
from benchmarks.targets import Target, judge, judge_startup

STARTUP = Startup(bare_s=0.02, import_s=0.1, help_s=0.7)


def result(contender: Contender, ate_m: float | None, median_ms: float, differing: int = 0) -> Result:
    figures = Figures(Accuracy(ate_m), 10, 9, median_ms, 2 * median_ms, median_ms, median_ms, 480.0, differing)
    return Result(contender, "floor", figures)


OURS = wheelsight_features.KEYFRAMES
RESULTS = [
    result(OURS, 0.026, 13.0, differing=3),
    result(opencv_odometry.RGB_DEPTH, 0.06, 50.0),
    result(open3d_odometry.HYBRID, 0.09, 30.0),
    result(open3d_odometry.REGISTERED, 0.04, 30.0),
]


def verdicts(results: list[Result]) -> dict[str, str]:
    return {target.what: target.verdict for target in (*judge(results), *judge_startup(STARTUP))}


def test_targets_are_met_or_missed_by_how_much() -> None:
    assert verdicts(RESULTS) == {
        "floor: ATE, half of the better peer's": "met",
        "floor: ATE, the same with depth registered for the peers": "missed by 0.0060 m (30 %)",
        "floor: median time a frame": "missed by 1.0 ms (8 %)",
        "floor: median time, 0.3 of OpenCV's": "met",
        "floor: peak memory": "met",
        "floor: poses that differ between two runs": "missed by 3 poses",
        "`import wheelsight`, beyond bare Python": "met",
        "`wheelsight --help`": "missed by 0.200 s (40 %)",
    }


def test_without_peers_their_targets_are_not_measured() -> None:
    alone = verdicts([result(OURS, 0.026, 11.0)])
    assert alone["floor: ATE, half of the better peer's"] == "not measured"
    assert alone["floor: median time, 0.3 of OpenCV's"] == "not measured"
    assert alone["floor: median time a frame"] == "met"


def test_a_subject_that_failed_meets_nothing() -> None:
    failed = [Result(OURS, "floor", problem="ImportError: no"), *RESULTS[1:]]
    assert {verdict for what, verdict in verdicts(failed).items() if what.startswith("floor")} == {"not measured"}


def test_a_limit_reached_exactly_is_met() -> None:
    assert Target("time", 12.0, 12.0, "ms").is_met
    assert Target("time", 12.0, None, "ms").is_met is None


def test_a_limit_from_below_reads_right() -> None:
    quick, slow = (Target("decode", 5.0, rate, "MB/s", 1, is_least=True) for rate in (7.0, 4.0))
    assert quick.verdict == "met"
    assert slow.verdict == "missed by 1.0 MB/s (20 %)"
    assert targets_sheet([slow]).rows == (("decode", "at least 5.0 MB/s", "4.0 MB/s", "missed by 1.0 MB/s (20 %)"),)
    assert targets_sheet([Target("time", 12.0, 1.0, "ms")]).rows[0][1] == "at most 12.0 ms"


def test_the_document_holds_every_figure_and_no_path_of_this_machine() -> None:
    results = [*RESULTS, Result(wheelsight_features.PREVIOUS, "floor", problem="MemoryError: a | b")]
    sheets = [targets_sheet(judge(results)), *results_sheets(results)]
    text = document(sheets, machine.description(), "python -m benchmarks", contenders.ALL, problems_of(results))
    assert "| OpenCV Odometry RGB_DEPTH | 0.0600 | — | — | 90.0 | 50.0 | 100.0 | 50.0 | 480 | yes |" in text
    assert "wheelsight features (previous) failed on floor: MemoryError: a | b" in text
    assert str(Path.cwd()) not in text
    assert all(f"- {contender.name}: " in text for contender in contenders.ALL)
    rows = [line for line in text.splitlines() if line.startswith("| ") and "features" in line]
    assert {row.count("|") for row in rows} == {11}


def test_every_row_is_as_wide_as_its_header() -> None:
    for sheet in (targets_sheet(judge(RESULTS)), *results_sheets(RESULTS)):
        assert {len(row) for row in sheet.rows} == {len(sheet.header)}
        console = Console(width=200, record=True, quiet=True)
        console.print(sheet.to_rich())


@pytest.mark.slow
def test_the_command_measures_prints_and_keeps(
    bench_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "peers.md"
    assert main(["--data", str(bench_data), "--frames", "5", "--only", "opencv", "--out", str(out)]) == 0
    text = out.read_text()
    assert 'python -m benchmarks --frames 5 --only "opencv" --out peers.md' in text
    assert "| OpenCV Odometry RGB_DEPTH |" in text
    assert "Side by side: room" in text
    assert str(bench_data) not in text
    assert "OpenCV Odometry, depth registered |" not in text  # the room's depth is registered


@pytest.mark.parametrize(
    "words",
    [
        ["--only", "nobody"],
        ["--only", "opencv", "--data", "no/such/folder"],
        ["--frames", "0"],
        ["--out", "no/such/folder/peers.md"],
        ["--data", "no/such/folder"],
    ],
)
def test_bad_arguments_are_refused_in_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(words)
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    assert code == 2
    assert words[-2] in capsys.readouterr().err


def test_a_part_alone_needs_no_recordings(tmp_path: Path) -> None:
    out = tmp_path / "peers.md"
    assert main(["--data", str(tmp_path), "--only", "start-up", "--out", str(out)]) == 0
    text = out.read_text()
    assert "| `wheelsight --help` | at most 0.500 s |" in text
    assert "## Start-up" in text
    assert "Contenders" not in text
    assert "The serial link" not in text


def test_published_systems_stand_beside_ours_marked_as_such() -> None:
    whole = [replace(found, sequence="rgbd_dataset_freiburg1_desk") for found in RESULTS]
    (sheet,) = results_sheets(whole)
    rows = {row[0]: row[1:] for row in sheet.rows}
    assert {len(row) for row in sheet.rows} == {len(sheet.header)}
    (name,) = (name for name in rows if name.startswith("ORB-SLAM2"))
    assert "(published: " in name
    assert rows[name] == ("0.0160", *("—",) * 8)
    assert len(rows) == len(RESULTS) + 4
    assert len(results_sheets(RESULTS)[0].rows) == len(RESULTS)


def test_each_of_ours_is_held_against_what_is_published() -> None:
    dense = result(wheelsight_dense.KEYFRAMES, 0.015, 9.0)
    assert judge_published([*RESULTS, dense]) == []  # of a part of a recording nothing is published
    whole = [replace(found, sequence="freiburg1_desk") for found in (*RESULTS, dense)]
    assert {target.what.removeprefix("freiburg1_desk: "): target.verdict for target in judge_published(whole)} == {
        "wheelsight features (keyframes), poses": "missed by 1 poses (10 %)",
        "wheelsight features (keyframes), ATE": "missed by 0.0060 m (30 %)",
        "wheelsight features (keyframes), median time, 0.2 of OpenCV's": "missed by 3.0 ms (30 %)",
        "wheelsight dense (keyframes), poses": "missed by 1 poses (10 %)",
        "wheelsight dense (keyframes), ATE": "met",
        "wheelsight dense (keyframes), median time, 0.2 of OpenCV's": "met",
        "ATE of the best of ours": "met",
    }

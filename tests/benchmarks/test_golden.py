"""Hashes of results: equal for equal work, and a change of one number is found and named."""

from __future__ import annotations

import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks import golden
from benchmarks.golden import Length, Result
from wheelsight import Trajectory, WheelsightError

TRAJECTORY = Trajectory(np.arange(3.0), np.stack([np.eye(4)] * 3), body="base")
BEFORE = Result({"poses": 3, "ate_m": 0.01}, {"poses": golden.pose_rows(TRAJECTORY), "status": ["0.0,tracking"]})


def same(before: dict[str, Result], now: dict[str, Result], kept: Path | None = None) -> tuple[bool, str]:
    """Whether nothing differs, and what is printed."""
    printed = StringIO()
    hashed = {name: result.to_dict() for name, result in before.items()}
    return golden.is_same(hashed, now, kept, Console(file=printed, width=180)), printed.getvalue()


def test_a_pose_that_differs_in_its_last_bit_differs() -> None:
    T = TRAJECTORY.T_frame_body.copy()
    T[1, 0, 3] = np.nextafter(T[1, 0, 3], 1.0)
    moved = Result(
        BEFORE.figures, {**BEFORE.tables, "poses": golden.pose_rows(Trajectory(np.arange(3.0), T, body="base"))}
    )
    assert same({"a": BEFORE}, {"a": BEFORE})[0]
    is_same, printed = same({"a": BEFORE}, {"a": moved})
    assert not is_same
    assert "poses: differs" in printed


def test_the_first_row_that_differs_is_named_where_rows_were_kept(tmp_path: Path) -> None:
    golden.keep({"a/b": BEFORE}, tmp_path)
    now = Result({"poses": 2, "ate_m": 0.01}, {"poses": BEFORE.tables["poses"][:-1], "status": ["0.0,coasting"]})
    is_same, printed = same({"a/b": BEFORE}, {"a/b": now}, tmp_path)
    assert not is_same
    assert "row 0, word 0: 0.0,tracking is 0.0,coasting now" in printed
    assert "row 3" in printed
    assert "poses: 3 is 2 now" in printed
    (tmp_path / "a/b/status.txt").write_text("of another day", encoding="utf-8")
    assert "status: differs" in same({"a/b": BEFORE}, {"a/b": now}, tmp_path)[1]


def test_results_that_are_missing_or_new_differ() -> None:
    less = Result(BEFORE.figures, {"poses": BEFORE.tables["poses"]})
    assert "is not made any more" in same({"a": BEFORE, "b": BEFORE}, {"a": BEFORE})[1]
    assert "was not made then" in same({"a": BEFORE}, {"a": BEFORE, "b": BEFORE})[1]
    assert "status: is not made any more" in same({"a": BEFORE}, {"a": less})[1]
    assert "status: was not made then" in same({"a": less}, {"a": BEFORE})[1]


def test_figures_are_without_times_and_sentences() -> None:
    figures = {"seconds": 1.5, "timing": {"median": 2}, "tone": "green", "text": "Said so.", "x": [1, 0.1, None, True]}
    assert list(golden.figure_rows(figures)) == ["tone 'green'", "x.0 1", "x.1 0.1", "x.2 None", "x.3 True"]
    said, otherwise = {"too few points": 2, "poor": 1}, {"few points": 2, "a bad fit": 1}
    assert list(golden.figure_rows(said)) == list(golden.figure_rows(otherwise)) == ["0 1", "1 2"]


def test_a_status_is_without_its_time_and_a_reason_without_its_words(tmp_path: Path) -> None:
    header = "stamp_s,status,reason,matches,inliers,time_ms,flags,note,dropped\n"
    (tmp_path / "a.csv").write_text(header + "0.1,failing,too few,1,2,3.5,slip,so,0\n0.2,lost,gap,1,2,3,,,0\n")
    (tmp_path / "b.csv").write_text(header + "0.1,failing,not enough,1,2,9.5,slip,,0\n0.2,lost,a gap,1,2,3,,,0\n")
    rows = golden.status_rows(tmp_path / "a.csv")
    assert rows == golden.status_rows(tmp_path / "b.csv") == ["0.1,failing,0,1,2,slip,0", "0.2,lost,1,1,2,,0"]


def test_what_a_command_says_is_said_where_it_fails() -> None:
    with pytest.raises(WheelsightError, match="nowhere"):
        golden.command("info", "nowhere")


@pytest.mark.slow
def test_the_same_tree_gives_the_same_results_and_a_change_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One drive of 3 s, simulated and followed twice; then by a file in which one number was changed."""
    monkeypatch.setattr(golden, "QUICK", Length("quick", 3.0, 0.5, (46, 52)))
    monkeypatch.setattr(golden, "DRIVES", {"flat": golden.DRIVES["flat"]})
    file, kept = tmp_path / "golden.json", tmp_path / "kept"
    asked = ["--quick", "--only", "drives", "--golden", str(file), "--keep", str(kept)]
    with pytest.raises(WheelsightError, match="has no quick results"):
        golden.main(asked)
    assert golden.main(["--write", *asked]) == 0
    written = json.loads(file.read_text(encoding="utf-8"))
    tracks = {name.split("/")[-1] for name in written["quick"]}
    assert tracks == {"recording", "wheels", "dense", "joined", "features"}
    assert {"poses", "status", "figures", "surfels", "occupancy"} <= set(
        written["quick"]["drives/flat/joined"]["sha256"]
    )
    assert golden.main(asked) == 0
    assert "5 of 5 results are the same, 0 differ" in capsys.readouterr().out

    path = kept / "quick/drives/flat/dense/poses.txt"
    rows = path.read_text(encoding="utf-8").split("\n")
    rows[5] = rows[5].replace(" ", " 9", 1)
    path.write_text("\n".join(rows), encoding="utf-8")
    written["quick"]["drives/flat/dense"]["sha256"]["poses"] = golden.hash_of(path.read_bytes())
    file.write_text(json.dumps(written), encoding="utf-8")
    assert golden.main(asked) == 1
    printed = capsys.readouterr().out
    assert "poses: row 5, word 1" in printed
    assert "4 of 5 results are the same, 1 differ" in printed

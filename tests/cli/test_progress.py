"""Progress on a terminal of 60 and of 80 columns: count, rate and time left are whole, and nothing wraps."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from cli.test_drive_view import CHAIR, STILL
from cli.test_record_camera import LINK, LOOK
from pseudo_terminal import Screen, terminal
from sessions.seen_maps import RING, aside, write_seen

from wheelsight.app.cli import app
from wheelsight.app.cli.drive_view import DriveView
from wheelsight.app.cli.progress import FrameProgress, left_text
from wheelsight.app.cli.record import shown_looks
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import NavigationState, Navigator, StaticLayer, Transition
from wheelsight_batch import Done, Outcome
from wheelsight_batch.progress import BatchProgress
from wheelsight_calibration.cli_camera import camera_progress

PLANNING, DRIVING = NavigationState.PLANNING, NavigationState.DRIVING
COLUMNS = pytest.mark.parametrize("columns", [60, 80])
LEFT = r"(\d+:)+\d\d left"


def drawn(screen: Screen, columns: int, holds: str) -> str:
    """The last line that holds something, once it is known that none is longer than the terminal is wide."""
    lines = screen.lines()
    assert max(map(len, lines)) <= columns, lines
    return next(line for line in reversed(lines) if holds in line)


def typed(columns: int, monkeypatch: pytest.MonkeyPatch, *words: object) -> Screen:
    """What a command draws."""
    with terminal(columns, monkeypatch) as screen:
        app([str(word) for word in words], standalone_mode=False)
    return screen


@COLUMNS
@pytest.mark.parametrize(
    ("action", "unit", "done", "total", "status"),
    [
        ("tracking", "events", 12_345, 25_000, "joined tracking · 1.23M surfels, 412k given up for want of room"),
        ("tracking", "readings", 1_234_567, 2_000_000, "tracking"),
        ("driving", "simulated s", 123, 3600, ""),
        ("rendering", "frames", 12_345, 25_000, ""),
        ("rebuilding", "keyframes", 1_234, 2_000, "surfels"),
        ("merging", "keyframes", 1_234, 2_000, "recognising"),
        ("searching boards", "frames", 12, 40, ""),
    ],
)
def test_numbers_are_whole_at_any_width(
    columns: int, action: str, unit: str, done: int, total: int, status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rich.console.monotonic", count(1000).__next__)
    with terminal(columns, monkeypatch) as screen, FrameProgress(action, None, unit=unit) as progress:
        for share in range(5):
            progress.reach(done - 4 + share, total, status)
    line = drawn(screen, columns, f"{done}/{total}")
    assert line.startswith(f"{action} ")
    assert re.search(rf" {done}/{total} +\d+(\.\d)? {unit}/s +{LEFT}", line)
    assert line.count("━") + line.count("╸") + line.count("╺") >= 2
    assert status[:3] in line


def test_what_has_no_end_shows_no_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal(80, monkeypatch) as screen, FrameProgress("tracking", None) as progress:
        progress.advance("lost")
    line = drawn(screen, 80, "tracking")
    assert "left" not in line
    assert re.search(r" 1 +lost", line)


def test_a_rate_that_is_reported_stands_in_place_of_the_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal(60, monkeypatch) as screen, FrameProgress("tracking", 1800, unit="") as progress:
        progress.reach(12_345, 18_000, "joined tracking · 31 ms late, 12 dropped", "29.8 frames/s")
    assert re.search(rf"12345/18000 +29.8 frames/s +({LEFT}|-:-- left)", drawn(screen, 60, "12345"))


@pytest.mark.parametrize(
    ("seconds", "reported"), [(None, "-:-- left"), (0.2, "0:00 left"), (71.6, "1:12 left"), (3723, "1:02:03 left")]
)
def test_time_left(seconds: float | None, reported: str) -> None:
    assert left_text(seconds) == reported


@COLUMNS
def test_a_batch(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [1000.0]
    monkeypatch.setattr("wheelsight_batch.progress.time.monotonic", lambda: now_s[0])
    with terminal(columns, monkeypatch) as screen, BatchProgress() as progress:
        progress.show(Done(1000, 2000, 0, 100, None, None))
        now_s[0] += 60
        progress.show(Done(1001, 2000, 25, 100, Outcome("a", "broke"), None))
    line = drawn(screen, columns, "1001/2000 jobs")
    assert "1.0 jobs/min" in line
    assert "3:00 left" in line
    assert "1 br" in line


@COLUMNS
@pytest.mark.parametrize(("seconds", "time"), [(None, "12:05"), (1200, r"12:05(/| of )20:00")])
def test_a_recording(columns: int, seconds: float | None, time: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal(columns, monkeypatch) as screen, shown_looks(seconds) as show:
        show(replace(LOOK, link=LINK))
    line = drawn(screen, columns, "21000")
    assert re.search(rf"{time} .*21000 fr(ames,)? 30(\.0)?/s .*50 wh/s .*52 min", line)


@COLUMNS
def test_views_of_a_board(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal(columns, monkeypatch) as screen, camera_progress() as (show, _):
        show("12 views · show the board at the lower left, tilted to the right, at about 0.8 m · it moves")
    assert "12 views · show the board" in drawn(screen, columns, "12 views")


def navigator() -> Navigator:
    """As much of one as is shown: floor of 6 m by 4 m."""
    kind = np.full((80, 120), CellKind.FREE, np.uint8)
    floor = StaticLayer.of(OccupancyGrid.of_kinds(kind, np.zeros(kind.shape, bool), 0.05, (-2.0, -2.0)))
    senses = SimpleNamespace(local=lambda: None, floor=SimpleNamespace(layer=floor))
    return cast(Navigator, SimpleNamespace(senses=senses))


@COLUMNS
def test_an_exploration(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Plan and facts fit the screen; how long it has taken, how fast that goes, and how long to the next view."""
    now_s = [100.0]
    monkeypatch.setattr("wheelsight.app.cli.drive_view.time.monotonic", lambda: now_s[0])
    with terminal(columns, monkeypatch) as screen, DriveView(CHAIR) as view:
        for second in range(3):
            now_s[0] += 2.0
            doing = "looking at unseen floor from the next place"
            view.note(Transition(10.0, PLANNING, DRIVING, "it has a plan to where much of the floor is to be seen"))
            view.show(replace(STILL, stamp_s=10.0 + second, doing=doing), navigator())
    assert drawn(screen, columns, "so far").rstrip().endswith("0:02, 1.0 m, 24 m² seen")
    last = "\n".join(screen.lines()[-24:])
    for reported in ("looking at unseen", "0.3 times real time", "3.4 m, 0:07 left", "lets it drive", "it has a plan"):
        assert reported in last


@pytest.mark.slow
@COLUMNS
def test_a_run(columns: int, room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = typed(columns, monkeypatch, "run", room, "--odometry", "features", "--out", tmp_path / "out")
    assert re.search(rf"tracking [━╸╺ ]+10/10 .*/s +({LEFT}|-:-- left)", drawn(screen, 1000, "10/10"))
    assert max(len(line) for line in screen.lines() if line.startswith("tracking")) <= columns


@pytest.mark.slow
@COLUMNS
def test_a_simulation(columns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("simulate", "square", "--duration", "2", "--rate", "4", "--size", "64x48", "--out", tmp_path / "out")
    screen = typed(columns, monkeypatch, *words)
    for action in ("driving", "rendering"):
        lines = [line for line in screen.lines() if line.startswith(action)]
        assert lines
        assert max(map(len, lines)) <= columns


@pytest.mark.slow
@COLUMNS
def test_maps_that_are_made(columns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_seen(tmp_path / "monday", RING[:4])
    write_seen(tmp_path / "tuesday", [aside(T, 0.03) for T in RING[:5]], begin_s=100.0)
    made: list[tuple[Any, ...]] = [
        ("rebuilding", "rebuild", tmp_path / "monday"),
        ("merging", "merge", tmp_path / "monday", tmp_path / "tuesday"),
    ]
    for action, *words in made:
        screen = typed(columns, monkeypatch, "map", *words, "--out", tmp_path / action)
        lines = [line for line in screen.lines() if line.startswith(action)]
        assert any(re.search(r"\d+/\d+ .*left", line) for line in lines), lines
        assert max(map(len, lines)) <= columns

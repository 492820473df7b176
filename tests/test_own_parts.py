"""The page about parts of a user's own: its blocks run, one after the other, and come to the true way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documentation_blocks import python_blocks

from wheelsight import EventSource
from wheelsight.core.robots import Robot
from wheelsight.vision.visual_odometry import OwnOdometry

# How far the robot of the page drives along x, metres.
WAY_M = 0.6


@pytest.mark.slow
def test_what_the_page_of_own_parts_shows_runs(
    project_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    blocks = [block for _, block in python_blocks(project_folder / "docs" / "api" / "own-parts.md")]
    assert len(blocks) == 11
    # A Protocol's example is a page; the robot's camera, which is drawn here, is beside it.
    assert max(len(block.strip().splitlines()) for block in blocks[1:]) <= 31
    for block in blocks[:3]:
        exec(compile(block, "own-parts.md", "exec"), names)
    T_map_base = np.eye(4)
    T_map_base[0, 3] = WAY_M
    np.testing.assert_allclose(names["estimate"].T_map_body, T_map_base, atol=0.005)
    assert names["localizer"].warnings == ()
    assert isinstance(names["MyRobot"](names["calibration"], []), EventSource)
    record = names["record"]
    assert (record.odometry, len(record.frames)) == ("joined", 31)
    np.testing.assert_allclose(record.estimate.T_frame_body[-1], T_map_base, atol=0.005)
    assert (tmp_path / "results" / "joined" / "trajectory.txt").is_file()
    np.testing.assert_allclose(names["answer"].T_odom_body, T_map_base, atol=0.005)
    assert names["answer"].status == "tracking"
    assert "3.00 s: x = 0.600 m, tracking" in capsys.readouterr().out
    for block in blocks[3:6]:
        exec(compile(block, "own-parts.md", "exec"), names)
    assert isinstance(names["localizer"].odometry, OwnOdometry)
    np.testing.assert_allclose(names["estimates"][-1].T_map_body, T_map_base, atol=0.06)  # three times what it states
    np.testing.assert_allclose(names["joined"].estimate.T_frame_body[-1], T_map_base, atol=0.01)
    assert (names["joined"].odometry, len(names["joined"].frames)) == ("joined", 31)
    assert (names["looped"].odometry, len(names["looped"].frames)) == ("joined", 31)
    assert list(names["detector"].codes) == list(range(len(names["detector"].codes)))
    assert len(names["detector"].codes) > 1
    for block in blocks[6:8]:
        exec(compile(block, "own-parts.md", "exec"), names)
    assert isinstance(names["DrawnRobot"](), Robot)
    for block in blocks[8:]:
        exec(compile(block, "own-parts.md", "exec"), names)
        assert names["reached"].has_arrived, names["reached"].detail
        assert names["reached"].way_m == pytest.approx(2.0, abs=0.12)
        assert names["reached"].goal_change == ""


def test_the_source_of_the_page_leaves_frames_out_where_they_are_not_wanted(project_folder: Path) -> None:
    names: dict[str, Any] = {"calibration": None, "events": []}
    _, block, *_ = (block for _, block in python_blocks(project_folder / "docs" / "api" / "own-parts.md"))
    exec(compile(block.partition("record = ")[0], "own-parts.md", "exec"), names)
    frame = names["RgbdFrame"](0.0, np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32))
    source = names["MyRobot"](None, [frame])
    assert (list(source.events()), list(source.events(images=False))) == ([frame], [])

"""Recordings in formats of other people, through the commands a user types."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from other_formats import (
    make_bonn,
    make_eth3d,
    make_icl_nuim,
    make_redwood,
    make_replica,
    make_scannet,
    make_three_d_match,
)
from typer.testing import Result

from wheelsight.core.trajectory import Trajectory, read_tum

Command = Callable[..., Result]
FRAMES = 4
MAKERS: dict[str, Callable[[Path, int], Trajectory]] = {
    "bonn": make_bonn,
    "eth3d": make_eth3d,
    "icl_nuim": make_icl_nuim,
    "replica": make_replica,
    "scannet": make_scannet,
    "three_d_match": make_three_d_match,
    "redwood": make_redwood,
}


@pytest.mark.parametrize("name", MAKERS)
def test_info_and_run_work_on_it(wheelsight: Command, tmp_path: Path, name: str) -> None:
    path = tmp_path / {"scannet": "recording.sens", "bonn": "rgbd_bonn_box"}.get(name, "recording")
    truth = MAKERS[name](path, FRAMES)
    reported = wheelsight("info", path)
    assert reported.exit_code == 0, reported.output
    assert name in reported.stdout
    result = wheelsight("run", path, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    found = read_tum(tmp_path / "out" / "trajectory.txt")
    assert len(found) == len(truth) == FRAMES


def test_info_on_an_unknown_folder_lists_the_formats(refusal: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing\n")
    reported = refusal("info", tmp_path)
    for name in MAKERS:
        assert f" {name}" in reported
    assert "docs/recordings.md" in reported

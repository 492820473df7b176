"""What `wheelsight drive` says at its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rehearsed_drive import recorded, rehearsed_drive

from wheelsight.cli._drive_results import tell
from wheelsight.pipeline.drive_outputs import drive_dict
from wheelsight.pipeline.drives import Goal
from wheelsight.report.drive_page import verdict


def test_periods_that_came_late_are_told_where_they_are_many(capsys: pytest.CaptureFixture[str]) -> None:
    drive, _, config = rehearsed_drive()
    drive.go_to(Goal.of(np.array([-0.7, -0.4, np.nan]), "there"), lambda feedback: None)
    record = recorded(drive, config)
    tell(record)
    assert "longer than they should" not in capsys.readouterr().err
    late = replace(record, rows=replace(record.rows, stamps_s=2 * record.rows.stamps_s))
    tell(late)
    told, count = " ".join(capsys.readouterr().err.split()), len(record.rows) - 1
    assert f"{count:,} of {count:,} periods of the control loop took longer than they should, 100 ms at most" in told


@pytest.mark.parametrize(("start", "recognised", "is_told"), [(True, 0, True), (True, 3, False), (False, 0, False)])
def test_a_start_that_nothing_bears_out_is_told(
    start: bool, recognised: int, is_told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, _, config = rehearsed_drive()
    drive.go_to(Goal.of(np.array([-0.7, -0.4, np.nan]), "there"), lambda feedback: None)
    record = recorded(drive, config)
    assert record.recognised is None
    said = {"x_m": 1.0, "y_m": 0.0, "yaw_deg": 0.0} if start else None
    known = {**record.config, "known_map": {**record.config["known_map"], "start": said}}
    found = replace(record, config=known, recognised=recognised)
    tell(found)
    told = " ".join(capsys.readouterr().err.split())
    assert ("nothing of the map was recognised" in told) is is_told
    assert ("Nothing of the map was recognised" in verdict(found)[1]) is is_told
    assert drive_dict(found)["recognised"] == recognised

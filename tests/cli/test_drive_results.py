"""What `wheelsight drive` says at its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rehearsed_drive import recorded, rehearsed_drive

from wheelsight.cli._drive_results import tell
from wheelsight.pipeline.drives import Goal


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

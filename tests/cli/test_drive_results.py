"""What `wheelsight drive` says at its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import typer
from rehearsed_drive import recorded, rehearsed_drive

from wheelsight.app.cli.drive import print_results
from wheelsight.app.run.drives import NamedGoal
from wheelsight.core.errors import MapError
from wheelsight_report import drive_dict
from wheelsight_report.drive_page import verdict


def test_periods_that_came_late_are_reported_where_they_are_many(capsys: pytest.CaptureFixture[str]) -> None:
    drive, _, config = rehearsed_drive()
    drive.go_to(NamedGoal.of(np.array([-0.7, -0.4, np.nan]), "there"), lambda feedback: None)
    record = recorded(drive, config)
    print_results(record)
    assert "longer than they should" not in capsys.readouterr().err
    late = replace(record, rows=replace(record.rows, stamps_s=2 * record.rows.stamps_s))
    print_results(late)
    reported, count = " ".join(capsys.readouterr().err.split()), len(record.rows) - 1
    assert (
        f"{count:,} of {count:,} periods of the control loop took longer than they should, 100 ms at most" in reported
    )


@pytest.mark.parametrize(("start", "recognised", "is_reported"), [(True, 0, True), (True, 3, False), (False, 0, False)])
def test_a_start_that_nothing_bears_out_is_reported(
    start: bool, recognised: int, is_reported: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, _, config = rehearsed_drive()
    drive.go_to(NamedGoal.of(np.array([-0.7, -0.4, np.nan]), "there"), lambda feedback: None)
    record = recorded(drive, config)
    assert record.recognised is None
    said = {"x_m": 1.0, "y_m": 0.0, "yaw_deg": 0.0} if start else None
    known = {**record.config, "known_map": {**record.config["known_map"], "start": said}}
    found = replace(record, config=known, recognised=recognised)
    print_results(found)
    reported = " ".join(capsys.readouterr().err.split())
    assert ("nothing of the map was recognised" in reported) is is_reported
    assert ("Nothing of the map was recognised" in verdict(found)[1]) is is_reported
    assert drive_dict(found)["recognised"] == recognised


def test_a_warning_about_a_sensor_is_in_the_results_and_on_the_page() -> None:
    drive, _, config = rehearsed_drive()
    drive.go_to(NamedGoal.of(np.array([-0.7, -0.4, np.nan]), "there"), lambda feedback: None)
    record = replace(recorded(drive, config), warnings=("the left wheel was left out",))
    assert drive_dict(record)["warnings"] == ["the left wheel was left out"]
    assert "Warning: the left wheel was left out." in verdict(record)[1]
    assert verdict(record)[2] == "amber"


def touching(*contacts: tuple[float, str, bool]) -> dict[str, object]:
    """What a simulator says of a drive."""
    named = [{"stamp_s": stamp_s, "with": name, "by_the_robot": is_by} for stamp_s, name, is_by in contacts]
    return {"clearance_m": 0.0 if contacts else 0.2, "contacts": named}


@pytest.mark.parametrize("count", [1, 2, 9])
def test_a_drive_that_touched_something_has_no_good_end(count: int, capsys: pytest.CaptureFixture[str]) -> None:
    drive, _, config = rehearsed_drive()
    drive.go_to(NamedGoal.of(np.array([-0.7, -0.4, np.nan]), "there"), lambda feedback: None)
    arrived = recorded(drive, config)
    print_results(replace(arrived, truth=touching((3.0, "person_1", False))))  # who walked into the robot
    assert "drove against" not in capsys.readouterr().err
    assert verdict(arrived)[0] == "Arrived"
    record = replace(arrived, truth=touching(*((2.5 + k, f"sofa_{k}", True) for k in range(count))))
    with pytest.raises(typer.Exit) as ended:
        print_results(record)
    assert ended.value.exit_code == 1
    said = capsys.readouterr()
    last = said.err.strip().splitlines()[-1]
    times = "once" if count == 1 else f"{count} times"
    assert last.startswith(f"error: the robot drove against something {times}: sofa_0 at 2.5 s")
    assert ("and 4 more" in last) is (count == 9)
    assert "arrived at there" in said.out
    phrase, why, tone = verdict(record)
    assert (phrase, tone) == (f"Arrived, with {count} collision{'s' * (count > 1)}", "red")
    assert "sofa_0 at 2.5 s" in why


def test_a_goal_that_the_map_has_no_room_for_is_refused_before_anything_moves() -> None:
    drive, robot, _ = rehearsed_drive()
    there, far = NamedGoal.of((-0.7, -0.4)), NamedGoal.of((50.0, 0.0, 0.0), "kitchen")
    with pytest.raises(MapError, match="kitchen: the goal is outside the map: "):
        drive.refuse([there, far])
    drive.refuse([there])
    assert robot.now_s == 0.0

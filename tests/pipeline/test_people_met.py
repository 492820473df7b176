"""Who was known to walk near the robot is kept of a drive: when, where, and how far from its outline."""

from __future__ import annotations

import numpy as np
import pytest
from rehearsed_drive import recorded, rehearsed_drive

from wheelsight.app.run.drives import NamedGoal
from wheelsight.navigation.perception import Person


def test_a_person_beside_the_robot_is_kept_with_his_distance(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, _, config = rehearsed_drive()
    away = Person(np.array([-1.0, 1.5]), np.array([0.3, 0.0]), np.eye(4), 0.3)
    upon = Person(np.array([-1.0, -0.4]), np.array([0.3, 0.0]), np.eye(4), 0.3)
    monkeypatch.setattr(drive.navigator.senses, "people", lambda now_s: (away, upon) if 1.0 < now_s < 2.0 else ())
    drive.go_to(NamedGoal.of(np.array([-0.7, -0.4, np.nan]), "the middle"), lambda feedback: None)
    people = recorded(drive, config).people
    assert people[:, 0].min() > 1.0
    assert people[:, 0].max() < 2.0
    first = people[people[:, 2] == 1.5]
    # From y = 1.5 m to a side 0.3 m beside y = -0.4 m, by a circle of 0.3 m.
    assert first[0, 3] == pytest.approx(1.5 - (-0.4 + 0.3) - 0.3, abs=0.02)
    assert (people[people[:, 2] == -0.4][:, 3] == 0).all()


def test_of_a_drive_that_met_no_one_there_are_none() -> None:
    drive, _, config = rehearsed_drive()
    drive.go_to(NamedGoal.of(np.array([-0.7, -0.4, np.nan]), "the middle"), lambda feedback: None)
    assert recorded(drive, config).people.shape == (0, 4)

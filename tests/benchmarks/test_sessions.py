from __future__ import annotations

from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest

from benchmarks import session_maps, session_starts, sessions
from benchmarks.kept_records import KeptRecords
from benchmarks.session_kidnaps import Kidnapping
from benchmarks.session_starts import ALONE, JOINED, FirstDay, Start
from wheelsight.core.errors import InputError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory

FOUND = Start("flat", ALONE, 4.0, 1.5, 0.03, 0.4, 0.02, 0.3, 0.05, 0.6, (100.0, 200.0))
NOT_FOUND = Start("flat", JOINED, 8.0, None, nan, nan, nan, nan, nan, nan, ())


def test_a_place_is_wrong_by_where_it_was_first_reported() -> None:
    assert not FOUND.is_wrong
    assert replace(FOUND, first_m=0.6).is_wrong
    assert replace(FOUND, first_deg=11.0).is_wrong
    assert not NOT_FOUND.is_wrong


def test_who_is_found_late_or_wrongly_is_not_found_in_time() -> None:
    assert FOUND.is_found_within(5.0)
    assert not FOUND.is_found_within(1.0)
    assert not replace(FOUND, first_m=0.6).is_found_within(5.0)
    assert not NOT_FOUND.is_found_within(5.0)


def test_tables_and_targets_count_starts() -> None:
    starts = [FOUND, replace(FOUND, first_m=2.0), NOT_FOUND]
    alone, joined = sessions.own_sheet(starts).rows
    assert alone[:5] == ("flat, camera alone", "2", "1", "2", "1")
    assert joined[:5] == ("flat, joined", "1", "0", "0", "0")
    share, metres, degrees, wrong, elsewhere, unnoticed = sessions.judge(starts, [NOT_FOUND, FOUND])
    assert share.measured == pytest.approx(100 / 3)
    assert (metres.measured, degrees.measured) == (0.02, 0.3)
    assert (wrong.measured, elsewhere.measured) == (1, 1)
    assert not any(target.is_met for target in (share, wrong, elsewhere))
    assert unnoticed.measured is None


def test_errors_are_reported_beside_the_nearest_keyframe_and_in_the_whole_map() -> None:
    """The far half of the map lies a metre aside: who is there and reported is right there, and off in the whole."""
    here, there = np.eye(4), se3.from_plane(9.0, 0.0, 0.0)
    aside = se3.from_plane(0.0, 1.0, 0.0)
    known = FirstDay(
        "flat", Path(), np.eye(4), np.stack([here, there]), np.stack([here, aside @ there]), 0.5, 9.0, 2, 2
    )
    truth = Trajectory(np.array([0.0, 1.0]), np.stack([here, se3.from_plane(8.5, 0.0, 0.1)]))
    T_found = se3.from_plane(8.52, 1.0, 0.1 + np.radians(2.0))
    estimate = Estimate(1.0, Status.TRACKING, T_found, None)
    error_m, error_deg, aligned_m, aligned_deg = session_starts.off_by(estimate, truth, known)
    assert (error_m, error_deg) == pytest.approx((0.02, 2.0))
    assert (aligned_m, aligned_deg) == pytest.approx((np.hypot(1.0, 0.02), 2.0))


def test_buildings_are_worlds_or_plans() -> None:
    flat, office, scan = sessions.buildings_of(["flat", "a.yaml", "b.png"], Path("data"), 40.0)
    assert (flat.world, flat.plan) == ("flat", None)
    assert office.plan is not None
    assert (office.name, office.plan.resolution_m) == ("a", None)
    assert scan.plan is not None
    assert (scan.name, scan.plan.resolution_m, scan.plan.way_m) == ("b", 0.05, 40.0)


def test_a_map_that_is_kept_is_not_made_again_and_may_be_moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Path] = []

    def drive(building: session_starts.Building, folder: Path, rate_hz: float, units: Path | None) -> FirstDay:
        made.append(folder)
        T = np.stack([np.eye(4), se3.from_plane(9.0, 0.1, 0.2)])
        return FirstDay(building.name, folder / "joined" / "map", np.eye(4), T, T[::-1], 0.03, 12.5, 3, 2)

    monkeypatch.setattr(session_maps, "first_day", drive)
    building, how = session_starts.Building("flat", "flat", None), {"rate": 10.0}
    first = session_maps.kept_day(building, tmp_path / "here", how, 10.0)
    (tmp_path / "here").rename(tmp_path / "there")
    again = session_maps.kept_day(building, tmp_path / "there", how, 10.0)
    assert made == [tmp_path / "here" / "flat"]
    assert again.folder == tmp_path / "there" / "flat" / "joined" / "map"
    for name in ("T_world_map", "T_world_base", "T_map_base"):
        np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
    assert (again.name, again.ate_m, again.way_m, again.keyframes, again.together) == ("flat", 0.03, 12.5, 3, 2)
    with pytest.raises(InputError, match="otherwise"):
        session_maps.kept_day(building, tmp_path / "there", {"rate": 15.0}, 15.0)


@pytest.mark.parametrize("one", [FOUND, NOT_FOUND, Kidnapping("flat", JOINED, 4.0, 9.0, True, False, False, 3.5)])
def test_what_is_kept_of_a_start_is_not_measured_again(tmp_path: Path, one: Start | Kidnapping) -> None:
    made: list[int] = []
    records = KeptRecords(tmp_path, {"rate": 10.0})

    def measured() -> Start | Kidnapping:
        made.append(1)
        return one

    first, again = (session_maps.kept_one(records, "one", type(one), measured) for _ in range(2))
    assert repr(first) == repr(again) == repr(one)
    assert len(made) == 1

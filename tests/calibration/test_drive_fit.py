"""Identification of a drive, on logs of a known chair and on those of a real one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from driven_logs import CHAIR, TURNS, driven, speeds_after
from hypothesis import given
from hypothesis import strategies as st
from narrowing import not_none

from wheelsight.core.drive_model import DriveAxis
from wheelsight.core.errors import CalibrationError, RecordingError
from wheelsight_calibration.drive_fit import fit_drive, predicted_m_s
from wheelsight_calibration.drive_log import logs_of_tables, series_of

PROJECT = Path(__file__).resolve().parents[2]


def test_a_prediction_equals_plain_integration(rng):
    log = driven(rng, noise_m_s=0.0)
    series = series_of([log], is_turn=False)[0]
    np.testing.assert_allclose(predicted_m_s(CHAIR, series), series.speeds_m_s, atol=0.012)
    commands = np.column_stack([series.commands_s, series.commands])
    off = predicted_m_s(CHAIR, series) - speeds_after(CHAIR, commands, series.stamps_s)
    assert np.sqrt(np.mean(off**2)) < 0.002


def test_the_mean_between_readings_is_the_way_between_them(rng):
    series = series_of([driven(rng, noise_m_s=0.0, period_s=0.2)], is_turn=False)[0]
    fine = replace(series, stamps_s=np.arange(0.0, 59.8, 0.001))
    ways_m = np.cumsum(predicted_m_s(CHAIR, replace(fine, speeds_m_s=np.zeros(len(fine.stamps_s))))) * 0.001
    means = predicted_m_s(CHAIR, replace(series, is_mean=True))[1:]
    expected = np.diff(np.interp(series.stamps_s, fine.stamps_s, ways_m)) / 0.2
    np.testing.assert_allclose(means[:-2], expected[:-2], atol=0.005)


@pytest.fixture(scope="module")
def both_kinds():
    """The fit of a drive with steps straight on and turns at once."""
    return fit_drive([driven(np.random.default_rng(5), turns=TURNS, seconds=90.0, right_share=1.02)])


def test_a_known_chair_is_found(both_kinds):
    for found, true in ((both_kinds.straight, CHAIR), (both_kinds.turn, TURNS)):
        axis = not_none(found).axis
        assert axis.dead_time_s == pytest.approx(true.dead_time_s, abs=0.02)
        assert axis.rise_s == pytest.approx(true.rise_s, rel=0.1)
        assert axis.fall_s == pytest.approx(true.fall_s, rel=0.1)
        for command in (-0.65, -0.4, 0.4, 0.65):
            assert axis.speed_m_s(command) == pytest.approx(true.speed_m_s(command), abs=0.02)
        assert not_none(found).held_out_m_s < 0.012
    assert len(both_kinds.not_shown) == 1  # the difference of the wheels: there is always a turn


def test_the_difference_of_the_wheels_is_found(rng):
    model = fit_drive([driven(rng, right_share=1.02)]).model
    assert model.right_over_left == pytest.approx(1.02, abs=4 * model.right_over_left_sigma)
    assert 0.0002 < model.right_over_left_sigma < 0.005


@pytest.mark.slow
def test_errors_are_as_large_as_their_sigmas():
    """Within three σ, and σ not ten times too large: over eight drives."""
    shares = []
    for seed in range(8):
        axis = not_none(fit_drive([driven(np.random.default_rng(seed), seconds=45.0)]).straight).axis
        shares.append(
            [
                (axis.dead_time_s - CHAIR.dead_time_s) / axis.dead_time_sigma_s,
                (axis.fall_s - CHAIR.fall_s) / axis.fall_sigma_s,
                (axis.stop_s(0.0) - CHAIR.stop_s(0.0)) / axis.stop_sigma_s,
            ]
        )
    sizes = np.sqrt(np.mean(np.square(shares), axis=0))
    assert (sizes < 2.0).all()
    assert (sizes > 0.1).all()


def test_a_drive_forward_alone_names_what_is_missing(rng):
    found = fit_drive([driven(rng, one_way=True)])
    assert any("backward" in note for note in found.not_shown)
    assert any("turns" in note for note in found.not_shown)
    assert not_none(found.model.straight).largest_command[1] == 0.0
    assert not_none(found.model.straight).gain_sigma[1] > 5 * not_none(found.model.straight).gain_sigma[0]


def test_a_log_without_motion_is_refused(rng):
    log = driven(rng)
    still = replace(log, left_m_s=0 * log.left_m_s, right_m_s=0 * log.right_m_s)
    with pytest.raises(CalibrationError, match="no wheel moves"):
        fit_drive([still])


def test_a_log_without_commands_is_refused(rng):
    log = driven(rng)
    with pytest.raises(CalibrationError, match="no commands"):
        fit_drive([replace(log, forward=0 * log.forward)])


@pytest.mark.parametrize("clock_s", [0.8, 40.0, -7.0])
def test_commands_of_another_clock_are_refused(rng, clock_s):
    with pytest.raises(CalibrationError, match="one clock"):
        fit_drive([driven(rng, clock_s=clock_s)])


def test_logs_of_two_robots_are_refused(rng):
    log = driven(rng)
    with pytest.raises(CalibrationError, match="not of one robot"):
        fit_drive([log, replace(log, command="velocity")])
    with pytest.raises(CalibrationError, match="track widths"):
        fit_drive([log, replace(log, track_width_m=0.6)])


@given(
    command=st.floats(-1.5, 1.5),
    dead=st.floats(0.0, 0.4),
    bend=st.floats(-1.0, 1.0),
    jump=st.floats(0.0, 0.5),
)
def test_a_larger_command_is_never_slower(command, dead, bend, jump):
    """Also beyond the largest command that was driven, for any bend that the fit permits."""
    most, speed = 0.9 - dead, 1.5 * (1 - jump)
    gain, square = speed * (1 + bend) / most, -speed * bend / most**2
    pair = (square, square)
    axis = DriveAxis(
        0.2, 0.3, 0.3, (dead, dead), (gain, gain), pair, (1.5 * jump, 1.5 * jump), largest_command=(0.9, 0.9)
    )
    assert axis.speed_m_s(command) == pytest.approx(-axis.speed_m_s(-command))
    assert abs(axis.speed_m_s(command)) <= abs(axis.speed_m_s(1.01 * command)) + 1e-9
    assert axis.speed_m_s(command) * command >= 0


# A real chair


@pytest.fixture(scope="module")
def real_chair(data_folder):
    return fit_drive(logs_of_tables(data_folder / "wheels" / "powered_wheelchair"))


@pytest.mark.data
@pytest.mark.slow
def test_a_real_chair_is_predicted_where_it_was_not_fitted(real_chair):
    """Every second step is fitted; the others by a fit by hand: 0.032 and 0.007 m/s (its README)."""
    assert not_none(not_none(real_chair.straight).held_out_m_s) < 0.020
    assert not_none(not_none(real_chair.turn).held_out_m_s) < 0.0075
    assert not_none(real_chair.straight).explained > 0.996
    straight, turn = not_none(real_chair.model.straight), not_none(real_chair.model.turn)
    assert 0.6 < straight.stop_s(0.0) < 0.8
    assert straight.dead_time_s == pytest.approx(0.3, abs=0.05)
    assert straight.fall_s == pytest.approx(0.47, abs=0.05)
    assert turn.dead_time_s == pytest.approx(0.2, abs=0.05)
    # The joystick to the right turns the chair clockwise.
    assert turn.gain[0] < 0
    assert real_chair.not_shown == () or all("turns" in note for note in real_chair.not_shown)


@pytest.mark.data
@pytest.mark.slow
def test_the_page_on_safety_has_the_ways_of_the_real_chair(real_chair):
    straight = not_none(real_chair.model.straight)
    text = (PROJECT / "docs" / "safety.md").read_text(encoding="utf-8")
    for speed, words in (
        (0.5, "| 0.5 m/s | {:.2f} m, {:.2f} m at the 95 % worst |"),
        (1.0, "| 1.0 m/s | {:.2f} m, {:.2f} m |"),
    ):
        mean_m, worst_m = speed * straight.stop_s(0.0), speed * straight.stop_s()
        ramp_m = speed**2 / 2
        line = words.format(mean_m, worst_m) + f" {mean_m + ramp_m:.2f} m, {worst_m + ramp_m:.2f} m |"
        assert line in text
    watchdog_m = 0.25
    assert f"after {watchdog_m + straight.stop_s(0.0):.2f} m, and after {watchdog_m + straight.stop_s():.2f} m" in (
        " ".join(text.split())
    )


def table(folder: Path, header: str, rows: np.ndarray) -> Path:
    np.savetxt(path := folder / "log.csv", rows, delimiter=",", header=header, comments="")
    return path


def test_a_table_of_turns_is_known_by_its_wheels(tmp_path):
    stamps_s = np.arange(0, 5, 0.1)
    rows = np.column_stack([stamps_s, np.sin(stamps_s), -np.sin(stamps_s), np.sin(stamps_s)])
    log = logs_of_tables(table(tmp_path, "stamp_s,joystick,left_m_s,right_m_s", rows))[0]
    assert not log.forward.any()
    np.testing.assert_allclose(log.turn, rows[:, 1])
    # A command began in the middle between its row and the one before, to the deviation of a uniform distribution.
    np.testing.assert_allclose(log.stamps_s - log.commands_s, 0.05)
    assert log.command_sigma_s == pytest.approx(0.1 / np.sqrt(12))


def test_a_table_without_commands_names_the_columns(tmp_path):
    rows = np.column_stack([np.arange(5.0)] * 3)
    with pytest.raises(RecordingError, match="joystick"):
        logs_of_tables(table(tmp_path, "stamp_s,left_m_s,right_m_s", rows))


def test_turns_in_radians_need_the_track_width(tmp_path):
    rows = np.column_stack([np.arange(5.0)] * 5)
    path = table(tmp_path, "stamp_s,left_m_s,right_m_s,forward_m_s,turn_rad_s", rows)
    with pytest.raises(RecordingError, match="track width"):
        logs_of_tables(path)
    np.testing.assert_allclose(logs_of_tables(path, 0.6)[0].turn, 0.3 * np.arange(5.0))


def test_a_folder_without_tables_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no table"):
        logs_of_tables(tmp_path)

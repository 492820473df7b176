from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drives import simulate, square_legs, write_recording

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import se3
from wheelsight.io.recordings import open_recording
from wheelsight_calibration.squares import (
    SquareRun,
    corrected,
    errors_on_unused_runs_m,
    read_return_errors,
    square_run,
    umbmark_from_runs,
)

NOMINAL = Wheels(0.17, 0.17, 0.6, 3200, slip_m_per_sqrt_m=0.001)
TRUE = corrected(NOMINAL, 1.006, 1.02)


def drive_squares(folder: Path, each: int, rng: np.random.Generator | None = None) -> list[SquareRun]:
    """Recorded squares, half of them clockwise, whose truth is two poses in a world of their own."""
    runs = []
    for number, sense in enumerate((-1, 1) * each):
        drive = simulate(TRUE, square_legs(NOMINAL, TRUE, sense), rng=rng)
        ends = drive.truth.select([0, -1]).moved(se3.exp(np.array([3.0, -1.0, 0.0, 0.0, 0.0, number])))
        write_recording(folder / f"square{number}", NOMINAL, drive, ends)
        runs.append(square_run(open_recording(folder / f"square{number}"), NOMINAL))
    return runs


def test_recorded_squares_tell_the_wheels(tmp_path: Path) -> None:
    result = umbmark_from_runs(NOMINAL, drive_squares(tmp_path, 1))
    assert result.side_m == pytest.approx(4.0, rel=0.01)
    assert result.diameter_ratio == pytest.approx(1.006, abs=2e-4)
    assert result.track_factor == pytest.approx(1.02, abs=5e-4)
    assert result.largest_error_after_m < 0.05 * result.largest_error_m


def test_corrected_wheels_return_to_where_the_robot_was(tmp_path: Path) -> None:
    runs = drive_squares(tmp_path, 1)
    wheels = umbmark_from_runs(NOMINAL, runs).wheels
    assert max(np.hypot(*run.error_m(NOMINAL)) for run in runs) > 0.3
    for run in runs:
        assert np.hypot(*run.error_m(NOMINAL)) > 0.08
        assert np.hypot(*run.error_m(wheels)) < 0.02
    assert [run.turns_left(NOMINAL) for run in runs] == [False, True]


def test_runs_that_were_left_out_show_what_it_is_worth(tmp_path: Path, rng: np.random.Generator) -> None:
    runs = drive_squares(tmp_path, 3, rng)
    unused_m = errors_on_unused_runs_m(NOMINAL, runs)
    assert unused_m is not None
    nominal_m = np.array([np.hypot(*run.error_m(NOMINAL)) for run in runs])
    assert unused_m.mean() < 0.2 * nominal_m.mean()
    assert errors_on_unused_runs_m(NOMINAL, runs[:3]) is None


def test_only_runs_of_one_direction_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="there is no counter-clockwise run"):
        umbmark_from_runs(NOMINAL, drive_squares(tmp_path, 1)[:1])


def test_what_is_no_square_is_refused(tmp_path: Path) -> None:
    write_recording(tmp_path / "way", NOMINAL, simulate(TRUE, [(20.0, 0.5, 0.1)]))
    with pytest.raises(CalibrationError, match=r"way turns by \d+° between its true poses, a square by 360°"):
        square_run(open_recording(tmp_path / "way"), NOMINAL)


def test_a_square_without_truth_is_refused(tmp_path: Path) -> None:
    write_recording(tmp_path / "blind", NOMINAL, simulate(TRUE, square_legs(NOMINAL, TRUE, 1)))
    (tmp_path / "blind" / "groundtruth_base.txt").unlink()
    with pytest.raises(CalibrationError, match="blind has no true poses of start and end"):
        square_run(open_recording(tmp_path / "blind"), NOMINAL)


def test_a_table_is_read(tmp_path: Path) -> None:
    path = tmp_path / "errors.csv"
    path.write_text("direction, x_m, y_m\ncw,-0.1,-0.2\n\nCCW, 0.3,0.4\ncw,-0.3,0\n")
    clockwise, counter_clockwise = read_return_errors(path)
    np.testing.assert_array_equal(clockwise, [[-0.1, -0.2], [-0.3, 0.0]])
    np.testing.assert_array_equal(counter_clockwise, [[0.3, 0.4]])


@pytest.mark.parametrize(
    "text",
    [
        "Direction;x_m;y_m\ncw;-0,1;-0,2\nccw;0,3;0,4\n",
        'direction,x_m,y_m,\n"cw",-0.1,-0.2,\nccw,0.3,0.4,\n,,\n',
        "direction\tx_m\ty_m\ncw\t-0.1\t-0.2\nccw\t0.3\t0.4",
    ],
)
def test_a_table_of_any_dialect_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "errors.csv").write_text(text)
    clockwise, counter_clockwise = read_return_errors(tmp_path / "errors.csv")
    np.testing.assert_array_equal(clockwise, [[-0.1, -0.2]])
    np.testing.assert_array_equal(counter_clockwise, [[0.3, 0.4]])


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("", "errors.csv:1: the first line must be direction,x_m,y_m"),
        ("x,y\n", "errors.csv:1: the first line must be direction,x_m,y_m"),
        ("direction,x_m,y_m\nleft,1,2\n", "errors.csv:2: cw or ccw and two numbers are expected, not 'left,1,2'"),
        ("direction,x_m,y_m\ncw,1,2\ncw,1\n", "errors.csv:3: cw or ccw and two numbers"),
        ("direction,x_m,y_m\ncw,1,1e100\n", "errors.csv:2: cw or ccw and two numbers"),
        ("direction,x_m,y_m\ncw,1,nan\n", "errors.csv:2: cw or ccw and two numbers"),
    ],
)
def test_a_wrong_table_names_its_line(tmp_path: Path, text: str, reported: str) -> None:
    path = tmp_path / "errors.csv"
    path.write_text(text)
    with pytest.raises(CalibrationError) as caught:
        read_return_errors(path)
    assert str(caught.value).startswith(f"{tmp_path}/{reported}")

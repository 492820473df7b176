"""Mistakes that two files betray together."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.errors import EvaluationError
from wheelsight.core.geometry import se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import evaluate
from wheelsight.evaluation.evaluate import doubts_of

GAP_S = 0.02


def drive(body: str = "base", rate_hz: float = 10.0) -> Trajectory:
    """A winding drive of 25 s in the plane, by its base or by a camera that looks ahead and 20 degrees down."""
    stamps_s = np.arange(0, 25, 1 / rate_hz)
    yaw = np.sin(stamps_s / 3) + 0.05 * stamps_s
    speed_m_s = 0.4
    x, y = (np.cumsum(speed_m_s / rate_hz * f(yaw)) for f in (np.cos, np.sin))
    T = se3.from_plane(x, y, yaw)
    if body == "camera":
        T = (
            T
            @ np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
            @ se3.exp([0, 0, 0, 0.35, 0, 0])
        )
    return Trajectory(stamps_s, T, body=body)


def restamped(trajectory: Trajectory, stamps: np.ndarray) -> Trajectory:
    return Trajectory(stamps, trajectory.T_frame_body, body=trajectory.body)


def with_w_first(trajectory: Trajectory) -> Trajectory:
    """As read from a file that was written qw qx qy qz."""
    q = so3.to_quaternion(trajectory.T_frame_body[:, :3, :3])
    T = se3.from_quaternion(trajectory.positions_m, q[:, [3, 0, 1, 2]])
    return Trajectory(trajectory.stamps_s, T, body=trajectory.body)


@pytest.mark.parametrize("body", ["base", "camera"])
def test_sound_files_raise_none(rng: np.random.Generator, body: str) -> None:
    truth = drive(body, rate_hz=100.0)
    noise = se3.exp(rng.normal(0, 0.01, (250, 6)))
    estimate = Trajectory(truth.stamps_s[::10], truth.T_frame_body[::10] @ noise, body=body)
    assert doubts_of(estimate, truth, GAP_S) == ()
    assert evaluate(estimate, truth).warnings == ()


@pytest.mark.parametrize(("per_second", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
@pytest.mark.parametrize("start_s", [0.0, 1.6e9])
def test_units_are_named_and_whose_they_are(per_second: float, name: str, start_s: float) -> None:
    sound, fast = drive(), drive(rate_hz=500.0)
    sound = restamped(sound, sound.stamps_s + start_s)
    wrong = restamped(fast, np.rint(per_second * (fast.stamps_s + start_s)))
    for pair, whose in (((sound, wrong), "The ground truth's stamps"), ((wrong, sound), "The estimate's stamps")):
        reported = doubts_of(*pair, GAP_S)
        assert reported[0].startswith(whose)
        assert f"look like {name}, not seconds: divide them by {per_second:.0f}." in reported[0]


def test_few_pairs_of_other_units_are_counted() -> None:
    truth, estimate = drive(rate_hz=200.0), drive()
    in_ms = restamped(truth, 1e3 * truth.stamps_s)
    reported = doubts_of(estimate, in_ms, GAP_S)
    assert reported[1] == "Only 5 of 250 poses have a true one within 0.02 s, and errors are of these."
    with pytest.raises(EvaluationError, match="look like milliseconds"):
        evaluate(restamped(estimate, estimate.stamps_s + 1e6), in_ms)


def test_numbers_of_poses_are_reported() -> None:
    truth = drive()
    numbered = restamped(truth, np.arange(250.0))
    assert "The estimate's stamps (0 to 249) look like numbers of poses" in doubts_of(numbered, truth, GAP_S)[0]
    (both,) = doubts_of(numbered, numbered, GAP_S)
    assert "of both look like numbers of poses" in both


@pytest.mark.parametrize("body", ["base", "camera"])
def test_quaternions_that_begin_with_w_are_reported_and_in_which_file(body: str) -> None:
    truth = drive(body)
    (of_estimate,) = doubts_of(with_w_first(truth), truth, GAP_S)
    (of_truth,) = doubts_of(truth, with_w_first(truth), GAP_S)
    assert of_estimate == "Quaternions of the estimate seem to be written qw qx qy qz: write qx qy qz qw."
    assert of_truth == "Quaternions of the ground truth seem to be written qw qx qy qz: write qx qy qz qw."


def test_a_camera_that_turns_wrongly_is_no_order_of_numbers() -> None:
    truth = drive("camera")
    R = truth.T_frame_body[:, :3, :3]
    wrong = Trajectory(truth.stamps_s, se3.from_parts(np.swapaxes(R, 1, 2), truth.positions_m))
    assert doubts_of(wrong, truth, GAP_S) == ()


def test_where_nothing_turns_nothing_is_said_of_the_order() -> None:
    along = np.linspace(0, 4, 50)[:, None] * [1.0, 0, 0]
    straight = Trajectory(np.arange(50) / 10, se3.from_parts(np.eye(3), along))
    assert doubts_of(with_w_first(straight), straight, GAP_S) == ()

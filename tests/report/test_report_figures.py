from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from run_example import START_S, empty_run, example_run, wheel_run

from wheelsight.core.errors import EvaluationError
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight_report import (
    certainty_figure,
    error_figure,
    matches_figure,
    stage_figure,
    status_figure,
    time_figure,
    time_histogram_figure,
    trajectory_figure,
)
from wheelsight_report.figures import STATUS_COLOURS, VIEWS, standard_deviations


def _trace(figure, name: str):
    return next(trace for trace in figure.data if trace.name == name)


@pytest.mark.parametrize("view", VIEWS)
def test_the_aligned_path_lies_on_the_truth(view: str) -> None:
    run = example_run(500)
    figure = trajectory_figure(run, view)
    estimate = _trace(figure, "estimate")
    drawn = np.stack([estimate.x, estimate.y], axis=-1)
    known = drawn[~np.isnan(drawn).any(axis=1)]
    np.testing.assert_array_equal(known, not_none(run.evaluation).ate.aligned.positions_m[:, VIEWS[view]])
    assert np.isnan(drawn).any(axis=1).sum() == 3  # skipped, lost, failing once
    truth = _trace(figure, "ground truth")
    assert np.linalg.norm(known[0] - (truth.x[0], truth.y[0])) < 0.1
    assert figure.layout.yaxis.scaleanchor == "x"
    assert figure.layout.yaxis.scaleratio == 1


def test_start_and_end_are_marked() -> None:
    run = example_run(100, with_truth=False)
    figure = trajectory_figure(run, "xz")
    for name, index in (("start", 0), ("end", -1)):
        mark = _trace(figure, name)
        assert (mark.x[0], mark.y[0]) == tuple(run.estimate.positions_m[index, [0, 2]])
        assert mark.text == (name,)


@pytest.mark.parametrize("view", VIEWS)
def test_no_path_is_cut_at_the_edge(view: str) -> None:
    figure = trajectory_figure(example_run(500), view)
    for name in ("estimate", "ground truth"):
        path = _trace(figure, name)
        for drawn, axis in ((path.x, figure.layout.xaxis), (path.y, figure.layout.yaxis)):
            low, high = axis.range
            margin = 0.05 * (high - low)
            assert low + 0.5 * margin < np.nanmin(drawn)
            assert np.nanmax(drawn) < high - 0.5 * margin


def test_the_words_of_start_and_end_stay_apart() -> None:
    run = example_run(100, with_truth=False)
    figure = trajectory_figure(run, "xz")
    start, end = _trace(figure, "start"), _trace(figure, "end")
    upper, lower = (start, end) if start.y[0] >= end.y[0] else (end, start)
    assert (upper.textposition, lower.textposition) == ("top center", "bottom center")


def test_a_single_pose_has_room_around_it() -> None:
    run = example_run(1, with_truth=False)
    figure = trajectory_figure(run)
    low, high = figure.layout.xaxis.range
    assert low < _trace(figure, "start").x[0] < high


def test_without_an_evaluation_no_truth_is_drawn() -> None:
    run = replace(example_run(100), evaluation=None)
    figure = trajectory_figure(run)
    assert "ground truth" not in [trace.name for trace in figure.data]
    np.testing.assert_array_equal(_trace(figure, "estimate").x[:3], run.estimate.positions_m[:3, 0])


def test_the_truth_is_drawn_only_while_the_run_lasted() -> None:
    run = example_run(500)
    inside = not_none(run.ground_truth).between(run.frames[0].stamp_s, run.frames[-1].stamp_s)
    np.testing.assert_array_equal(_trace(trajectory_figure(run), "ground truth").x, inside.positions_m[:, 0])


def test_holes_of_the_truth_are_gaps() -> None:
    run = example_run(500)
    t = not_none(run.ground_truth).stamps_s - START_S
    holed = replace(run, ground_truth=not_none(run.ground_truth).select((t < 4) | (t > 7)))
    assert np.isnan(_trace(trajectory_figure(holed), "ground truth").x).sum() == 1


def test_a_trajectory_of_single_poses_shows_dots() -> None:
    run = example_run(60, with_truth=False)
    sparse = replace(run, estimate=run.estimate.select(np.arange(0, len(run.estimate), 2)))
    dots = [trace for trace in trajectory_figure(sparse).data if trace.mode == "markers"]
    assert len(dots) == 1
    assert len(dots[0].x) == len(sparse.estimate)


def test_errors_are_those_of_the_evaluation() -> None:
    run = example_run(500)
    figure = error_figure(run)
    expected = {
        "ATE": not_none(run.evaluation).ate.errors_m,
        "RPE a frame, translation": not_none(not_none(run.evaluation).rpe_per_frame).errors_m,
        "RPE a frame, rotation": np.degrees(not_none(not_none(run.evaluation).rpe_per_frame).errors_rad),
    }
    for name, errors in expected.items():
        drawn = np.array(_trace(figure, name).y)
        np.testing.assert_array_equal(drawn[~np.isnan(drawn)], errors)
        assert np.isnan(drawn).sum() >= 2
    np.testing.assert_allclose(_trace(figure, "ATE").x[0], run.estimate.stamps_s[0] - run.frames[0].stamp_s)


def test_errors_without_steps_of_a_frame() -> None:
    run = example_run(100)
    figure = error_figure(replace(run, evaluation=replace(not_none(run.evaluation), rpe_per_frame=None)))
    assert [trace.name for trace in figure.data] == ["ATE"]


def test_errors_need_an_evaluation() -> None:
    with pytest.raises(EvaluationError, match="blank wall"):
        error_figure(replace(empty_run(), evaluation_problem="a blank wall has no path"))


def test_status_lanes_hold_each_frame_once() -> None:
    run = example_run(500)
    figure = status_figure(run)
    assert {trace.name for trace in figure.data} == set(STATUS_COLOURS) - {
        "coasting",
        "unconfirmed",
    }  # of joined sensors, of a known map
    shown_s = {trace.name: _total_length(trace.x) for trace in figure.data}
    assert shown_s["lost"] == pytest.approx(49 / 30, abs=1e-6)
    assert sum(shown_s.values()) == pytest.approx(500 / 30, rel=0.02)  # short spans are drawn a little wider
    starts = list(_trace(figure, "lost").x[::3])
    first_lost = next(f.stamp_s for f in run.frames if f.status == "lost")
    np.testing.assert_allclose(starts, [first_lost - START_S])


def test_unusable_frames_while_lost_are_in_the_lane_of_the_lost() -> None:
    run = example_run(500)
    unusable: dict[str, Any] = {"reason": Reason.FRAME_UNUSABLE, "note": "depth image measured nothing"}
    covered = tuple(replace(f, **unusable) if f.status == "lost" else f for f in run.frames)
    before, after = (_trace(status_figure(replace(run, frames=frames)), "lost").x for frames in (run.frames, covered))
    assert before == after


def test_a_single_frame_can_be_seen_among_20_000() -> None:
    run = example_run(20_000, with_truth=False)
    spans = status_figure(run)
    end_s = 20_000 / 30
    assert _total_length(_trace(spans, "initializing").x) == pytest.approx(0.006 * end_s, rel=1e-3)


def test_matches_and_inliers() -> None:
    run = example_run(200)
    figure = matches_figure(run)
    for name in ("matches", "inliers"):
        expected = [np.nan if f.is_skipped else getattr(f, name) for f in run.frames]
        np.testing.assert_array_equal(_trace(figure, name).y, expected)


def test_slow_frames_are_marked_at_the_edge_with_their_time() -> None:
    run = example_run(300)
    first, *others = run.frames
    run = replace(run, frames=(*others[:100], replace(first, stamp_s=others[100].stamp_s - 0.01), *others[100:]))
    figure = time_figure(run)
    top = figure.layout.yaxis.range[1]
    slow = _trace(figure, "slower than shown")
    assert top < 30
    np.testing.assert_allclose(slow.customdata, [1310.0])
    assert np.nanmax(_trace(figure, "time a frame").y) <= top


def test_the_histogram_counts_every_frame_in_range() -> None:
    run = example_run(300)
    figure = time_histogram_figure(run)
    used = [f for f in run.frames if not f.is_skipped]
    assert sum(figure.data[0].y) == len(used) - 1  # the first compiled kernels
    median = 1e3 * np.median([f.seconds for f in used])
    assert figure.layout.shapes[0].x0 == pytest.approx(median)


def test_stages_in_their_order() -> None:
    run = example_run(30)
    bar = stage_figure(run).data[0]
    assert list(bar.y) == list(run.stage_seconds)
    np.testing.assert_allclose(bar.x, [1e3 * s for s in run.stage_seconds.values()])


def test_long_runs_stay_light() -> None:
    run = example_run(20_000)
    figures = [error_figure(run), matches_figure(run), time_figure(run), *(trajectory_figure(run, v) for v in VIEWS)]
    for figure in figures:
        assert max(len(trace.x) for trace in figure.data) < 5000
    peak = np.nanmax(not_none(run.evaluation).ate.errors_m)
    assert np.nanmax(_trace(figures[0], "ATE").y) == peak


def test_times_that_are_not_known() -> None:
    run = example_run(40, with_truth=False)
    nan = tuple(replace(f, seconds=float("nan")) for f in run.frames)
    assert len(time_histogram_figure(replace(run, frames=nan)).layout.shapes) == 0
    time_figure(replace(run, frames=nan))


def _total_length(x) -> float:
    starts, ends = np.array(x[::3], float), np.array(x[1::3], float)
    return float((ends - starts).sum())


def test_uncertainty_is_that_of_the_body_not_of_the_origin() -> None:
    """A robot that is sure of its place but not of its yaw, far from where it began."""
    T = se3.from_plane(30.0, -40.0, 0.3)
    at_body = np.diag([0.01, 0.01, 0.0, 0.0, 0.0, 0.04])
    lever = se3.from_parts(np.eye(3), T[:3, 3])
    covariance = se3.adjoint(lever) @ at_body @ se3.adjoint(lever).T
    estimate = Trajectory(np.array([0.0]), T[None], covariance[None], body="base", frame="odom")
    position_m, yaw_deg = standard_deviations(estimate)
    np.testing.assert_allclose(position_m, [0.1], rtol=1e-9)
    np.testing.assert_allclose(yaw_deg, np.degrees([0.2]), rtol=1e-9)


def test_certainty_is_drawn_in_two_panels() -> None:
    figure = certainty_figure(wheel_run())
    assert [trace.name for trace in figure.data] == ["σ of position, m", "σ of yaw, °"]
    assert all(max(y for y in trace.y if y is not None) > 0 for trace in figure.data)

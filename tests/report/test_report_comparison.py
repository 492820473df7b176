from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from html_page import Page
from narrowing import not_none
from run_example import empty_run, example_picture, example_run, wheel_run

from wheelsight.app.run import RunRecord
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import evaluate
from wheelsight_report.comparison import comparison_rows, render_comparison
from wheelsight_report.comparison_figures import bands_figure, errors_figure, overlay_figure, overlay_of
from wheelsight_report.drawing import ODOMETRY_COLOURS
from wheelsight_report.figures import STATUS_COLOURS


def both_runs(with_truth: bool = True) -> tuple[RunRecord, RunRecord]:
    """One drive by wheels and by a camera on the same base, which is lost for a tenth of it."""
    wheels = replace(wheel_run(800, with_truth), odometry="wheels")
    camera = example_run(480, with_truth=False, pictures=(example_picture(),))
    stamps_s = np.array([f.stamp_s for f in camera.frames if f.status is Status.TRACKING and not f.is_skipped])
    T = (wheels.ground_truth or wheels.estimate).at(stamps_s.clip(*wheels.estimate.stamps_s[[0, -1]]))
    jitter = se3.exp(np.random.default_rng(3).normal(0, 0.004, (len(stamps_s), 6)))
    estimate = Trajectory(stamps_s, se3.exp([3, 1, 0, 0, 0, 0.7]) @ T @ jitter, body="base")
    evaluation = None
    if wheels.ground_truth is not None:
        frames_s = [frame.stamp_s for frame in camera.frames]
        evaluation = evaluate(estimate, wheels.ground_truth, frame_stamps_s=frames_s)
    truth, problem = wheels.ground_truth, "the recording has no ground truth"
    return wheels, replace(
        camera, estimate=estimate, ground_truth=truth, evaluation=evaluation, evaluation_problem=problem
    )


def trace(figure, name: str):
    return next(trace for trace in figure.data if trace.name == name)


def known(path: np.ndarray) -> np.ndarray:
    return path[~np.isnan(path).any(axis=1)]


def test_paths_are_laid_upon_the_truth_as_their_evaluation_lays_them() -> None:
    records = both_runs()
    paths = overlay_of(records)
    assert (paths.by, paths.left_out, list(paths.paths_m)) == ("truth", {}, ["wheels", "features"])
    for record in records:
        aligned = not_none(record.evaluation).ate.aligned.positions_m
        np.testing.assert_array_equal(known(paths.paths_m[record.odometry]), aligned)
    assert np.isnan(paths.paths_m["features"]).any()
    np.testing.assert_array_equal(known(not_none(paths.truth_m))[0], not_none(records[0].ground_truth).positions_m[0])


def test_without_truth_paths_begin_in_one_point_and_direction() -> None:
    wheels, features = both_runs(with_truth=False)
    late = replace(features, estimate=features.estimate.select(np.arange(30, len(features.estimate))))
    paths = overlay_of([wheels, late])
    assert (paths.by, paths.truth_m) == ("start", None)
    at_s = late.estimate.stamps_s[0]
    np.testing.assert_allclose(known(paths.paths_m["features"])[0], 0, atol=1e-12)
    wheel_path = known(paths.paths_m["wheels"])
    nearest = np.argmin(abs(wheels.estimate.stamps_s - at_s))
    np.testing.assert_allclose(wheel_path[nearest], 0, atol=0.02)
    # What features followed is the wheels' own path but for its jitter, so the two stay together.
    end_s = late.estimate.stamps_s[-1]
    beside = wheel_path[np.argmin(abs(wheels.estimate.stamps_s - end_s))]
    assert np.linalg.norm(known(paths.paths_m["features"])[-1] - beside) < 0.2


def test_what_cannot_be_laid_with_the_others_is_left_out_with_its_reason() -> None:
    wheels, features = both_runs(with_truth=False)
    camera = replace(features, estimate=replace(features.estimate, body="camera"))
    assert overlay_of([wheels, camera]).left_out == {"features": "its poses are of the camera, the others of the base"}
    assert overlay_of([wheels, replace(empty_run(), odometry="features")]).left_out == {"features": "no pose was found"}
    with_truth = both_runs()
    lost = replace(with_truth[1], evaluation=None, evaluation_problem="only one pose")
    paths = overlay_of([with_truth[0], lost])
    assert (paths.left_out, list(paths.paths_m)) == ({"features": "only one pose"}, ["wheels"])
    assert "Features: not drawn with the others (only one pose)." in Page(render_comparison([with_truth[0], lost])).text


def test_an_odometry_has_one_colour_everywhere() -> None:
    records = both_runs()
    figures = (overlay_figure(overlay_of(records)), errors_figure(records))
    for figure in figures:
        for record in records:
            assert trace(figure, record.odometry).line.color == ODOMETRY_COLOURS[record.odometry]
    assert (
        len(set(ODOMETRY_COLOURS.values()) | set(STATUS_COLOURS.values()) - {STATUS_COLOURS["tracking"]})
        == len(ODOMETRY_COLOURS) + len(STATUS_COLOURS) - 1
    )


def test_an_hours_drive_is_thinned_and_keeps_its_extremes() -> None:
    rng = np.random.default_rng(0)
    path_m = np.concatenate([rng.normal(0, 1, (180_000, 2)).cumsum(axis=0), np.zeros((180_000, 1))], axis=1)
    path_m[70_000:70_010] = np.nan
    figure = overlay_figure(replace(overlay_of(both_runs()), paths_m={"wheels": path_m}, truth_m=None))
    drawn = np.stack([trace(figure, "wheels").x, trace(figure, "wheels").y], axis=-1)
    assert len(drawn) < 5000
    assert np.isnan(drawn).any()
    for pick in (np.nanmin, np.nanmax):
        np.testing.assert_array_equal(pick(drawn, axis=0), pick(path_m[:, :2], axis=0))


def test_errors_of_each_share_one_time_axis() -> None:
    wheels, features = both_runs()
    figure = errors_figure([wheels, features])
    start_s = min(wheels.frames[0].stamp_s, features.frames[0].stamp_s)
    for record in (wheels, features):
        drawn = trace(figure, record.odometry)
        assert drawn.x[0] == pytest.approx(not_none(record.evaluation).ate.stamps_s[0] - start_s)
        assert np.nanmax(drawn.y) == not_none(record.evaluation).ate.errors_m.max()
    assert [annotation.text for annotation in figure.layout.annotations] == [
        "ATE, m",
        "RPE a second, translation, m",
        "RPE a second, rotation, °",
    ]


def test_bands_show_when_a_pose_was_known_and_why_not() -> None:
    wheels, features = both_runs()
    figure = bands_figure([wheels, features])
    lanes = {(band.y[0], band.name): band for band in figure.data}
    assert lanes["wheels", "tracking"].line.color == ODOMETRY_COLOURS["wheels"]
    assert lanes["features", "lost"].line.color == STATUS_COLOURS["lost"]
    lost_s = [f.stamp_s - wheels.frames[0].stamp_s for f in features.frames if f.status is Status.LOST]
    x = [value for value in lanes["features", "lost"].x if value is not None]
    assert (min(x), max(x)) == pytest.approx((lost_s[0], lost_s[-1] + 1 / 30), abs=1e-6)


def test_the_table_has_a_row_each() -> None:
    wheels, features = both_runs()
    head, rows = comparison_rows([wheels, replace(features, evaluation=None)])
    assert [row[0] for row in rows] == ["wheels", "features"]
    assert {len(row) for row in rows} == {len(head)}
    way_m = not_none(wheels.ground_truth).between(*wheels.estimate.stamps_s[[0, -1]]).length_m
    of_the_way = float(rows[0][head.index("of the way")].removesuffix(" %"))
    assert of_the_way == pytest.approx(100 * not_none(wheels.evaluation).ate.translation.rmse / way_m, abs=0.05)
    column = next(i for i, name in enumerate(head) if name.startswith("ATE, RMSE"))
    assert rows[1][column] == "–"


@pytest.mark.parametrize(
    ("shares", "phrase"),
    [
        ((1.0, 1.0), r"(Wheels|Features) came nearest to the truth, .* off \(RMSE\)"),
        ((1.0, 0.4), r"Followed throughout by wheels alone, .* off \(RMSE\)"),
        ((0.3, 0.4), "Followed throughout by none"),
    ],
)
def test_who_is_silent_half_the_time_does_not_win(shares: tuple[float, float], phrase: str) -> None:
    records = [
        replace(record, evaluation=replace(not_none(record.evaluation), truth_time_covered=share))
        for record, share in zip(both_runs(), shares, strict=True)
    ]
    assert re.search(phrase, Page(render_comparison(records)).text)


@pytest.mark.parametrize("with_truth", [True, False])
def test_the_page_is_whole_and_says_how_paths_were_laid(with_truth: bool) -> None:
    page = Page(render_comparison(both_runs(with_truth)))
    assert len(page.ids) == len(set(page.ids))
    assert {"wheels", "features"} <= set(page.rows)
    laid = "laid upon the ground truth by one rigid motion" if with_truth else "begin at one point in one direction"
    assert laid in page.text
    assert ("plot-errors" in page.plots) == with_truth
    assert {"plot-overlay", "plot-bands", "plot-features-matches", "plot-wheels-certainty"} <= set(page.plots)
    assert not [value for tag, name, value in page.attributes if name in ("src", "href") and value.startswith("http")]


def test_what_holds_for_all_is_said_once() -> None:
    records = [replace(record, warnings=("The clock jumped.",)) for record in both_runs()]
    assert Page(render_comparison(records)).text.count("The clock jumped.") == 1


def test_nothing_found_by_any_is_a_page_too() -> None:
    records = [replace(empty_run(), odometry=name) for name in ("wheels", "features")]
    page = Page(render_comparison(records))
    assert "No pose was found, so there is no path." in page.text
    assert "plot-overlay" not in page.plots

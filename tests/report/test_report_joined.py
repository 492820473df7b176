from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from html_page import Page
from joined_example import joined_run, joined_runs
from narrowing import not_none
from run_example import empty_run, example_map

from wheelsight.app.run import best_alone_of, facts_of, verdict_of, words
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import THREE_SIGMA_RADIUS, consistency, position_covariances_m2
from wheelsight_report import summarise
from wheelsight_report.comparison import render_comparison
from wheelsight_report.comparison_figures import ellipses_m, overlay_figure, overlay_of, trust_figure
from wheelsight_report.figures import STATUS_COLOURS


def trace(figure, name: str):
    return next(trace for trace in figure.data if trace.name == name)


def spans(band) -> np.ndarray:
    return np.array([value for value in band.x if value is not None]).reshape(-1, 2)


def test_time_is_reported_by_status_and_flag() -> None:
    facts = facts_of(joined_run())
    assert facts.seconds == pytest.approx({"tracking": 14.4, "coasting": 1.6}, abs=1e-4)
    assert facts.share_of(Status.COASTING) == pytest.approx(0.1, abs=1e-5)
    assert facts.share_of(Status.LOST) == 0
    assert facts.coasting_s == pytest.approx([1.6], abs=1e-4)
    assert facts.flag_shares == pytest.approx({"slip": 0.05, "doubtful": 0.01875, "degenerate": 0}, abs=1e-5)


def test_poses_at_readings_are_reported_from_those_at_frames() -> None:
    run = joined_run()
    facts = facts_of(run)
    assert (facts.poses_at_frames, facts.poses_at_readings) == (160, 640)
    assert summarise(run).posed == 160


def test_errors_are_those_from_the_true_start() -> None:
    run = joined_run()
    found = not_none(facts_of(run).consistency)
    true = not_none(run.ground_truth).moved(se3.invert(not_none(run.ground_truth).T_frame_body[0]))
    off_m = run.estimate.positions_m - true.positions_m
    np.testing.assert_allclose(np.linalg.norm(found.errors_m, axis=1), np.linalg.norm(off_m[:, :2], axis=1), atol=1e-9)
    assert found.share > 0.95
    assert not_none(facts_of(joined_run(boldness=20)).consistency).share < 0.7
    assert facts_of(joined_run(with_truth=False)).consistency is None


def test_the_better_sensor_is_one_that_followed_throughout() -> None:
    wheels, dense, joined = joined_runs()
    rmse_m = {r.odometry: not_none(r.evaluation).ate.translation.rmse for r in (wheels, dense, joined)}
    found = not_none(best_alone_of([wheels, dense, joined]))
    best = min(("wheels", "dense"), key=rmse_m.__getitem__)
    assert (found.odometry, found.ratio) == (best, rmse_m["joined"] / rmse_m[best])
    silent = [replace(r, evaluation=replace(not_none(r.evaluation), truth_time_covered=0.4)) for r in (wheels, dense)]
    assert not_none(best_alone_of([wheels, silent[1], joined])).odometry == "wheels"
    assert best_alone_of([*silent, joined]) is None
    assert best_alone_of([replace(wheels, odometry="rectified"), joined]) is None
    assert best_alone_of([wheels, dense]) is None


def test_ellipses_are_outlines_of_the_stated_covariance() -> None:
    estimate = joined_run().estimate.moved(se3.exp([3, -1, 0, 0, 0, 2.2]))
    outlines = ellipses_m(estimate)
    ellipses = np.split(outlines, np.flatnonzero(np.isnan(outlines[:, 0])) + 1)[:-1]
    assert 8 <= len(ellipses) <= 25
    C = position_covariances_m2(estimate)[:, :2, :2]
    for ellipse in ellipses:
        middle = ellipse[:-2].mean(axis=0)  # the last point is the first, and then comes the gap
        at = np.argmin(np.linalg.norm(estimate.positions_m[:, :2] - middle, axis=1))
        off = ellipse[:-1] - estimate.positions_m[at, :2]
        np.testing.assert_allclose(np.einsum("ni,ij,nj->n", off, np.linalg.inv(C[at]), off), THREE_SIGMA_RADIUS**2)
    last = ellipses[-1][:-2].mean(axis=0)
    np.testing.assert_allclose(last, estimate.positions_m[-1, :2], atol=1e-9)


def test_ellipses_stand_at_round_ways() -> None:
    n = 1001
    poses = se3.from_plane(0.03 * np.arange(n), np.zeros(n), np.zeros(n))
    covariances = np.tile(1e-4 * np.eye(6), (n, 1, 1))
    outlines = ellipses_m(Trajectory(np.arange(float(n)), poses, covariances, body="base"))
    middles = np.array([part[:-1].mean(axis=0) for part in outlines.reshape(-1, 50, 2)])
    np.testing.assert_allclose(middles[:, 0], [*np.arange(2.0, 30, 2), 30], atol=0.05)
    still = Trajectory(np.arange(5.0), np.tile(np.eye(4), (5, 1, 1)), covariances[:5], body="base")
    assert len(ellipses_m(still)) == 50
    assert len(ellipses_m(still.select(slice(0, 0)))) == 0


def test_with_joined_sensors_all_paths_begin_at_the_true_start() -> None:
    records = joined_runs()
    paths = overlay_of(records)
    assert (paths.by, set(paths.paths_m)) == ("true start", {"wheels", "dense", "joined"})
    np.testing.assert_allclose(paths.paths_m["joined"][0], not_none(paths.truth_m)[0], atol=1e-9)
    np.testing.assert_allclose(paths.paths_m["wheels"][0], not_none(paths.truth_m)[0], atol=1e-9)
    found = consistency(records[2].estimate, not_none(records[2].ground_truth))
    expected = records[2].estimate.moved(found.T_truth_estimate)
    np.testing.assert_allclose(not_none(paths.trajectories["joined"].covariances), not_none(expected.covariances))


def test_joined_sensors_stand_out_and_the_legend_turns_ellipses_on() -> None:
    figure = overlay_figure(overlay_of(joined_runs()))
    names = [t.name for t in figure.data]
    assert trace(figure, "3σ of joined").visible is None
    assert trace(figure, "3σ of wheels").visible == "legendonly"
    assert "3σ of dense" not in names  # it states none
    widths = {name: trace(figure, name).line.width for name in ("wheels", "dense", "joined")}
    assert widths["joined"] > widths["wheels"] == widths["dense"]
    assert names.index("joined") > max(names.index("wheels"), names.index("dense"))


def test_errors_and_bands_share_the_time_axis() -> None:
    run = joined_run(boldness=4)
    found = not_none(facts_of(run).consistency)
    figure = trust_figure(run, found)
    errors = [t for t in figure.data if t.name == "error"]
    for axis, drawn in enumerate(errors):
        np.testing.assert_allclose(drawn.x, found.stamps_s - run.frames[0].stamp_s)
        np.testing.assert_array_equal(drawn.y, found.errors_m[:, axis])
    beyond = next(t for t in figure.data if t.name == "beyond 3σ")
    np.testing.assert_array_equal(~np.isnan(np.asarray(beyond.y, float)), ~found.is_within)
    np.testing.assert_allclose(spans(trace(figure, "coasting")), [[4.0, 5.6]], atol=1e-5)
    assert trace(figure, "coasting").line.color == STATUS_COLOURS["coasting"]
    np.testing.assert_allclose(spans(trace(figure, "slip")), [[8.0, 8.8]], atol=1e-5)
    assert trace(figure, "slip").line.width < trace(figure, "coasting").line.width
    assert "degenerate" not in [t.name for t in figure.data]
    assert {t.xaxis for t in figure.data} == {"x", "x2", "x3"}
    assert figure.layout.xaxis.matches == figure.layout.xaxis2.matches == "x3"


def test_the_band_is_three_sigma_along_each_direction() -> None:
    run = joined_run()
    found = not_none(facts_of(run).consistency)
    bands = [t for t in trust_figure(run, found).data if t.name == "±3σ as stated"]
    for axis, band in enumerate(bands):
        sigmas_m = np.sqrt(found.covariances_m2[:, axis, axis])
        assert np.nanmax(band.y) == pytest.approx(3 * sigmas_m.max())
        assert np.nanmin(band.y) == pytest.approx(-3 * sigmas_m.max())


def test_without_a_truth_three_sigma_stands_alone() -> None:
    run = joined_run(with_truth=False)
    figure = trust_figure(run, None)
    assert "error" not in [t.name for t in figure.data]
    assert [a.text for a in figure.layout.annotations] == ["±3σ ahead, m", "±3σ to the left, m"]
    page = Page(render_comparison(joined_runs(with_truth=False)))
    assert "Without a truth, whether that is honest cannot be said." in page.text
    assert "Joined: followed in every frame, without a truth to compare with" in page.text
    assert page.tiles["ATE, joined"] == ("unknown", "not evaluated")
    assert {"3σ at the end", "With a pose, wheels"} <= set(page.tiles)
    assert "ATE, wheels" not in page.tiles


def test_the_joined_verdict_comes_first_and_says_what_it_is_worth() -> None:
    records = joined_runs()
    text = Page(render_comparison(records)).text
    joined = verdict_of(records[2], records)
    assert text.index(joined.phrase) < text.index("Joined: 160 of 160 frames") < text.index("Wheels: 798 of 800")
    found, best_alone = not_none(facts_of(records[2]).consistency), not_none(best_alone_of(records))
    assert joined.phrase.endswith(f"{words.number(best_alone.ratio, 2)} times the error of {best_alone.odometry} alone")
    said = " ".join(joined.sentences)
    assert "It coasted on the wheels once, for 1.60 s in all (10 % of the time)" in said
    assert "The wheels were held to slip in 5 % of the time." in said
    assert "Wheels and camera contradicted each other in 1.9 % of the time" in said
    assert "The images showed all directions of motion." in said
    assert f"ends {words.length(found.drift_m)} off, {words.percent(found.drift_share)} of the way" in said
    assert f"within its stated 3σ in {words.percent(found.share)} of the time" in said


@pytest.mark.slow
def test_a_run_whose_sensors_contradict_each_other_is_red_at_the_top_of_the_page() -> None:
    wheels, dense, joined = joined_runs()
    slipping = tuple(replace(f, flags=("slip",)) if i % 3 == 0 else f for i, f in enumerate(joined.frames))
    slip = words.percent(facts_of(replace(joined, frames=slipping)).flag_shares["slip"])
    html = render_comparison([wheels, dense, replace(joined, frames=slipping)])
    assert '<section class="verdict red"' in html
    page = Page(html)
    assert f"Do not rely on it: slip in {slip} of the time" in page.text
    assert f"Bad: The wheels were held to slip in {slip} of the time. To do: if that was all along, cal" in page.text


def test_the_page_has_tiles_a_bold_row_and_the_map_of_joined_sensors() -> None:
    wheels, dense, joined = joined_runs(map=example_map())
    html = render_comparison([wheels, dense, replace(joined, map=example_map())])
    page = Page(html)
    assert len(page.ids) == len(set(page.ids))
    assert page.tiles["Coasting"] == ("1.60 s", "once, 1.60 s at most")
    assert page.tiles["Flagged: slip"] == ("5 %", "doubtful 1.9 %, degenerate never")
    assert {"Within its stated 3σ", "Off at the end", "ATE, wheels", "ATE, dense"} <= set(page.tiles)
    assert '<tr class="main"><th scope="row">joined</th>' in html
    assert {"plot-joined-trust", "plot-joined-map-plan", "plot-joined-matches", "plot-overlay"} <= set(page.plots)
    assert "plot-joined-status" not in page.plots
    assert html.index('id="path"') < html.index('id="joined-trust"') < html.index('id="errors"')
    assert "Joined: 16 used frames gave no motion, so that the wheels led there: too little depth (16)." in page.text


def test_joined_sensors_without_any_pose_are_a_page_too() -> None:
    wheels, dense, _ = joined_runs()
    nothing = replace(empty_run(), odometry="joined")
    page = Page(render_comparison([wheels, dense, nothing]))
    assert "Do not rely on it: no pose was found" in page.text
    assert "plot-joined-status" in page.plots
    assert facts_of(replace(nothing, frames=())).flag_shares == {"slip": 0, "doubtful": 0, "degenerate": 0}
    render_comparison([wheels, dense, replace(nothing, frames=())])


def test_of_a_filter_that_knows_no_flags_none_are_reported() -> None:
    run = joined_run(config={"odometry": ["wheels", "dense"], "fusion": {"filter": "ligocki"}})
    facts = facts_of(run)
    assert facts.flag_shares == {}
    assert not {"slip", "doubtful", "degenerate"} & {found.about for found in verdict_of(run).findings}
    assert "Flagged: slip" not in Page(render_comparison([*joined_runs()[:2], run])).tiles

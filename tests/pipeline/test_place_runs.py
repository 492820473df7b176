from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from area_drive import AREAS, T_WORLD_START, area_drive, area_recording, by_areas, calibration
from pipeline.made import OF_JOINED, OF_ONE, metrics_in, names_in, status_in
from places.made import trained
from stand_ins import MemoryRecording

from wheelsight.app.run import RectificationRecord, RunRecord
from wheelsight.app.runs import run, run_each
from wheelsight.config import load_config
from wheelsight.core.areas import Area, AreaMap, save_areas
from wheelsight.core.errors import AreaError, InputError, PlaceError
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight_papers import read_labels

pytestmark = pytest.mark.usefixtures("real_odometry")


def rectified(records: tuple[RunRecord, ...]) -> RectificationRecord:
    (found,) = (record.rectification for record in records if record.rectification is not None)
    return found


def shortened(recording: MemoryRecording, events: int = 120) -> MemoryRecording:
    return replace(recording, given=recording.given[:events])


def test_wheels_are_followed_alone_and_rectified(tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = by_areas(tmp_path)
    records = run_each(area_recording(tmp_path), config, out)
    assert [record.odometry for record in records] == ["wheels", "rectified"]
    assert names_in(out) == {"wheels", "rectified", "metrics.json", "config.yaml", "report.html"}
    assert names_in(out / "rectified") == OF_ONE | {"areas.csv"}
    assert load_config(out / "config.yaml") == config
    run(area_recording(tmp_path), load_config(overrides={"odometry": "wheels"}), tmp_path / "alone")
    alone, beside = ((tmp_path / place / "trajectory.txt").read_bytes() for place in ("alone", "out/wheels"))
    assert alone == beside
    written = read_tum(out / "rectified" / "trajectory.txt")
    assert (written.frame, written.body) == ("map", "base")
    readings = sum(isinstance(event, WheelTicks) for event in area_drive().events)
    assert len(written) == readings + len(area_drive().frames)


@pytest.mark.slow
def test_beside_a_camera_they_are_rectified_and_joined(tmp_path: Path) -> None:
    given = {"odometry": "wheels,features", "places.model": by_areas(tmp_path).places.model}
    out, config = tmp_path / "out", load_config(overrides=given)
    records = run_each(area_recording(tmp_path), config, out)
    assert [record.odometry for record in records] == ["wheels", "features", "rectified", "joined"]
    assert names_in(out / "joined") == OF_JOINED
    wheels, joined = records[0].estimate, records[3].estimate
    assert (joined.frame, joined.body) == ("map", "base")
    np.testing.assert_allclose(joined.T_frame_body[0], T_WORLD_START, atol=1e-9)
    end, T_odom_end = area_drive().truth.stamps_s[-1:], area_drive().truth.T_frame_body[-1]
    off_m = [np.hypot(*(path.at(end)[0] - T_odom_end)[:2, 3]) for path in (wheels.moved(T_WORLD_START), joined)]
    assert off_m[1] < 0.3 * off_m[0]
    assert {"name the area", "measure by the area"} <= metrics_in(out / "joined")["timing"]["stages_median_ms"].keys()


def test_errors_in_the_world_are_of_paths_where_they_say_they_are(tmp_path: Path) -> None:
    records = run_each(area_recording(tmp_path), by_areas(tmp_path), tmp_path / "out")
    errors = rectified(records).errors
    assert errors is not None
    by_name = {record.odometry: record.estimate for record in records}
    frames_s = np.array([frame.stamp_s for frame in area_drive().frames])
    frames_s = frames_s[frames_s <= by_name["wheels"].stamps_s[-1]]
    true_xy = area_drive().truth.at(frames_s)[:, :2, 3]
    wheels_xy = by_name["wheels"].moved(T_WORLD_START).at(frames_s)[:, :2, 3]
    np.testing.assert_allclose(errors.wheels_m, np.hypot(*(wheels_xy - true_xy).T), atol=2e-3)
    rectified_xy = by_name["rectified"].at(frames_s)[:, :2, 3]
    np.testing.assert_allclose(errors.rectified_m, np.hypot(*(rectified_xy - true_xy).T), atol=1e-9)
    assert errors.left < 0.5
    figures = metrics_in(tmp_path / "out")["odometry"]["rectified"]["rectification"]
    assert figures["map_error_m"]["wheels"]["mean"] == errors.wheels.mean
    assert figures["share_of_mean_error_left"] == pytest.approx(errors.rectified.mean / errors.wheels.mean)
    assert figures["model_accuracy"] > 0.9


def test_each_frame_is_listed_with_what_it_said(tmp_path: Path) -> None:
    records = run_each(area_recording(tmp_path), by_areas(tmp_path), tmp_path / "out")
    frames = area_drive().frames
    path = tmp_path / "out" / "rectified" / "areas.csv"
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(frames) == len(status_in(tmp_path / "out" / "rectified"))
    match = trained().predict(frames[7])
    assert [float(rows[7][f"p({name})"]) for name in AREAS.names] == pytest.approx(match.probabilities, abs=1e-4)
    assert sum(float(rows[7][f"belief({name})"]) for name in AREAS.names) <= 1.001
    assert 0 <= float(rows[7]["trust"]) <= 1
    stamps_s = [frame.stamp_s for frame in frames]
    labels = read_labels(path).of_frames(stamps_s, AREAS.names)
    assert (labels[labels >= 0] == rectified(records).true_areas[labels >= 0]).mean() > 0.9  # type: ignore[index]


def test_the_papers_way_has_neither_belief_nor_trust(tmp_path: Path) -> None:
    records = run_each(shortened(area_recording(tmp_path)), by_areas(tmp_path, rectify="paper"), tmp_path / "out")
    found = rectified(records)
    assert (found.way, found.belief) == ("paper", None)
    assert np.isnan(found.trust).all()
    assert records[1].estimate.covariances is None
    figures = metrics_in(tmp_path / "out" / "rectified")["rectification"]
    assert (figures["belief_accuracy"], figures["lowest_trust"]) == (None, None)


@pytest.mark.usefixtures("drawn_pages")
def test_a_start_taken_from_the_truth_is_reported(tmp_path: Path) -> None:
    records = run_each(shortened(area_recording(tmp_path)), by_areas(tmp_path), tmp_path / "out")
    assert any("taken from the ground truth" in warning for warning in records[1].warnings)
    np.testing.assert_allclose(records[1].estimate.T_frame_body[0], T_WORLD_START, atol=1e-9)
    given = run_each(shortened(area_recording(tmp_path)), by_areas(tmp_path, start="1,0.5,90"), tmp_path / "given")
    np.testing.assert_allclose(given[1].estimate.T_frame_body[0], se3.from_plane(1, 0.5, np.pi / 2), atol=1e-9)
    assert given[1].warnings == ()
    page = (tmp_path / "given" / "report.html").read_text()
    assert "The start is the one that was given: x 1.00 m, y 0.50 m, yaw 90.0°." in page


def test_the_path_begins_where_the_truth_does(tmp_path: Path) -> None:
    recording = shortened(area_recording(tmp_path), 300)
    truth = area_drive().truth.select(slice(40, None))
    records = run_each(replace(recording, ground_truth=truth), by_areas(tmp_path), tmp_path / "out")
    wheels, path = rectified(records).wheels, records[1].estimate
    for trajectory in (wheels, path):
        assert trajectory.stamps_s[0] == pytest.approx(truth.stamps_s[0], abs=2e-3)
        np.testing.assert_allclose(trajectory.T_frame_body[0], truth.T_frame_body[0], atol=0.01)


def test_without_truth_a_given_start_serves(tmp_path: Path) -> None:
    recording = shortened(area_recording(tmp_path, with_truth=False))
    records = run_each(recording, by_areas(tmp_path, start="0.5,0,0"), tmp_path / "out")
    assert rectified(records).errors is None
    assert rectified(records).true_areas is None
    figures = metrics_in(tmp_path / "out" / "rectified")["rectification"]
    assert (figures["map_error_m"], figures["model_accuracy"]) == (None, None)


def test_frames_that_measure_nothing_are_reported_and_keep_their_pose(tmp_path: Path) -> None:
    recording = shortened(area_recording(tmp_path), 300)
    events = list(recording.given)
    places = [i for i, event in enumerate(events) if isinstance(event, RgbdFrame)]
    first, second = events[places[5]], events[places[6]]
    assert isinstance(first, RgbdFrame)
    assert isinstance(second, RgbdFrame)
    events[places[5]] = replace(first, depth_m=np.zeros_like(first.depth_m))
    events[places[6]] = SkippedFrame(second.stamp_s, "depth/6.png: image is cut off", second.index)
    records = run_each(replace(recording, given=events), by_areas(tmp_path), tmp_path / "out")
    rows = status_in(tmp_path / "out" / "rectified")
    assert {row["status"] for row in rows} == {"tracking"}
    assert rows[5]["note"] == "no measurement: the frame has no depth"
    assert rows[6]["note"] == "no measurement: depth/6.png: image is cut off"
    assert np.isnan(rectified(records).forest[[5, 6]]).all()
    assert np.isfinite(np.delete(rectified(records).forest, [5, 6], axis=0)).all()
    metrics = metrics_in(tmp_path / "out" / "rectified")
    assert metrics["rectification"]["frames_without_measurement"] == 2
    assert (metrics["frames"]["with_pose"], metrics["frames"]["listed"]) == (len(places), len(places))


def test_wheels_with_a_delay_tell_a_path_in_order_of_time(tmp_path: Path) -> None:
    recording = shortened(area_recording(tmp_path), 300)
    wheels = recording.calibration.wheels
    assert wheels is not None
    late = replace(recording, calibration=replace(recording.calibration, wheels=replace(wheels, delay_s=0.05)))
    records = run_each(late, by_areas(tmp_path), tmp_path / "out")
    assert (np.diff(records[1].estimate.stamps_s) > 0).all()
    assert len(status_in(tmp_path / "out" / "rectified")) == late.frame_count


def refusal(recording: MemoryRecording, folder: Path, **places: object) -> str:
    """What is said of a run that cannot be, which must leave nothing."""
    with pytest.raises(InputError) as refused:
        run_each(recording, by_areas(folder, **places), folder / "out")
    assert not (folder / "out").exists()
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_what_cannot_be_rectified_is_refused_in_one_line(tmp_path: Path) -> None:
    recording = area_recording(tmp_path)
    blind = replace(recording, given=[event for event in recording.given if isinstance(event, WheelTicks)])
    assert "has no images that could show places" in refusal(blind, tmp_path)
    assert "no ground truth (give --start" in refusal(area_recording(tmp_path, with_truth=False), tmp_path)
    camera_truth = Trajectory(area_drive().truth.stamps_s, area_drive().truth.T_frame_body)
    nowhere = replace(recording, ground_truth=camera_truth, calibration=replace(calibration(), T_base_camera=None))
    assert "cannot be converted to 'base' (give --start" in refusal(nowhere, tmp_path)
    earlier = Trajectory(area_drive().truth.stamps_s[:2] - 10, area_drive().truth.T_frame_body[:2], body="base")
    said = refusal(replace(recording, ground_truth=earlier), tmp_path)
    assert "no ground truth at 1000.000 s (give --start" in said
    (tmp_path / "areas.yaml").unlink()
    assert refusal(recording, tmp_path).endswith("the recording has no areas.yaml (give --areas FILE)")


def test_another_cameras_images_are_refused_beforehand(tmp_path: Path) -> None:
    recording = area_recording(tmp_path)
    larger = PinholeCamera(64, 48, 52.0, 52.0, 31.5, 23.5)
    other = replace(recording, calibration=replace(calibration(), color=larger, depth=larger))
    said = refusal(other, tmp_path)
    assert "images are 64x48 with depth 64x48; the model was trained on 32x24 with depth 32x24" in said


def test_a_frame_of_another_size_breaks_the_run_off_and_keeps_what_was(tmp_path: Path) -> None:
    recording = shortened(area_recording(tmp_path), 300)
    events = list(recording.given)
    place = [i for i, event in enumerate(events) if isinstance(event, RgbdFrame)][20]
    frame = events[place]
    assert isinstance(frame, RgbdFrame)
    events[place] = replace(frame, color=frame.color[:-2], depth_m=frame.depth_m[:-2])
    with pytest.raises(PlaceError, match=r"frame 20 at .* is 32x22 with depth 32x22"):
        run_each(replace(recording, given=events), by_areas(tmp_path), tmp_path / "out")
    assert metrics_in(tmp_path / "out")["interrupted"]
    assert len(status_in(tmp_path / "out" / "rectified")) == 20


def test_models_and_areas_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    recording = area_recording(tmp_path)
    others = AreaMap((*list(AREAS)[:2], Area("cellar", np.array([[-2.0, 10], [20, 10], [20, 13], [-2, 13]]), y_m=11.0)))
    save_areas(others, tmp_path / "others.yaml")
    with pytest.raises(PlaceError, match=r"three.places: the model has no area 'cellar'"):
        run_each(recording, by_areas(tmp_path, areas=str(tmp_path / "others.yaml")), tmp_path / "out")
    with pytest.raises(AreaError, match=r"none.yaml: cannot be read"):
        run_each(recording, by_areas(tmp_path, areas=str(tmp_path / "none.yaml")), tmp_path / "out")
    (tmp_path / "text.places").write_text("hello")
    with pytest.raises(PlaceError, match=r"text.places: is no model of places"):
        run_each(recording, by_areas(tmp_path, model=str(tmp_path / "text.places")), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_run_answers_with_the_rectified_wheels(tmp_path: Path) -> None:
    source, config = shortened(area_recording(tmp_path)), by_areas(tmp_path)
    record, each = run(source, config, tmp_path / "out"), run_each(source, config, tmp_path / "each")
    assert [one.odometry for one in each] == ["wheels", "rectified"]
    assert record.odometry == "rectified"
    np.testing.assert_array_equal(record.estimate.T_frame_body, each[-1].estimate.T_frame_body)


def test_rectified_results_do_not_outlive_a_run_without_places(tmp_path: Path) -> None:
    recording = shortened(area_recording(tmp_path))
    run_each(recording, by_areas(tmp_path), tmp_path / "out")
    run_each(recording, load_config(overrides={"odometry": "wheels"}), tmp_path / "out", force=True)
    assert not (tmp_path / "out" / "rectified").exists()

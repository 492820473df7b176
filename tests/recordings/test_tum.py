from __future__ import annotations

import shutil

import numpy as np
import pytest
from narrowing import as_frame, not_none
from synthetic import make_tum_recording, render_room, wobbling_trajectory

from wheelsight.core.errors import CalibrationError, ConfigError, RecordingError
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import OpenOptions, Recording, load_camera, open_recording


def test_reads_what_was_rendered(tum_folder, small_camera):
    recording = open_recording(tum_folder)
    truth = wobbling_trajectory(6)
    assert isinstance(recording, Recording)
    assert (recording.format, recording.name, recording.body) == ("tum", "sound", "camera")
    assert recording.frame_count == 6
    assert recording.warnings == ()
    assert recording.calibration.color == small_camera
    assert recording.association.pairs == 6
    assert recording.association.largest_gap_s == pytest.approx(0.002)
    np.testing.assert_allclose(not_none(recording.ground_truth).T_frame_body, truth.T_frame_body, atol=1e-8)
    events = list(recording.events())
    for index, (event, (stamp_s, T_frame_camera)) in enumerate(zip(events, truth, strict=True)):
        color, depth_m = render_room(T_frame_camera, small_camera)
        assert isinstance(event, RgbdFrame)
        assert event.index == index
        assert event.stamp_s == pytest.approx(stamp_s, abs=1e-6)
        assert (event.color.dtype, event.depth_m.dtype) == (np.dtype(np.uint8), np.dtype(np.float32))
        np.testing.assert_array_equal(event.color, color)
        np.testing.assert_allclose(event.depth_m, depth_m, atol=0.6 / 5000)


def test_events_start_again_and_share_no_memory(tum_folder):
    recording = open_recording(tum_folder)
    first, again = list(recording.events()), list(recording.events())
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(as_frame(a).depth_m, as_frame(b).depth_m)
        assert not np.shares_memory(as_frame(a).depth_m, as_frame(b).depth_m)
    assert not np.shares_memory(as_frame(first[0]).color, as_frame(first[1]).color)


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("rgbd_dataset_freiburg1_desk", "freiburg1"),
        ("freiburg2_xyz", "freiburg2"),
        ("FR3-office", "freiburg3"),
        ("my_fr1_part", "freiburg1"),
    ],
)
def test_the_folder_name_shows_the_camera(tmp_path, name, camera):
    folder = tmp_path / name
    make_tum_recording(folder, frames=1, camera=not_none(load_camera(camera).color))
    (folder / "calibration.yaml").unlink()
    assert open_recording(folder).calibration.source == load_camera(camera).source


@pytest.mark.parametrize("name", ["desk", "freiburg4_room", "afr1ca", "fr12", "freiburg1_and_freiburg2"])
def test_no_camera_is_ever_guessed(tum_folder, name):
    (tum_folder / "calibration.yaml").unlink()
    folder = tum_folder.rename(tum_folder.parent / name)
    with pytest.raises(
        CalibrationError,
        match=r"--camera: bonn, freiburg1, freiburg2, freiburg3, icl_nuim, redwood, seven_scenes, or a",
    ):
        open_recording(folder)


def test_the_camera_asked_for_wins_by_name_and_by_file(tum_folder, small_camera):
    elsewhere = shutil.move(tum_folder / "calibration.yaml", tum_folder.parent / "mine.yaml")
    assert open_recording(tum_folder, OpenOptions(camera=str(elsewhere))).calibration.color == small_camera
    with pytest.raises(RecordingError, match="colour image is 64×48, the calibration's 640×480"):
        open_recording(tum_folder, OpenOptions(camera="freiburg3"))
    with pytest.raises(CalibrationError, match="no camera is called 'kinect'"):
        open_recording(tum_folder, OpenOptions(camera="kinect"))


@pytest.mark.parametrize("depth_first", [False, True])
def test_ready_associations_are_used_as_they_are(tum_folder, depth_first):
    rgb, depth = ((tum_folder / f"{name}.txt").read_text().splitlines()[1:] for name in ("rgb", "depth"))
    pairs = [(rgb[0], depth[1]), (rgb[2], depth[2])]
    lines = [f"{b} {a}" if depth_first else f"{a} {b}" for a, b in pairs]
    (tum_folder / "associations.txt").write_text("# ready\n" + "\n".join(lines) + "\n")
    recording = open_recording(tum_folder)
    assert recording.frame_count == 2
    assert recording.association.largest_gap_s == pytest.approx(1 / 30 + 0.002, abs=1e-5)
    assert recording.association.dropped_color == 4
    assert "associations.txt" in recording.warnings[0]
    _, second_depth = render_room(wobbling_trajectory(6).T_frame_body[1], not_none(recording.calibration.color))
    np.testing.assert_allclose(as_frame(next(recording.events())).depth_m, second_depth, atol=1e-3)


def test_a_broken_associations_file_is_named(tum_folder):
    (tum_folder / "associations.txt").write_text("1.0 rgb/1.png 1.0\n")
    with pytest.raises(RecordingError, match=r"associations.txt:1: `stamp color-file"):
        open_recording(tum_folder)


def test_pairs_and_drops_are_counted(tum_folder):
    depth = (tum_folder / "depth.txt").read_text().splitlines()
    (tum_folder / "depth.txt").write_text("\n".join(depth[:3] + depth[4:]) + "\n")
    association = open_recording(tum_folder).association
    assert (association.pairs, association.dropped_color, association.dropped_depth) == (5, 1, 0)


def test_no_pairs_shows_the_nearest_gap(tum_folder):
    with pytest.raises(
        RecordingError, match=r"rgb.txt: no depth image lies within 0.001 s .* 0.002 s apart .*--max-gap"
    ):
        open_recording(tum_folder, OpenOptions(max_gap_s=0.001))


def test_the_depth_factor_can_be_given(tum_folder):
    usual, half = (next(open_recording(tum_folder, OpenOptions(depth_factor=f)).events()) for f in (5000, 10000))
    np.testing.assert_allclose(as_frame(half).depth_m, as_frame(usual).depth_m / 2, rtol=1e-6)


def test_truth_is_reported_for_the_base_where_there_is_one(tum_folder):
    text = (tum_folder / "calibration.yaml").read_text()
    plain = not_none(open_recording(tum_folder).ground_truth)
    mounted = "T_base_camera: [[0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.1], [0, 0, 0, 1]]\n"
    (tum_folder / "calibration.yaml").write_text(text + mounted)
    recording = open_recording(tum_folder)
    assert recording.body == not_none(recording.ground_truth).body == "base"
    back = not_none(recording.ground_truth).T_frame_body @ not_none(recording.calibration.T_base_camera)
    np.testing.assert_allclose(back, plain.T_frame_body, atol=1e-9)


@pytest.mark.parametrize("options", [{"max_gap_s": -1.0}, {"max_gap_s": np.nan}, {"depth_factor": 0.0}])
def test_impossible_options_are_refused(options):
    with pytest.raises(ConfigError, match=": Input should"):
        OpenOptions(**options)

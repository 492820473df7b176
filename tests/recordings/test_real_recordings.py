from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from grids import mostly_slow
from narrowing import as_frame
from stand_ins import MemoryRecording

from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import find_recordings, open_recording, write_recording

pytestmark = pytest.mark.data


@pytest.fixture
def freiburg(data_folder):
    return open_recording(data_folder / "rgbd" / "freiburg1_rpy_part")


@pytest.fixture
def kitchen(data_folder):
    return open_recording(data_folder / "rgbd" / "red_kitchen")


def test_finds_them_all(data_folder):
    paths = find_recordings(data_folder)
    names = [path.name for path in paths if "bags" not in path.parts]
    images = ["freiburg1_rpy_part", "openloris_sample", "red_kitchen", "rgbd_dataset_freiburg1_desk"]
    assert names == [*images, "corridor_864m", "mocap_floor", "skid_steer_run20"]
    bags = {path.name for path in paths if "bags" in path.parts}
    assert {"husky_outdoor_395s.bag", "jackal_61s.bag", "one_image.bag", "split", "compressed"} <= bags


def test_freiburg1(freiburg):
    assert (freiburg.format, freiburg.body, freiburg.frame_count) == ("tum", "camera", 255)
    association = freiburg.association
    assert (association.color_images, association.depth_images, association.pairs) == (255, 255, 255)
    assert 0.01 < association.largest_gap_s < 0.02
    assert freiburg.calibration.color.fx == 517.3
    assert freiburg.calibration.is_registered
    assert freiburg.warnings == ()
    frame = next(freiburg.events())
    assert frame.stamp_s == 1305031229.528748
    assert (frame.color.shape, frame.depth_m.shape) == ((480, 640, 3), (480, 640))
    assert 0.3 < np.median(frame.depth_m[frame.depth_m > 0]) < 5
    np.testing.assert_allclose(freiburg.ground_truth.positions_m[0], [1.3357, 0.6698, 1.6180])


def test_red_kitchen(kitchen):
    assert (kitchen.format, kitchen.body, kitchen.frame_count) == ("seven_scenes", "camera", 500)
    assert kitchen.calibration.depth.fx == 585
    assert not kitchen.calibration.is_registered
    assert len(kitchen.ground_truth) == 500
    assert se3.is_valid(kitchen.ground_truth.T_frame_body, tolerance=1e-9)
    frame = next(kitchen.events())
    assert frame.depth_m.max() < 10
    assert (frame.depth_m == 0).any()


@pytest.mark.parametrize("name", mostly_slow(["freiburg1_rpy_part", "red_kitchen"], quick=["freiburg1_rpy_part"]))
def test_each_frame_can_be_used(data_folder, name):
    recording = open_recording(data_folder / "rgbd" / name)
    stamps = [event.stamp_s for event in recording.events() if isinstance(event, RgbdFrame)]
    assert len(stamps) == recording.frame_count
    assert (np.diff(stamps) > 0).all()


def test_written_as_our_own_it_is_the_same(freiburg, tmp_path):
    part = MemoryRecording(list(islice(freiburg.events(), 3)), freiburg.ground_truth, freiburg.calibration)
    write_recording(tmp_path / "new", part)
    for got, wanted in zip(open_recording(tmp_path / "new").events(), part.events(), strict=True):
        np.testing.assert_array_equal(as_frame(got).color, as_frame(wanted).color)
        np.testing.assert_array_equal(as_frame(got).depth_m, as_frame(wanted).depth_m)

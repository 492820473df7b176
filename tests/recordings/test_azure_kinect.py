"""A real Azure Kinect's recording, and damaged ones; its lenses held against OpenCV's own projection."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from synthetic import undistorted_by_opencv

from benchmarks.fuzz_recordings import azure_kinect
from wheelsight.core.errors import CalibrationError, InputError, RecordingError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight.io.recordings.azure_kinect import KinectLens, KinectRegistration, read_lenses
from wheelsight.io.recordings.inspection import OffsetMeter


def lens(camera: PinholeCamera, coefficients: Any = (0.0,) * 8, T: Any = None) -> KinectLens:
    place = np.eye(4) if T is None else T
    return KinectLens(camera.K, np.array(coefficients, float), (camera.width, camera.height), 2.0, place)


@pytest.fixture
def document() -> Any:
    """As the device attaches it, of two plain lenses."""
    numbers = [0.5, 0.5, 0.49, 0.49, 0.5, -0.02, -0.003, 0.9, 0.09, -0.01, 0, 0, 1e-4, -2e-4]
    turned = {"Rotation": [1, 0, 0, 0, 0, 1, 0, -1, 0], "Translation": [-0.032, 0, 0]}
    still = {"Rotation": np.eye(3).ravel().tolist(), "Translation": [0, 0, 0]}

    def camera(place: str, size: tuple[int, int], Rt: Any) -> Any:
        model = {"ModelType": "CALIBRATION_LensDistortionModelBrownConrady", "ModelParameters": numbers}
        about = {"Location": f"CALIBRATION_CameraLocation{place}", "MetricRadius": 1.7, "Rt": Rt}
        return {"Intrinsics": model, "SensorWidth": size[0], "SensorHeight": size[1], **about}

    return {
        "CalibrationInformation": {"Cameras": [camera("D0", (1024, 1024), still), camera("PV0", (4096, 3072), turned)]}
    }


def test_modes_are_cut_out_of_the_sensor(document: Any) -> None:
    color, depth = read_lenses(document, "NFOV_UNBINNED", (1280, 720))
    # 0.5 of 1280 is the image's middle, from the first pixel's middle half a pixel less; 120 rows are cut off.
    np.testing.assert_allclose(color.K, np.array([[0.49 * 1280, 0, 639.5], [0, 0.49 * 960, 359.5], [0, 0, 1]]))
    np.testing.assert_allclose(depth.K, np.array([[0.49 * 1024, 0, 319.5], [0, 0.49 * 1024, 331.5], [0, 0, 1]]))
    assert (color.size, depth.size) == ((1280, 720), (640, 576))
    np.testing.assert_allclose(color.T_camera_device[:3, 3], [-0.032, 0, 0])
    np.testing.assert_allclose(color.coefficients, [0.5, -0.02, -2e-4, 1e-4, -0.003, 0.9, 0.09, -0.01])


def test_depth_falls_where_opencv_projects_it(rng: np.random.Generator) -> None:
    """Single points of a bent depth image, turned and moved, seen by the straightened colour camera."""
    coefficients = (0.5, -0.02, -2e-4, 1e-4, -0.003, 0.9, 0.09, -0.01)
    depth_camera = PinholeCamera(320, 288, 252.0, 252.0, 166.0, 174.0)
    color_camera = PinholeCamera(640, 360, 306.0, 306.0, 319.5, 182.0)
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.09, 0.01, -0.02]))[0]
    T[:3, 3] = (-0.032, -0.002, 0.004)
    subject = KinectRegistration(lens(color_camera, (0.1, 0, 0, 0, 0, 0, 0, 0), T), lens(depth_camera, coefficients))
    rows, columns = rng.integers(120, 230, 40), rng.integers(60, 260, 40)
    for row, column in zip(rows, columns, strict=True):
        depth_mm = np.zeros((288, 320), np.uint16)
        depth_mm[row, column] = 1500
        seen = subject.registered(depth_mm)
        px = np.array([[[column, row]]], float)
        xy = undistorted_by_opencv(px, depth_camera.K, np.array(coefficients)).reshape(2)
        p_depth = 1.5 * np.array([*xy, 1.0])
        expected = cv2.projectPoints(p_depth[None], cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], color_camera.K, None)[0]
        v, u = np.nonzero(seen)
        assert 1 <= len(v) <= 9  # a depth pixel is 1.2 of colour's
        np.testing.assert_allclose([u.mean(), v.mean()], expected.reshape(2), atol=0.8)
        z_m = (T[:3, :3] @ p_depth + T[:3, 3])[2]
        np.testing.assert_allclose(seen[v, u], z_m, atol=0.01)


def test_a_wall_has_no_holes_and_the_nearer_hides_the_farther() -> None:
    depth_camera = PinholeCamera(320, 288, 252.0, 252.0, 159.5, 143.5)
    color_camera = PinholeCamera(400, 300, 306.0, 306.0, 199.5, 149.5)
    T = np.eye(4)
    T[0, 3] = -0.032
    subject = KinectRegistration(lens(color_camera, T=T), lens(depth_camera))
    depth_mm = np.full((288, 320), 2000, np.uint16)
    depth_mm[:, 100:140] = 500
    seen = subject.registered(depth_mm)
    assert np.all(seen[20:280, 30:90] == 2.0)
    # 500 mm away, things lie 306 · 0.032 · (1 / 0.5 - 1 / 2) = 15 px to the left of where they hide at 2 m.
    front = np.flatnonzero(seen[150] == 0.5)
    expected = 306 / 252 * (np.array([100, 139]) - 159.5) - 306 * 0.032 / 0.5 + 199.5
    np.testing.assert_allclose([front[0], front[-1]], expected, atol=1.0)
    assert np.all(np.diff(front) == 1)


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (lambda d: d["CalibrationInformation"]["Cameras"].pop(), "PV0"),
        (
            lambda d: d["CalibrationInformation"]["Cameras"][0]["Intrinsics"].update(ModelType="other"),
            "lens model other",
        ),
        (lambda d: d["CalibrationInformation"]["Cameras"][0]["Rt"].update(Rotation=[0] * 9), "cannot be read"),
        (lambda d: d["CalibrationInformation"]["Cameras"][0].update(SensorWidth=512), "a sensor of 512"),
        (lambda d: d.clear(), "CalibrationInformation"),
    ],
)
def test_a_broken_calibration_is_refused_with_what_is_wrong(document: Any, spoil: Any, problem: str) -> None:
    broken = copy.deepcopy(document)
    spoil(broken)
    with pytest.raises(CalibrationError, match=problem):
        read_lenses(broken, "NFOV_UNBINNED", (1280, 720))


def test_modes_without_depth_are_refused(document: Any) -> None:
    with pytest.raises(CalibrationError, match=r"PASSIVE_IR measures no depth \(record NFOV_2X2BINNED"):
        read_lenses(document, "PASSIVE_IR", (1280, 720))
    with pytest.raises(CalibrationError, match="640×480 are none of the camera's"):
        read_lenses(document, "NFOV_UNBINNED", (640, 480))


@pytest.mark.data
class TestReal:
    @pytest.fixture
    def recorded(self, data_folder: Path) -> Path:
        pytest.importorskip("av", reason="needs PyAV (the extra mkv)")
        return data_folder / "bags" / "azure_kinect.mkv"

    def test_it_is_read_with_its_own_calibration(self, recorded: Path) -> None:
        recording = open_recording(recorded)
        assert (recording.format, recording.frame_count, recording.body) == ("azure_kinect", 1, "camera")
        assert recording.association.pairs == 1
        color, depth = recording.calibration.cameras
        assert color is depth
        assert (color.width, color.height) == (1280, 720)
        assert color.fx == pytest.approx(611.795, abs=1e-3)
        (frame,) = recording.events()
        assert isinstance(frame, RgbdFrame)
        assert frame.color.shape == (720, 1280, 3)
        assert frame.depth_m.shape == (720, 1280)
        assert frame.stamp_s == pytest.approx(0.463945)
        assert list(recording.events(images=False)) == []
        assert "gyroscope" in recording.warnings[0]

    def test_its_attachment_is_what_others_read_from_it(self, recorded: Path) -> None:
        lenses = read_lenses(
            json.loads((recorded.parent / "azure_kinect_calibration.json").read_text()), "NFOV_UNBINNED", (1280, 720)
        )
        own = open_recording(recorded).calibration.cameras[0]
        np.testing.assert_allclose(own.K, lenses[0].K)

    def test_edges_of_depth_lie_on_edges_of_colour(self, recorded: Path) -> None:
        (frame,) = open_recording(recorded).events()
        assert isinstance(frame, RgbdFrame)
        meter = OffsetMeter()
        meter.add(frame.color, frame.depth_m)
        offset = meter.offset()
        assert offset is not None
        assert not offset.is_clear
        assert np.hypot(*offset.shift_px) <= 8  # two of the steps that the search takes
        assert offset.scale == pytest.approx(1.0, abs=0.02)

    def test_of_a_file_that_is_cut_off_what_is_there_is_read(self, recorded: Path, tmp_path: Path) -> None:
        data = recorded.read_bytes()
        for share in (0.001, 0.3, 0.7):
            path = tmp_path / "cut.mkv"
            path.write_bytes(data[: int(share * len(data))])
            if share < 0.5:
                with pytest.raises(InputError, match=r"cut\.mkv"):
                    open_recording(path)
            else:
                recording = open_recording(path)
                assert len(list(recording.events())) == recording.frame_count

    def test_another_kind_of_matroska_is_refused(self, recorded: Path, tmp_path: Path) -> None:
        assert recorded.is_file()
        path = tmp_path / "other.mkv"
        path.write_bytes(b"no matroska at all")
        with pytest.raises(RecordingError, match="no Matroska file"):
            open_recording(path)

    def test_a_calibration_of_other_images_is_refused(self, recorded: Path) -> None:
        with pytest.raises(CalibrationError, match="undistorted colour"):
            open_recording(recorded, OpenOptions(camera="freiburg1"))


@pytest.fixture(scope="module")
def sound() -> bytes:
    return azure_kinect()


@pytest.mark.parametrize(("share", "frames"), [(0.9, 2), (0.5, 1)])
def test_a_file_that_is_cut_off_is_read_so_far_and_said_to_be(
    sound: bytes, tmp_path: Path, share: float, frames: int
) -> None:
    path = tmp_path / "a.mkv"
    path.write_bytes(sound[: int(share * len(sound))])
    recording = open_recording(path)
    assert recording.warnings == ("The file is cut off; what comes before is read.",)
    assert recording.frame_count == frames
    path.write_bytes(sound)
    assert open_recording(path).warnings == ()


def test_a_file_that_is_cut_off_before_its_depth_says_that(sound: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    path.write_bytes(sound[: len(sound) // 20])
    with pytest.raises(RecordingError, match="is cut off before the first pair of images"):
        open_recording(path)


def test_images_of_one_time_are_one_frame(sound: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    path.write_bytes(sound + sound)
    frames = list(open_recording(path).events())
    stamps_s = [frame.stamp_s for frame in frames]
    assert len(frames) == 3
    assert stamps_s == sorted(set(stamps_s))


@pytest.mark.parametrize("codec", [b"V_MJPEG", b"V_MS/VFW/FOURCC"])
def test_a_codec_that_is_not_known_is_named(sound: bytes, tmp_path: Path, codec: bytes) -> None:
    path = tmp_path / "a.mkv"
    assert codec in sound
    path.write_bytes(sound.replace(codec, b"V_" + b"X" * (len(codec) - 2)))
    with pytest.raises(RecordingError, match=r"a\.mkv: its stream (COLOR|DEPTH) has an unknown codec"):
        open_recording(path)


def test_a_list_of_other_files_is_not_followed(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    path.write_text("ffconcat version 1.0\nfile /dev/zero\n")
    with pytest.raises(RecordingError, match="is no Matroska file"):
        open_recording(path)


def test_an_image_larger_than_any_camera_has_is_not_decoded(sound: bytes, tmp_path: Path) -> None:
    """Its JPEG says another size than its stream does."""
    path = tmp_path / "a.mkv"
    frame_header = b"\xff\xc0\x00\x11\x08" + (720).to_bytes(2) + (1280).to_bytes(2)
    assert sound.count(frame_header) == 3
    path.write_bytes(sound.replace(frame_header, frame_header[:5] + b"\xff\xdc\xff\xdc"))
    skipped = list(open_recording(path).events())
    assert [getattr(event, "reason", None) for event in skipped] == ["colour image is damaged"] * 3


@pytest.mark.parametrize("value", [0, -1, "x", None, 1e300, [], {}])
@pytest.mark.parametrize("field", ["SensorHeight", "MetricRadius", "Intrinsics", "Rt"])
def test_any_other_value_in_a_calibration_is_refused_or_read(document: Any, field: str, value: Any) -> None:
    document["CalibrationInformation"]["Cameras"][0][field] = value
    if field == "MetricRadius" and value in (0, 1e300):  # no limit
        assert read_lenses(document, "NFOV_UNBINNED", (1280, 720))[1].reach > 1e200
        return
    with pytest.raises(CalibrationError, match="its calibration cannot be read"):
        read_lenses(document, "NFOV_UNBINNED", (1280, 720))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e300, -0.5])
def test_focal_lengths_that_are_none_are_refused(document: Any, value: float) -> None:
    document["CalibrationInformation"]["Cameras"][0]["Intrinsics"]["ModelParameters"][2] = value
    with pytest.raises(CalibrationError, match="implausible for a lens"):
        read_lenses(document, "NFOV_UNBINNED", (1280, 720))

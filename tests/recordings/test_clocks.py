"""What a recording's stamps say, from the lists alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from room_drive import make_room_drive
from synthetic import make_tum_recording

from wheelsight.app.run import in_real_time
from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.errors import ConfigError, InputError, RecordingError
from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight.io.recordings.clock_checks import (
    FRAMES,
    TRUTH,
    WHEELS,
    apart,
    listed_stamps,
    refuse_if_apart,
    stamp_warnings,
)
from wheelsight_calibration.base import calibrate_base

APART = "share 0.0 s: their clocks count from different moments"
LISTS, READINGS = ("rgb.txt", "depth.txt"), ("wheels.csv",)


def restamp(folder: Path, names: tuple[str, ...], change: Callable[[float], float]) -> None:
    """The first number of each line of these files changed."""
    for name in names:
        path, separator = folder / name, "," if name.endswith(".csv") else " "
        lines = []
        for line in path.read_text().splitlines():
            stamp, rest = line.split(separator, 1)
            is_number = stamp.replace(".", "").isdigit()
            lines.append(f"{change(float(stamp)):.6f}{separator}{rest}" if is_number else line)
        path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    make_room_drive(tmp_path / "drive", frames=3)
    return tmp_path / "drive"


def test_a_sound_drive_has_nothing_to_tell(drive: Path) -> None:
    recording = open_recording(drive)
    assert recording.warnings == ()
    stamps = listed_stamps(recording)
    assert (len(stamps[FRAMES]), len(stamps[WHEELS])) == (recording.frame_count, recording.wheel_count)
    refuse_if_apart(recording)


@pytest.mark.parametrize(
    ("names", "change", "reported"),
    [
        (READINGS, lambda stamp_s: stamp_s + 1.6e9, ()),
        (LISTS, lambda stamp_s: stamp_s + 18.0, ()),
        (LISTS, lambda stamp_s: 1e3 * (1.6e9 + stamp_s), ("The frames' stamps", "milliseconds", "--rate-hz 1000")),
        (READINGS, lambda stamp_s: 1e9 * (1.6e9 + stamp_s), ("The wheels' stamps", "nanoseconds", "1000000000")),
    ],
    ids=["boot and epoch", "18 s", "frames in ms", "wheels in ns"],
)
def test_clocks_apart_are_reported_and_refused_before_any_work(
    drive: Path, tmp_path: Path, names: tuple[str, ...], change: Callable[[float], float], reported: tuple[str, ...]
) -> None:
    restamp(drive, names, change)
    recording = open_recording(drive)
    assert any(APART in warning for warning in recording.warnings)
    assert not reported or any(all(word in warning for word in reported) for warning in recording.warnings)
    for odometry in ("wheels,features", "wheels,dense"):
        with pytest.raises(RecordingError, match=APART) as refused:
            run_each(recording, load_config(overrides={"odometry": odometry}), tmp_path / "out")
        assert all(word in f"{refused.value} The" for word in reported[1:])
    with in_real_time(recording) as live, pytest.raises(RecordingError, match=APART):
        run_each(live, load_config(overrides={"odometry": "wheels,features"}), tmp_path / "out")
    with pytest.raises(RecordingError, match=APART):
        calibrate_base(recording)
    assert not (tmp_path / "out").exists()
    alone = load_config(overrides={"odometry": "wheels,features", "fusion": "none"})
    if not reported:
        assert len(run_each(recording, alone, tmp_path / "out")) == 2
        return
    with pytest.raises(RecordingError, match=f"{reported[0]} .* look like {reported[1]}, not seconds .*{reported[2]}"):
        run_each(recording, alone, tmp_path / "out")
    sound = "features" if names is READINGS else "wheels"
    assert len(run_each(recording, load_config(overrides={"odometry": sound}), tmp_path / "out")) == 1


def test_streams_that_share_little_are_reported_of() -> None:
    reported = stamp_warnings({WHEELS: np.arange(0.0, 10.0, 0.02), FRAMES: np.arange(7.0, 17.0, 0.2)})
    assert len(reported) == 1
    assert "share only 3.0 s" in reported[0]
    assert not stamp_warnings({WHEELS: np.arange(0.0, 10.0, 0.02), FRAMES: np.arange(3.0, 13.0, 0.2)})


def test_a_clock_that_leaps_is_reported_of_once_for_each_stream() -> None:
    stamps_s = np.arange(0.0, 10.0, 0.1)
    leaping_s = stamps_s + 60.0 * (stamps_s >= 8.0)
    reported = stamp_warnings({FRAMES: leaping_s, WHEELS: leaping_s})
    assert [warning.split(":")[0] for warning in reported] == [
        "The frames' stamps leap by 60.1 s after 7.900 s",
        "The wheels' stamps leap by 60.1 s after 7.900 s",
    ]
    assert not stamp_warnings({FRAMES: stamps_s + 5.0 * (stamps_s >= 8.0)})
    assert not stamp_warnings({FRAMES: 20.0 * np.arange(3.0)})


@pytest.mark.parametrize("beside", [WHEELS, TRUTH])
def test_one_frame_a_second_is_no_number_where_others_last_as_long(beside: str) -> None:
    whole_s = np.arange(12.0)
    assert not stamp_warnings({FRAMES: whole_s, beside: np.arange(0.0, 12.0, 0.02)})
    (reported,) = stamp_warnings({FRAMES: whole_s, beside: np.arange(0.0, 12.0, 0.02) / 5})[:1]
    assert "look like numbers of frames" in reported


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (lambda stamp_s: 1e9 * round(stamp_s - 0.001, 6), "the frames' stamps like nanoseconds (--rate-hz 1000000000)"),
        (lambda stamp_s: 1e3 * stamp_s, "the frames' stamps like milliseconds (--rate-hz 1000)"),
        (lambda stamp_s: round(stamp_s / 0.08), "the frames' stamps like numbers of frames (give the camera's rate"),
    ],
)
def test_frames_that_begin_with_the_wheels_in_another_unit_are_not_joined(
    drive: Path, tmp_path: Path, change: Callable[[float], float], reported: str
) -> None:
    first_s = float(listed_stamps(open_recording(drive))[WHEELS][0])
    restamp(drive, READINGS, lambda stamp_s: stamp_s - first_s)
    restamp(drive, LISTS, lambda stamp_s: change(stamp_s - first_s))
    (drive / "groundtruth_base.txt").unlink()
    with pytest.raises(RecordingError, match="do not count one unit") as refused:
        run_each(open_recording(drive), load_config(overrides={"odometry": "wheels,features"}), tmp_path / "out")
    assert reported in str(refused.value)


def test_one_frame_among_the_readings_is_not_apart() -> None:
    assert apart((0.0, 10.0), (5.0, 5.0)) is None
    assert apart((0.0, 10.0), (10.1, 10.1)) is not None


def test_stamps_too_near_for_seconds_are_reported_of() -> None:
    (reported,) = stamp_warnings({FRAMES: np.arange(60) / 30 / 3600})
    assert "too close for seconds" in reported
    assert not stamp_warnings({WHEELS: np.repeat(np.arange(0.0, 10.0, 0.04), 2) + np.tile([0.0, 1e-6], 250)})


def test_numbers_of_frames_are_read_at_the_rate_given(tmp_path: Path) -> None:
    right, numbered = tmp_path / "right", tmp_path / "numbered"
    for folder in (right, numbered):
        make_tum_recording(folder, frames=6)
    first_s = open_recording(right).ground_truth.stamps_s[0]  # type: ignore[union-attr]
    stamps_s = listed_stamps(open_recording(right))[FRAMES]
    period_s = float(np.median(np.diff(stamps_s)))

    def number(stamp_s: float) -> float:
        return round((stamp_s - stamps_s[0]) / period_s) + 15

    restamp(numbered, (*LISTS, "groundtruth.txt"), number)
    (reported,) = open_recording(numbered).warnings
    assert "(15, 16, 17, …) look like numbers of frames, not seconds" in reported
    assert "--rate-hz 30" in reported
    recording = open_recording(numbered, OpenOptions(rate_hz=1 / period_s))
    assert recording.warnings == ()
    np.testing.assert_allclose(listed_stamps(recording)[FRAMES], 15 * period_s + stamps_s - stamps_s[0], atol=1e-5)
    assert recording.ground_truth is not None
    assert recording.ground_truth.stamps_s[0] - listed_stamps(recording)[FRAMES][0] == pytest.approx(
        first_s - stamps_s[0], abs=period_s
    )


def test_truth_in_seconds_beside_frames_in_milliseconds_stays(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=6)
    before = open_recording(tmp_path / "room")
    restamp(tmp_path / "room", LISTS, lambda stamp_s: 1e3 * stamp_s)
    recording = open_recording(tmp_path / "room", OpenOptions(rate_hz=1000.0))
    assert recording.ground_truth is not None
    assert before.ground_truth is not None
    np.testing.assert_array_equal(recording.ground_truth.stamps_s, before.ground_truth.stamps_s)
    np.testing.assert_allclose(listed_stamps(recording)[FRAMES], listed_stamps(before)[FRAMES], atol=1e-6)


def test_images_in_milliseconds_that_find_no_partner_say_the_unit(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=6)
    restamp(tmp_path / "room", ("rgb.txt",), lambda stamp_s: 1e3 * stamp_s)
    restamp(tmp_path / "room", ("depth.txt",), lambda stamp_s: 1e3 * stamp_s + 5)
    with pytest.raises(InputError, match="stamps look like milliseconds: --rate-hz 1000"):
        open_recording(tmp_path / "room")
    assert open_recording(tmp_path / "room", OpenOptions(rate_hz=1000.0)).frame_count == 6


@pytest.mark.parametrize("rate_hz", [0.0, -30.0, np.nan, np.inf])
def test_rates_that_are_none_are_refused(rate_hz: float) -> None:
    with pytest.raises(ConfigError, match="rate_hz is"):
        OpenOptions(rate_hz=rate_hz)

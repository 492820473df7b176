"""Going on with a recording that was broken off, wherever that was."""

from __future__ import annotations

from pathlib import Path

import pytest
from hand_fed_camera import CALIBRATION, live_frame

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import OutputError, RecordingError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame, WheelTicks
from wheelsight.io.recordings import RecordingWriter, open_recording

BEGIN_S = 1_700_000_000.0


def write(folder: Path, numbers: range, resume: bool = True) -> RecordingWriter:
    with RecordingWriter(folder, CALIBRATION, resume=resume) as writer:
        for number in numbers:
            writer.add(WheelTicks(BEGIN_S + number, number, 2 * number))
            writer.add(live_frame(number, BEGIN_S + number).frame)
    return writer


def numbers_in(folder: Path) -> list[int]:
    return [int(event.color[0, 0, 0]) for event in open_recording(folder).events() if isinstance(event, RgbdFrame)]


def test_it_goes_on_behind_what_is_there(tmp_path: Path) -> None:
    write(tmp_path / "r", range(3))
    writer = write(tmp_path / "r", range(3, 5))
    assert (writer.frames, writer.readings, writer.last_stamp_s) == (5, 5, BEGIN_S + 4.0)
    assert numbers_in(tmp_path / "r") == [0, 1, 2, 3, 4]
    recording = open_recording(tmp_path / "r")
    assert (recording.wheel_count, recording.warnings) == (5, ())


@pytest.mark.parametrize("end", ["1700000003.0,3", "1700000003.0,3,6\n\0\0\0\0\0\0"])
def test_half_a_line_or_the_zeros_of_a_power_cut_are_taken_away(tmp_path: Path, end: str) -> None:
    write(tmp_path / "r", range(3))
    with (tmp_path / "r" / "wheels.csv").open("a") as stream:
        stream.write(end)
    kept = 3 + end.count("\n")
    write(tmp_path / "r", range(4, 6))
    recording = open_recording(tmp_path / "r")
    assert (recording.wheel_count, recording.warnings) == (kept + 2, ())


def test_images_that_were_written_in_part_are_removed(tmp_path: Path) -> None:
    write(tmp_path / "r", range(3))
    half = tmp_path / "r" / "rgb" / ".1700000003.0.png.0123abcd"
    half.write_bytes(b"half")
    other = tmp_path / "r" / "rgb" / ".keep"
    other.write_bytes(b"mine")
    write(tmp_path / "r", range(3, 4))
    assert (half.exists(), other.exists()) == (False, True)


def test_a_stamp_from_before_the_break_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "r", range(3))
    with pytest.raises(RecordingError, match="does not come after"):
        write(tmp_path / "r", range(2, 4))
    assert numbers_in(tmp_path / "r") == [0, 1, 2]


def test_nothing_or_an_empty_folder_is_begun(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("empty", "new"):
        write(tmp_path / name, range(2))
        assert numbers_in(tmp_path / name) == [0, 1]


def test_what_is_no_recording_or_of_other_sensors_is_refused_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "letter.txt").write_text("dear")
    with pytest.raises(OutputError, match=r"holds no recording to resume \(record into another --out\)"):
        write(tmp_path / "other", range(2))
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["letter.txt"]
    with RecordingWriter(tmp_path / "wheels", Calibration(wheels=Wheels(0.1, 0.1, 0.5, 100.0))):
        pass
    with pytest.raises(OutputError, match=r"holds a recording of wheels alone, which a camera of 64×48 cannot resume"):
        write(tmp_path / "wheels", range(2))
    larger = Calibration.registered_camera(PinholeCamera(80, 60, 60.0, 60.0, 39.5, 29.5))
    with RecordingWriter(tmp_path / "larger", larger):
        pass
    with pytest.raises(OutputError, match=r"a camera of 80×60, which a camera of 64×48 cannot resume"):
        write(tmp_path / "larger", range(2))


def test_beginning_again_leaves_nothing_of_before(tmp_path: Path) -> None:
    write(tmp_path / "r", range(3))
    (tmp_path / "r" / "camera_clock.csv").write_text("old")
    with RecordingWriter(tmp_path / "r", CALIBRATION, force=True) as writer:
        writer.add(live_frame(7, BEGIN_S).frame)
    assert numbers_in(tmp_path / "r") == [7]
    assert not (tmp_path / "r" / "camera_clock.csv").exists()

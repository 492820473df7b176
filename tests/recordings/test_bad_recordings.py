from __future__ import annotations

import os
import struct
import zlib
from typing import Any

import cv2
import numpy as np
import pytest
from narrowing import not_none, of_type
from synthetic import make_tum_recording

from wheelsight.core.errors import RecordingError, TrajectoryError
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame, SkippedFrame
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.inspection import inspect_recording


def images(folder, kind):
    return sorted((folder / kind).glob("*.png"))


def truncate(path):
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])


def corrupt(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))


def to_8_bits(path):
    cv2.imwrite(str(path), np.full((48, 64), 100, np.uint8))


def to_color(path):
    cv2.imwrite(str(path), np.full((48, 64, 3), 10_000, np.uint16))


def to_other_size(path):
    cv2.imwrite(str(path), np.full((24, 32), 10_000, np.uint16))


def to_nothing(path):
    cv2.imwrite(str(path), np.zeros((48, 64), np.uint16))


def to_nearly_zero(path):
    cv2.imwrite(str(path), np.full((48, 64), 7, np.uint16))


SPOILS = [
    pytest.param("rgb", truncate, "colour image is cut off before its end", id="colour cut off"),
    pytest.param("depth", truncate, "depth image is cut off before its end", id="depth cut off"),
    pytest.param("rgb", corrupt, "colour image is damaged, or no image", id="colour damaged"),
    pytest.param("rgb", lambda path: path.unlink(), "listed colour image is absent", id="colour absent"),
    pytest.param("depth", lambda path: path.unlink(), "listed depth image is absent", id="depth absent"),
    pytest.param("depth", lambda path: path.write_bytes(b""), "depth image is empty", id="depth empty"),
    pytest.param("depth", lambda path: path.write_text("hello"), "depth image is damaged", id="depth is text"),
    pytest.param("depth", to_8_bits, "depth image has 1 channel(s) of 8 bits, not one of 16", id="8 bits"),
    pytest.param("depth", to_color, "depth image has 3 channel(s) of 16 bits, not one of 16", id="three channels"),
    pytest.param("depth", to_other_size, "depth image is 32×24, its colour image 64×48", id="other size"),
    pytest.param("depth", to_nothing, "depth image measured nothing", id="no valid depth"),
    pytest.param("depth", to_nearly_zero, "median depth is 0.0014 m at 5000 depth units a metre", id="absurd scale"),
]


@pytest.mark.parametrize(("kind", "spoil", "problem"), SPOILS)
def test_one_bad_frame_is_skipped_with_its_reason(tum_folder, kind, spoil, problem):
    spoil(images(tum_folder, kind)[3])
    recording = open_recording(tum_folder)
    events = list(recording.events())
    assert [type(event) for event in events] == [RgbdFrame] * 3 + [SkippedFrame] + [RgbdFrame] * 2
    assert [event.index for event in events if isinstance(event, RgbdFrame | SkippedFrame)] == list(range(6))
    assert problem in of_type(SkippedFrame, events[3]).reason
    assert events[2].stamp_s < events[3].stamp_s < events[4].stamp_s


@pytest.mark.parametrize(("kind", "spoil", "problem"), SPOILS)
def test_if_all_frames_are_bad_opening_names_the_first(tum_folder, kind, spoil, problem):
    for path in images(tum_folder, kind):
        spoil(path)
    with pytest.raises(RecordingError) as caught:
        open_recording(tum_folder)
    message = str(caught.value)
    assert message.startswith(f"{images(tum_folder, kind)[0] if images(tum_folder, kind) else caught.value.path}: ")
    assert problem in message
    assert "\n" not in message


def test_an_absurd_scale_names_the_option(tum_folder):
    for path in images(tum_folder, "depth"):
        to_nearly_zero(path)
    with pytest.raises(RecordingError, match=r"5000 depth units a metre \(.*--depth-factor; 1000"):
        open_recording(tum_folder)


def test_a_truncated_jpeg_is_cut_off_too(tum_folder):
    png = images(tum_folder, "rgb")[3]
    jpeg = cv2.imencode(".jpg", not_none(cv2.imread(str(png))))[1].tobytes()
    png.write_bytes(jpeg)
    assert len([e for e in open_recording(tum_folder).events() if isinstance(e, RgbdFrame)]) == 6
    png.write_bytes(jpeg[:-20])
    assert "cut off" in of_type(SkippedFrame, list(open_recording(tum_folder).events())[3]).reason


def huge_png(width, height):
    """The beginning of a PNG that says it is so large."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n\0\0\0\r" + header + struct.pack(">I", zlib.crc32(header)) + b"\0\0\0\0IEND\xaeB`\x82"


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (huge_png(30_000, 30_000), "says it is 30000×30000 pixels, more than any depth camera has"),
        (huge_png(1, 1 << 30), "says it is 1×1073741824 pixels"),
        (b"P5 30000 30000 65535\n", "says it is 30000×30000 pixels"),
        (b"\xff\xd8\xff\xc0\0\x11\x08\x75\x30\x75\x30\x01\x01\x11\0\xff\xd9", "says it is 30000×30000 pixels"),
        (b"\xff\xd8\xff\xc2\0\x11\x08\x10\x00\x10\x00" + b"\xff\xda" * 30 + b"\xff\xd9", "has 30 scans"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 30000\n", "is damaged, or no image"),
    ],
)
def test_an_image_too_large_to_decode_is_reported_by_its_header(tum_folder, monkeypatch, data, problem):
    images(tum_folder, "depth")[3].write_bytes(data)
    decode = cv2.imdecode
    decoded: list[int] = []

    def counted(data: np.ndarray, flags: int) -> Any:
        decoded.append(len(data))
        return decode(data, flags)

    monkeypatch.setattr(cv2, "imdecode", counted)
    skipped = [event for event in open_recording(tum_folder).events() if isinstance(event, SkippedFrame)]
    assert [event.index for event in skipped] == [3]
    assert problem in skipped[0].reason
    assert len(data) not in decoded


@pytest.mark.parametrize("spoil", [lambda path: os.mkfifo(path), lambda path: path.symlink_to("/dev/zero")])
def test_an_image_that_is_no_file_is_skipped(tum_folder, spoil):
    path = images(tum_folder, "rgb")[2]
    path.unlink()
    spoil(path)
    skipped = [event for event in open_recording(tum_folder).events() if isinstance(event, SkippedFrame)]
    assert [event.index for event in skipped] == [2]
    assert "not a file" in skipped[0].reason


def test_a_recording_of_very_small_images_can_be_looked_into(tmp_path):
    make_tum_recording(tmp_path, frames=3, camera=PinholeCamera(16, 12, 14.0, 14.0, 7.5, 5.5))
    assert inspect_recording(open_recording(tmp_path)).offset is None


def test_a_recording_of_one_frame(tum_folder):
    for name in ("rgb.txt", "depth.txt"):
        lines = (tum_folder / name).read_text().splitlines()
        (tum_folder / name).write_text("\n".join(lines[:2]) + "\n")
    recording = open_recording(tum_folder)
    assert recording.frame_count == 1
    assert len(list(recording.events())) == 1


def test_crlf_comments_and_byte_order_marks_in_every_file(tum_folder):
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt", "calibration.yaml"):
        lines = (tum_folder / name).read_text().splitlines()
        text = "\r\n".join(["# made elsewhere", lines[0], "", "# more", *lines[1:], "# the end", ""])
        (tum_folder / name).write_bytes(b"\xef\xbb\xbf" + text.encode())
    recording = open_recording(tum_folder)
    assert (recording.frame_count, len(not_none(recording.ground_truth)), recording.warnings) == (6, 6, ())


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
@pytest.mark.parametrize("spoil", [lambda path: path.unlink(), lambda path: path.write_text("# none\n")])
def test_missing_and_empty_lists_are_named(tum_folder, name, spoil):
    spoil(tum_folder / name)
    with pytest.raises(RecordingError, match=rf"{name}: (is missing|lists no images)"):
        open_recording(tum_folder)


def edit_line(path, number, edit):
    lines = path.read_text().splitlines()
    lines[number - 1] = edit(lines[number - 1].split())
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("edit", "problem"),
    [
        (lambda words: " ".join(["nan" if i == 2 else word for i, word in enumerate(words)]), "not finite"),
        (lambda words: " ".join([*words[:4], "0.9", "0.9", "0", "0"]), "quaternion has length"),
        (lambda words: "1.0 " + " ".join(words[1:]), "comes before"),
        (lambda words: " ".join(words[:5]), "5 values where 8 are expected"),
    ],
)
def test_bad_ground_truth_names_file_and_line(tum_folder, edit, problem):
    edit_line(tum_folder / "groundtruth.txt", 5, edit)
    with pytest.raises(TrajectoryError, match=rf"groundtruth.txt:5: .*{problem}"):
        open_recording(tum_folder)


def test_ground_truth_over_a_part_is_said(tum_folder):
    lines = (tum_folder / "groundtruth.txt").read_text().splitlines()
    (tum_folder / "groundtruth.txt").write_text("\n".join(lines[:4]) + "\n")
    assert "The ground truth covers 2 of 6 frames; only these can be evaluated." in open_recording(tum_folder).warnings


def test_no_ground_truth_is_no_fault(tum_folder):
    (tum_folder / "groundtruth.txt").unlink()
    recording = open_recording(tum_folder)
    assert recording.ground_truth is None
    assert recording.warnings == ()

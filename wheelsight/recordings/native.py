"""wheelsight's own layout: the TUM benchmark's, plus wheels.csv and calibration.yaml; any TUM tool can read it."""

from __future__ import annotations

from pathlib import Path

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError, RecordingError
from wheelsight.events import WheelTicks
from wheelsight.recordings._cameras import camera_choices, choose_calibration
from wheelsight.recordings._image_recording import ImageRecording, complete
from wheelsight.recordings._images import DepthEncoding
from wheelsight.recordings._text import keep_growing, parse_stamp, read_lines
from wheelsight.recordings.protocol import OpenOptions
from wheelsight.recordings.tum import DEPTH_FACTOR, read_frames, read_truth

WHEELS_HEADER = "stamp_s,left,right"


class NativeReader:
    """What `RecordingWriter` writes."""

    name = "wheelsight"
    needs = "rgb.txt, depth.txt, wheels.csv and calibration.yaml"

    def recognises(self, folder: Path) -> bool:
        """Whether wheels.csv is there beside a list of images."""
        return (folder / "wheels.csv").is_file() and any((folder / name).is_file() for name in ("rgb.txt", "depth.txt"))

    def open(self, folder: Path, options: OpenOptions) -> ImageRecording:
        """The recording in `folder`. Raises InputError naming file and line."""

        def missing() -> Calibration:
            raise CalibrationError("is missing", path=folder / "calibration.yaml", fix=camera_choices())

        calibration = choose_calibration(folder, options, missing)
        frames, association, warnings = read_frames(folder, options)
        wheels, wheel_warnings = _read_wheels(folder / "wheels.csv")
        warnings += wheel_warnings
        truth = None
        if calibration.T_base_camera is not None:
            truth = read_truth(folder / "groundtruth_base.txt", warnings, body="base")
        return complete(
            ImageRecording(
                name=folder.resolve().name,
                path=folder,
                format=self.name,
                calibration=calibration,
                association=association,
                frames=frames,
                encoding=DepthEncoding(options.depth_factor or DEPTH_FACTOR),
                ground_truth=truth or read_truth(folder / "groundtruth.txt", warnings),
                warnings=tuple(warnings),
                wheels=tuple(wheels),
            )
        )


def _read_wheels(path: Path) -> tuple[list[WheelTicks], list[str]]:
    """The readings of wheels.csv in order of time, and warnings.

    A last line that does not end was cut off while it was written; its numbers may lack digits, so it is left out.
    """
    lines = read_lines(path)
    if not lines or lines[0].text.replace(" ", "") != WHEELS_HEADER:
        raise RecordingError(
            f"the first line is not {WHEELS_HEADER!r}", path=path, line=lines[0].number if lines else 1
        )
    warnings = []
    if len(lines) > 1 and not path.read_bytes().endswith((b"\n", b"\r")):
        warnings.append(f"{path.name}:{lines.pop().number}: the last line is cut off and was left out")
    ticks = [_parse_ticks(line.text, path, line.number) for line in lines[1:]]
    growing, more = keep_growing(ticks, [line.number for line in lines[1:]], path)
    return growing, warnings + more


def _parse_ticks(text: str, path: Path, line: int) -> WheelTicks:
    words = text.split(",")
    try:
        left, right = (int(word) for word in words[1:])
    except ValueError as error:
        raise RecordingError("a stamp and two whole numbers are expected", path=path, line=line) from error
    return WheelTicks(parse_stamp(words[0], path, line), left, right)

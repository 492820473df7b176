"""Images of a map's keyframes, with the camera that took them and where it was: what reconstruction starts from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from wheelsight.errors import InputError, MapError
from wheelsight.events import RgbdFrame
from wheelsight.exports.sources import Exported
from wheelsight.files import make_output_folder, write_bytes
from wheelsight.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.recordings import Recording
from wheelsight.slam.sessions import MapFolder, lie_together

IMAGES, DEPTHS = "images", "depths"
# Stamps come back from the map as they were; those that went through text may miss the last digits.
_SAME_S = 1e-4
_MILLIMETRES = 1000.0

OnView = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeView:
    """One image on disk.

    Attributes:
        name: of its file, below IMAGES.
        depth_name: of its depth in millimetres, below DEPTHS, on the same pixels; None where there is none.
        T_map_camera: (4, 4) of the optical frame of the camera that took it.
        camera: that took it.
    """

    name: str
    depth_name: str | None
    T_map_camera: FloatArray
    camera: PinholeCamera


def write_views(source: Exported, folder: Path, on_view: OnView) -> list[KeyframeView]:
    """Write an image of each keyframe that lies in the map: in colour from the recording, else grey from the map.

    Raises MapError where there is none, OutputError, and RecordingError where the recording breaks off.
    """
    kept = source.need_map()
    numbers = [KeyframeId(int(number)) for number in np.flatnonzero(lie_together(kept))]
    if not numbers:
        raise MapError("has no keyframes that hang together", path=kept.path, fix="drive on, and export again")
    for below in (IMAGES, DEPTHS):
        make_output_folder(folder / below, force=True)
    try:
        recording = source.recording
    except InputError:
        recording = None
    if recording is not None and recording.calibration.color is not None:
        views = list(_of_recording(kept, recording, numbers, folder, on_view))
        if len(views) == len(numbers):
            return views
    return list(_of_map(kept, numbers, folder, on_view))


def _of_recording(
    kept: MapFolder, recording: Recording, numbers: list[KeyframeId], folder: Path, on_view: OnView
) -> Iterator[KeyframeView]:
    """In colour; fewer than asked for where a keyframe is of another drive."""
    wanted = {number: kept.contents.places[number].stamp_s for number in numbers}
    calibration = recording.calibration
    T_camera_color, camera = se3.invert(calibration.T_color_camera), calibration.cameras[0]
    found = 0
    for event in recording.events():
        if not isinstance(event, RgbdFrame) or (number := _named(event.stamp_s, wanted)) is None:
            continue
        del wanted[number]
        name = f"{number:06d}.png"
        _write(folder / IMAGES / name, cv2.cvtColor(event.color, cv2.COLOR_RGB2BGR))
        if calibration.is_registered:
            _write(folder / DEPTHS / name, _millimetres(event.depth_m))
        T_map_color = kept.store.pose(number) @ T_camera_color
        yield KeyframeView(name, name if calibration.is_registered else None, T_map_color, camera)
        found += 1
        on_view(found, len(numbers))
        if not wanted:
            return


def _of_map(kept: MapFolder, numbers: list[KeyframeId], folder: Path, on_view: OnView) -> Iterator[KeyframeView]:
    """Grey, of the ideal camera that keyframes are of."""
    for done, number in enumerate(numbers, start=1):
        keyframe, name = kept.store[number], f"{number:06d}.png"
        grey, depth_m = keyframe.grey, keyframe.depth_m
        _write(folder / IMAGES / name, grey.astype(np.uint8))
        _write(folder / DEPTHS / name, _millimetres(depth_m))
        height, width = grey.shape
        fx, fy, cx, cy = keyframe.intrinsics.tolist()
        yield KeyframeView(name, name, kept.store.pose(number), PinholeCamera(width, height, fx, fy, cx, cy))
        on_view(done, len(numbers))


def _named(stamp_s: float, wanted: Mapping[KeyframeId, float]) -> KeyframeId | None:
    return next((number for number, at_s in wanted.items() if abs(at_s - stamp_s) <= _SAME_S), None)


def _millimetres(depth_m: Float32Array) -> np.ndarray:
    mm = np.rint(_MILLIMETRES * depth_m)
    return np.where(mm > np.iinfo(np.uint16).max, 0, mm).astype(np.uint16)


def _write(path: Path, image: ByteArray | np.ndarray) -> None:
    written, code = cv2.imencode(".png", image)
    assert written
    write_bytes(path, code.tobytes())

"""Map folders as wheelsight wrote them before 2026-11-27: keyframes of PNG images and float32 keypoints."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from wheelsight.core.keyframes import Keyframe
from wheelsight.slam.maps import MapFolder, journal
from wheelsight.slam.maps.journal import RecordKind
from wheelsight.slam.maps.keyframes import GREY_STEP, DepthSteps, grey_numbers, halved


def packed(keyframe: Keyframe, steps: DepthSteps) -> bytes:
    level, features = halved(keyframe), keyframe.features
    assert features is not None
    depth, grey = (
        cv2.imencode(".png", numbers)[1].tobytes()
        for numbers in (steps.numbers(level.depth_m), grey_numbers(level.grey, GREY_STEP))
    )
    kept = features.points[:, 2] > 0
    places = zlib.compress(np.hstack([features.px, features.points])[kept].astype("<f4").T.tobytes())
    sizes = len(depth), len(grey), 0, int(kept.sum()), len(places)
    head = struct.pack("<d4ddd5i4x", keyframe.stamp_s, *level.intrinsics, steps.step_m, steps.growth, *sizes)
    descriptors = features.descriptors[kept].astype("<u8").tobytes()
    return b"".join([head, bytes([GREY_STEP]), depth, grey, places, descriptors])


def write_old(path: Path, like: MapFolder) -> None:
    """The first keyframes of a map, in its place, as they were written then."""
    steps = DepthSteps.of_noise(like.calibration.depth_noise)
    keyframes = {number: like.store[number] for number in like.store}
    for file in path.glob("keyframes-*"):
        file.unlink()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(journal, "VERSION", 1)
        writer = journal.JournalWriter(path / "keyframes-00000.journal")
        for number, keyframe in keyframes.items():
            writer.append(RecordKind.FIRST_KEYFRAME, number, packed(keyframe, steps))
        writer.close()

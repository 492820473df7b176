"""A drive that writes its map until it is killed: python killed_drive.py FOLDER; it shows each keyframe that it has."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from sessions.kept_views import CALIBRATION, keyframe, pose

from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.settings import RecognitionSettings
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.maps import MapFolder, MapWriter, SessionSettings
from wheelsight.slam.maps import folder as folders

# Two keyframes a second are what a drive makes at most; here a second takes less.
KEYFRAMES_A_SECOND, SECONDS_A_SECOND = 2, 5
FRAMES_A_KEYFRAME = 3


def main(path: Path) -> None:
    folders._JOURNAL_KEYFRAMES = 5  # noqa: SLF001 - as short as a test needs them
    settings, recognition = SessionSettings(flush_s=0.1), RecognitionSettings()
    Recognizer(recognition).add(KeyframeId(0), keyframe(0))  # compiled or loaded, as before a run
    store = KeyframeStore()
    folder = MapFolder.create(path, CALIBRATION, settings)
    writer = MapWriter(folder, store, recognition)
    views = [keyframe(k) for k in range(8)]
    for number in range(100_000):
        held = store.add(views[number % len(views)], pose(number))
        for _ in range(FRAMES_A_KEYFRAME):
            C = 1e-4 * (number + 1) * np.eye(6)
            estimate = Estimate(number, Status.TRACKING, pose(number), C, keyframe=held, T_keyframe_body=np.eye(4))
            writer.update(estimate)
        if number % 7 == 6:
            shift = se3.exp([0.0, 0.01, 0, 0, 0, 0])
            store.move(list(store), shift @ store.T_map_keyframe)
        sys.stdout.write(f"{number}\n")
        sys.stdout.flush()
        time.sleep(1 / (KEYFRAMES_A_SECOND * SECONDS_A_SECOND))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

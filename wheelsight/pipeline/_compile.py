"""The process that `kernels.compile_kernels` starts: runs a small drive, part by part, and tells of each kernel."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from numba.core import event

from wheelsight.config import load_config
from wheelsight.events import RgbdFrame
from wheelsight.mapping import mesh_of
from wheelsight.pipeline.kernels import PARTS, mark_compiled
from wheelsight.pipeline.navigation_rehearsal import rehearse_navigation
from wheelsight.pipeline.rehearsal import floor_map, write_rehearsal
from wheelsight.pipeline.runs import run_each
from wheelsight.places import HistogramDescriber, LayoutDescriber
from wheelsight.recordings import Recording, open_recording
from wheelsight.simulation import SimulationSettings, camera_names, simulate


class _Counter(event.Listener):
    """Tells on stdout how many kernels were compiled so far, and for what part."""

    def __init__(self) -> None:
        self.part, self.kernels, self._depth = "", 0, 0

    def on_start(self, _: Any) -> None:
        """A kernel, or one that it calls."""
        self._depth += 1

    def on_end(self, _: Any) -> None:
        """Told once it and all that it calls are there."""
        self._depth -= 1
        if not self._depth:
            self.kernels += 1
            self.tell()

    def tell(self) -> None:
        """One line."""
        sys.stdout.write(f"{self.part} {self.kernels}\n")
        sys.stdout.flush()


def main(parts: list[str]) -> None:
    """Compile these parts."""
    counter = _Counter()
    event.register("numba:compile", counter)  # type: ignore[no-untyped-call]
    with tempfile.TemporaryDirectory(prefix="wheelsight-") as folder:
        recordings = []
        for name, is_registered in (("one-grid", True), ("two-grids", False)):
            write_rehearsal(Path(folder) / name, is_registered=is_registered)
            recordings.append(open_recording(Path(folder) / name))
        for part in parts:
            counter.part = part
            counter.tell()
            for recording in recordings:
                _rehearse(part, recording, Path(folder) / "results")
            mark_compiled(part)


def _rehearse(part: str, recording: Recording, out: Path) -> None:
    for settings in PARTS[part]:
        run_each(recording, load_config(overrides=settings), out, force=True)
    if part == "places":
        frame = next(event for event in recording.events() if isinstance(event, RgbdFrame))
        for describer in (HistogramDescriber(), LayoutDescriber()):
            describer.describe(frame)
    if part == "navigation":
        rehearse_navigation(recording.calibration)
    if part == "mesh":
        mesh_of(floor_map(), 0.02)
    if part == "simulation":
        for camera in camera_names():
            _simulate(camera)


def _simulate(camera: str) -> None:
    """A second of driving, rendered with all that may be in an image."""
    seen = {"passersby": 1, "has_motion_blur": True, "realism": "real", "covered_s": ((0.5, 1.0),)}
    settings = SimulationSettings("square", camera, (64, 48), rate_hz=4, duration_s=1.0, **seen)  # type: ignore[arg-type]
    for _ in simulate(settings).events():
        pass


if __name__ == "__main__":
    main(sys.argv[1:])

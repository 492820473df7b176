"""Stand-ins for a recording and for odometry whose answers are known, so that what joins them is tested alone."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.files import write_text
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.core.threads import Stopwatch
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import AssociationReport
from wheelsight.vision.features import FeatureEstimate, MatchedPixels

CAMERA = PinholeCamera(32, 24, 26.0, 26.0, 15.5, 11.5)


def frame(index: int, stamp_s: float, *, dark: bool = False) -> RgbdFrame:
    """A small frame whose colour shows its index; a dark one is what `TrueOdometry` cannot follow."""
    color = np.full((24, 32, 3), 0 if dark else 1 + index, np.uint8)
    return RgbdFrame(stamp_s, color, np.full((24, 32), 2.0, np.float32), index)


@dataclass
class MemoryRecording:
    """A recording made of given events; exceptions among them are raised in their place."""

    given: Sequence[Event | BaseException]
    ground_truth: Trajectory | None = None
    calibration: Calibration = field(default_factory=lambda: Calibration.registered_camera(CAMERA))
    warnings: tuple[str, ...] = ()
    decoding_s: float = 0.0
    was_closed: bool = False
    name: str = "memory"
    path: Path = Path("memory")
    format: str = "memory"

    @property
    def body(self) -> str:
        return "camera" if self.calibration.T_base_camera is None else "base"

    @property
    def frame_count(self) -> int:
        return sum(not isinstance(event, WheelTicks | BaseException) for event in self.given)

    @property
    def wheel_count(self) -> int:
        return sum(isinstance(event, WheelTicks) for event in self.given)

    @property
    def association(self) -> AssociationReport:
        return AssociationReport(self.frame_count + 2, self.frame_count + 1, self.frame_count, 0.02)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        try:
            for event in self.given:
                if isinstance(event, RgbdFrame | SkippedFrame) and not images:
                    continue
                if self.decoding_s > 0:
                    time.sleep(self.decoding_s)
                if isinstance(event, BaseException):
                    raise event
                yield event
        finally:
            self.was_closed = True


class TrueOdometry:
    """Answers with the true pose at each frame's stamp, and with failure where the frame is dark."""

    truth: ClassVar[Trajectory]
    seen: ClassVar[list[RgbdFrame]]

    def __init__(
        self,
        calibration: Calibration,
        settings: object,
        T_map_first: FloatArray | None = None,
        store: KeyframeStore | None = None,
    ) -> None:
        type(self).seen = []
        self._T_map_first = np.eye(4) if T_map_first is None else T_map_first
        self.watch = Stopwatch()
        self.store = KeyframeStore() if store is None else store
        self._reference_s: float | None = None

    def miss(self, stamp_s: float) -> Estimate:
        status = Status.INITIALIZING if self._reference_s is None else Status.FAILING
        return Estimate(stamp_s, status, reason=Reason.FRAME_UNUSABLE)

    def process(self, frame: RgbdFrame, T_previous_current_prior: FloatArray | None = None) -> Estimate:
        self.seen.append(frame)
        if not frame.color.any():
            return Estimate(frame.stamp_s, Status.FAILING, reason=Reason.TOO_FEW_KEYPOINTS)
        matched = None
        if self._reference_s is not None:
            px = np.full((3, 2), float(frame.index))
            matched = MatchedPixels(self._reference_s, px, px - 1, np.array([True, True, False]))
        self._reference_s = frame.stamp_s
        T = self._T_map_first @ self.truth.at([frame.stamp_s])[0]
        Ad = se3.adjoint(self._T_map_first)
        return FeatureEstimate(
            frame.stamp_s, Status.TRACKING, T, 1e-6 * Ad @ Ad.T, None, "camera", 3, 2, matched=matched
        )


def leave_pages_bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let runs write a page without figures: drawing them takes most of a short run's time, and has its own tests."""
    for name in ("wheelsight_report.page.write_report", "wheelsight_report.comparison.write_comparison"):
        monkeypatch.setattr(name, lambda records, path: write_text(path, "<html></html>"))

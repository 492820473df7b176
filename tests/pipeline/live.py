"""A source of events that has no end and knows no counts, as a camera on a robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count

from stand_ins import CAMERA, frame

from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import Event, WheelTicks
from wheelsight.core.trajectory import Trajectory

CAMERA_ALONE = Calibration.registered_camera(CAMERA)


@dataclass
class Live:
    """A camera at 30 Hz, or with `wheels` readings at 50 Hz too; Ctrl-C comes at an event, if at all."""

    truth: Trajectory
    calibration: Calibration = CAMERA_ALONE
    stop_at: int | None = None
    name: str = "robot"
    warnings: tuple[str, ...] = ("The camera is warm.",)
    given: list[Event] = field(default_factory=list)
    is_closed: bool = False

    def events(self, *, images: bool = True) -> Iterator[Event]:
        try:
            for number, event in enumerate(self._forever(images)):
                if number == self.stop_at:
                    raise KeyboardInterrupt
                self.given.append(event)
                yield event
        finally:
            self.is_closed = True

    def _forever(self, images: bool) -> Iterator[Event]:
        begin_s = float(self.truth.stamps_s[0])
        if images:
            return (frame(index, begin_s + index / 30) for index in count())
        return (WheelTicks(begin_s + index / 50, 30 * index, 40 * index) for index in count())

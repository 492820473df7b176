"""What the process of a `LocalizerApart` makes in tests: a localizer whose answers say what it was reported."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError, MapError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import Keyframe, KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.estimation import Localizer

CAMERA = np.array([2.0, 2.0, 0.5, 0.5])
RAISES, CANNOT_BE_SENT, DIES, MOVES, IS_ENDED = 13.0, 14.0, 15.0, 16.0, 17.0


class StrangeError(Exception):
    """One that no other process can be reported."""

    def __init__(self) -> None:
        super().__init__(lambda: None)


class Telling:
    """Keeps each frame as a keyframe, as far from the begin as its stamp says; some stamps are fatal."""

    def __init__(self) -> None:
        self.keyframes: KeyframeStore | None = KeyframeStore()
        self.recognised: int | None = 0
        self.warnings: tuple[str, ...] = ()

    def process(self, event: Event) -> Estimate | None:
        store = self.keyframes
        assert store is not None
        if event.stamp_s == RAISES:
            raise MapError("an unlucky event", path="a/map", line=7, fix="another one")
        if event.stamp_s == CANNOT_BE_SENT:
            raise StrangeError
        if event.stamp_s == DIES:
            os.kill(os.getpid(), signal.SIGKILL)
        if event.stamp_s == IS_ENDED:
            os.kill(os.getpid(), signal.SIGTERM)
        T = se3.from_plane(event.stamp_s, 0.0, 0.0)
        if event.stamp_s == MOVES:
            store.move(list(store), T @ store.T_map_keyframe)
        elif isinstance(event, RgbdFrame):
            grey = np.full_like(event.depth_m, 100.0)
            store.add(Keyframe.of_images(event.stamp_s, CAMERA, event.depth_m, grey), T)
            self.recognised = len(store)
            self.warnings = (f"{len(store)} keyframes",)
        return Estimate(event.stamp_s, Status.TRACKING, T)

    def close(self) -> None:
        """Nothing works for it."""


@contextmanager
def telling(closed: Path) -> Iterator[Telling]:
    """Says in a file that it was closed."""
    try:
        yield Telling()
    finally:
        closed.write_text("closed")


@contextmanager
def slow_to_close(closed: Path, seconds: float) -> Iterator[Telling]:
    """Writes for so long at its end."""
    yield Telling()
    time.sleep(seconds)
    closed.write_text("closed")


def refusing() -> AbstractContextManager[Telling]:
    """Cannot be made."""
    raise ConfigError("nobody can make it", fix="another one")


@contextmanager
def real(calibration: Calibration, config: Config) -> Iterator[Localizer]:
    """That of the library."""
    localizer = Localizer(calibration, config)
    yield localizer
    localizer.close()


def frame(stamp_s: float) -> RgbdFrame:
    """With a depth of its own."""
    depth_m = np.full((2, 2), 1.0 + stamp_s / 10, np.float32)
    return RgbdFrame(stamp_s, np.zeros((2, 2, 3), np.uint8), depth_m)


def ticks(stamp_s: float) -> WheelTicks:
    """Of a base that goes on."""
    return replace(WheelTicks(stamp_s, 0, 0), left=round(100 * stamp_s), right=round(90 * stamp_s))

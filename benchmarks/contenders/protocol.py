"""What a contender must offer to be measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame


class Tracker(Protocol):
    """Answers frame after frame with the camera's pose."""

    def prepare(self, frame: RgbdFrame) -> Any:
        """The frame in the form that suits this contender best; not timed."""
        ...

    def track(self, prepared: Any) -> FloatArray | None:
        """T_odom_camera (4, 4) of a prepared frame, the depth camera's, or None; timed."""
        ...


@dataclass(frozen=True, slots=True)
class Contender:
    """One line of the table.

    Attributes:
        name: in the table and for `--only`.
        start: makes a fresh tracker; only then are its libraries imported.
        settings: how it is used, in a sentence.
        is_peer: whether wheelsight is held against it.
        registers: it brings depth into the colour camera first, so it has a part only where the two differ.
    """

    name: str
    start: Callable[[Calibration], Tracker]
    settings: str
    is_peer: bool = False
    registers: bool = False

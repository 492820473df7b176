"""FrameGate: which frames are worth being aligned."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, so3
from wheelsight.recordings.repeats import Repeats
from wheelsight.settings import FrameGateSettings


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a frame need not be aligned.

    Attributes:
        note: for a user.
        is_repeat: whether all that is wrong is that its image has come before: no measurement, but no failure either.
    """

    note: str
    is_repeat: bool = False


class FrameGate:
    """Refuses frames whose image came before, and has them wait for the wheels.

    Args:
        settings: of None, the defaults.

    Attributes:
        wheels_are_heard: whether any reading has come.
    """

    def __init__(self, settings: FrameGateSettings | None = None) -> None:
        self.settings = settings or FrameGateSettings()
        self.wheels_are_heard = False
        self._first_s = math.inf
        self._repeats = Repeats()

    def why_not(self, frame: RgbdFrame, T_last_frame: FloatArray | None = None) -> Refusal | None:
        """What is wrong with a frame, if anything.

        Args:
            T_last_frame: (4, 4) how wheels say that the camera has moved since the last frame that was tracked.
        """
        lasting_s, hangs_s = self._repeats.lasting_s(frame), self.settings.hangs_s
        if lasting_s == 0 or (T_last_frame is not None and not self._has_moved(T_last_frame)):
            return None  # of a robot that stands, by its wheels, a camera without noise gives the same for as long
        if lasting_s <= hangs_s:
            return Refusal("the same image as before", is_repeat=True)
        return Refusal(f"the camera hangs: the same image for over {hangs_s:g} s")

    def waits_for_wheels(self, frame: RgbdFrame) -> bool:
        """Whether it is too soon to go without them."""
        self._first_s = min(self._first_s, frame.stamp_s)
        return not self.wheels_are_heard and frame.stamp_s - self._first_s < self.settings.wait_s

    def _has_moved(self, T_last_frame: FloatArray) -> bool:
        way_m, turn_rad = np.linalg.norm(T_last_frame[:3, 3]), so3.angle(T_last_frame[:3, :3])
        return bool(way_m > self.settings.moved_m or turn_rad > self.settings.moved_rad)

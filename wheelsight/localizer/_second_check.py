"""SecondCheck: a camera that was left out is compared with the wheels again, so that it is left out for no longer than
they contradict each other.

What looked like a wrong calibration over the first metres may have been people, slip, or a wall. The camera's motion is
followed apart, without any help of the wheels and without a map, until it agrees with them as at the beginning.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wheelsight.estimates import WheelEstimate
from wheelsight.events import RgbdFrame
from wheelsight.localizer._base_check import BaseCheck
from wheelsight.localizer._camera import CameraOdometry


class SecondCheck:
    """See the module.

    Args:
        new_check: makes a comparison that knows nothing yet.
        new_camera: makes odometry likewise.
        restart_after: so many frames in a row that cannot be tracked end it.
    """

    def __init__(
        self,
        new_check: Callable[[], BaseCheck],
        new_camera: Callable[[], CameraOdometry],
        restart_after: int,
    ) -> None:
        self._new_check, self._new_camera, self._restart_after = new_check, new_camera, restart_after
        self._check: BaseCheck | None = None
        self._camera: CameraOdometry | None = None
        self._begins, self._failed = True, 0

    def hear(self, wheels: WheelEstimate) -> None:
        """Take what the wheels came to; heard once a frame was looked at."""
        if self._check is not None:
            self._check.hear(wheels)

    def agrees(self, frame: RgbdFrame) -> bool:
        """Take a frame, newer than the one before; whether wheels and camera tell of one drive by now."""
        check = self._going_on()
        most = check.settings.again_keyframes
        if self._camera is None or self._failed >= self._restart_after or len(self._camera.store) > most:
            self._camera, self._begins, self._failed = self._new_camera(), True, 0
        seen = self._camera.process(frame)
        check.look(frame)
        if seen.T_odom_body is None:
            self._failed += 1
            return False
        self._failed = 0
        if self._begins:
            check.begin(frame, seen, np.eye(4))
            self._begins = False
        check.see(frame, seen, shows_all=seen.motion.shows_all)
        return check.has_agreed

    def _going_on(self) -> BaseCheck:
        """The comparison that goes on; another one after a verdict, or a long way without."""
        check = self._check
        if check is None or check.left_out is not None or self._is_old(check):
            check, self._begins = self._new_check(), True
            self._check = check
        return check

    def _is_old(self, check: BaseCheck) -> bool:
        of = check.settings
        return check.agreement.way_m > of.again_ways * of.enough_m

"""The camera of a robot to command: each frame is rendered as soon as all of its rows are taken."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation.camera_faults import Covered
from wheelsight.simulation.cameras import camera_model
from wheelsight.simulation.frames import FrameMaker, Surroundings
from wheelsight.simulation.realism import Carriage, realism_of, stream, unit_of
from wheelsight.simulation.realism.live_body import LiveBodyMotion
from wheelsight.simulation.realism.mount import mounted
from wheelsight.simulation.renderer import camera_calibration, times_of
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.stepping import TRUTH_PERIOD_S, Reading, poses_of
from wheelsight.trajectory import Trajectory

_KEPT_S = 0.25
# Motion blur and the depth camera's own moment ask for the camera's velocity about the middle row's time.
_AFTER_S = 0.005


class LiveCamera:
    """Frames along a drive that is not known yet.

    Args:
        surroundings: what there is to see.
        settings: seed, day, robot, camera, images a second, motion blur, realism, times in which it is covered.
        longest_s: of the drive.
        threads: how many render a frame.
    """

    def __init__(
        self, surroundings: Surroundings, settings: SimulationSettings, longest_s: float, threads: int = 1
    ) -> None:
        camera, realism = camera_model(settings.camera, settings.size), realism_of(settings.realism)
        rate_hz = settings.rate_hz or camera.rate_hz
        self._unit = unit_of(camera, realism, settings.seed)
        self._times = times_of(int(longest_s * rate_hz), rate_hz, realism, settings.day_seed)
        self._T_base_camera, self._body = settings.robot.T_base_camera, None
        if realism is not None:
            floor = realism.floor_of(surroundings.world, settings.seed)
            rng = stream(settings.seed, "body")
            self._body = LiveBodyMotion(TRUTH_PERIOD_S, settings.robot, floor, realism.body, rng)
            self._T_base_camera = mounted(self._T_base_camera, realism.mount, stream(settings.seed, "mount"))
        self._truth: deque[Reading] = deque(maxlen=round(_KEPT_S / TRUTH_PERIOD_S))
        stands = Trajectory(np.zeros(1), np.eye(4)[None], body="base")
        carriage = Carriage(stands, self._T_base_camera, self._body)
        self._maker = FrameMaker(
            surroundings, settings, self._unit, carriage, self._times, duration_s=longest_s, threads=threads
        )
        self._covers = [Covered(begin_s=begin, end_s=end, seed=settings.seed) for begin, end in settings.covered_s]
        self._next = 0

    @property
    def calibration(self) -> Calibration:
        """Of the camera alone, as its owner has it."""
        return camera_calibration(self._unit, self._unit.lens.nominal)

    @property
    def T_world_camera(self) -> FloatArray:
        """(4, 4) of now."""
        carriage = self._carriage()
        return np.asarray(carriage.T_world_camera(carriage.truth.stamps_s[-1])[0])

    @property
    def next_stamp_s(self) -> float:
        """The stamp of the next frame."""
        return float(self._times.told_s[self._next]) if self._next < len(self._times) else np.inf

    def follow(self, reading: Reading) -> None:
        """The base moves on."""
        self._truth.append(reading)
        if self._body is not None:
            self._body.step(se3.from_quaternion(reading.position_m, np.roll(reading.quaternion_wxyz, -1)))

    def frames(self) -> Iterator[RgbdFrame]:
        """Those that are taken wholly by now, in order."""
        after_s = max(self._unit.model.rolling_shutter_s / 2, _AFTER_S)
        while self._next < len(self._times) and self._times.taken_s[self._next] + after_s <= self._truth[-1].stamp_s:
            self._maker.carriage = self._carriage()
            frame = self._maker.frame(self._next)
            self._next += 1
            self._maker.forget_before(self._next)
            for cover in self._covers:
                frame = next(f for f in cover.apply([frame]) if isinstance(f, RgbdFrame))
            yield frame

    def _carriage(self) -> Carriage:
        readings = list(self._truth)
        stamps_s = np.array([reading.stamp_s for reading in readings])
        truth = Trajectory(stamps_s, poses_of(readings), body="base")
        return Carriage(truth, self._T_base_camera, self._body)

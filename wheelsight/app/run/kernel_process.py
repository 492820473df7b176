"""The process that `kernels.compile_kernels` starts: it runs a small drive, part by part, and reports each kernel.
A drive by navigation is one of the parts.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import event

from wheelsight.app.run.kernels import HIGH, LOW, PARTS, WHEELS, floor_map, mark_compiled, seen_from, write_rehearsal
from wheelsight.app.run.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import STOP, Event, RgbdFrame, VelocityCommand, WheelTicks
from wheelsight.core.robots import STOPPED
from wheelsight.core.threads import Closing
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import (
    Costmap,
    Footprint,
    GrowingFloor,
    KnownFloor,
    NavigationSettings,
    Navigator,
    Planner,
    StaticLayer,
)
from wheelsight.places import HistogramDescriber, LayoutDescriber
from wheelsight_export.meshes import mesh_of
from wheelsight_sim import SimulationSettings, camera_names, simulate


class _Counter(event.Listener):
    """Reports on stdout how many kernels are compiled so far, and for which part."""

    def __init__(self) -> None:
        self.part, self.kernels, self._depth = "", 0, 0

    def on_start(self, _: Any) -> None:
        """A kernel, or one that it calls."""
        self._depth += 1

    def on_end(self, _: Any) -> None:
        """Called when the kernel and all kernels that it calls are compiled."""
        self._depth -= 1
        if not self._depth:
            self.kernels += 1
            self.report()

    def report(self) -> None:
        """Print the part and its number of kernels."""
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
            counter.report()
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
            # One second of driving, with all effects of images
            seen = {"passersby": 1, "has_motion_blur": True, "realism": "real", "covered_s": ((0.5, 1.0),)}
            simulation = SimulationSettings("square", camera, (64, 48), rate_hz=4, duration_s=1.0, **seen)  # type: ignore[arg-type]
            for _ in simulate(simulation).events():
                pass


# A small drive by navigation.
_CELL_M, _READING_S, _READINGS_A_STEP = 0.05, 0.025, 2
_STEPS_A_FRAME = 2
_START, _GOAL = (-1.3, -0.4, 0.0), (0.8, 0.6, 1.57)
_STEPS = {"mppi": 160, "pure_pursuit": 20}


def rehearse_navigation(calibration: Calibration) -> None:
    """Drive with each controller, plan where there is hardly room, and begin a map that grows."""
    for controller, steps in _STEPS.items():
        robot = DrawnRobot(calibration)
        settings = NavigationSettings().model_copy(update={"controller": controller})
        navigator = Navigator(robot, TrueLocalization(robot), KnownFloor(drawn_room()), settings, trusts_floor=True)
        navigator.go_to_pose(_GOAL)
        for _ in range(steps):
            navigator.step()
    footprint = Footprint.rectangle(0.8, 0.3, 0.6)
    place = TrueLocalization(DrawnRobot(calibration))
    GrowingFloor(place, calibration, footprint, trusted_m=1.0).update(np.array(_START), 0.0)
    # A corridor 1 m wide that leads from a dead end to a room
    kind = np.full((60, 120), CellKind.OBSTACLE, np.uint8)
    kind[20:40, 5:70] = kind[5:55, 65:115] = CellKind.FREE
    corridor_grid = OccupancyGrid.of_kinds(kind, np.zeros(kind.shape, bool), _CELL_M, (0.0, 0.0))
    corridor = Costmap.of(StaticLayer.of(corridor_grid), footprint)
    # Turned round at its end: no straight way is free.
    Planner(footprint).plan(corridor, (1.2, 1.5, 0.0), (1.2, 1.5, np.pi))


class DrawnRobot(Closing):
    """A `Robot` in the rehearsal's room: it obeys at once, and frames are drawn.

    Attributes:
        calibration, stop_reason, now_s: as `Robot` has them.
        pose: (3,) x, y, yaw of the base in the room.
    """

    def __init__(self, calibration: Calibration) -> None:
        self.calibration, self.stop_reason, self.now_s = calibration, "", 0.0
        self.pose = np.array(_START)
        self._rolled_m = np.zeros(2)
        self._steps = 0

    def step(self, command: VelocityCommand) -> list[Event]:
        """As `Robot` has it."""
        if self.stop_reason:
            self.stop_reason = "" if command.is_stop else self.stop_reason
            command = STOP
        events: list[Event] = []
        for _ in range(_READINGS_A_STEP):
            self.now_s += _READING_S
            events.append(self.roll(command))
        self._steps += 1
        if self._steps % _STEPS_A_FRAME == 0:
            color, depth_m = seen_from(self.T_map_base, self.calibration.depth)
            events.append(RgbdFrame(self.now_s, color, depth_m, self._steps // _STEPS_A_FRAME))
        return events

    @property
    def T_map_base(self) -> FloatArray:
        """(4, 4) where it truly is."""
        return se3.from_plane(*self.pose)

    def roll(self, command: VelocityCommand) -> WheelTicks:
        """Move by a command for the time between two readings; return the next reading."""
        across_m_s = command.turn_rad_s * WHEELS.track_width_m / 2
        self._rolled_m += (np.array([-across_m_s, across_m_s]) + command.forward_m_s) * _READING_S
        x, y, yaw = self.pose
        way_m, turn = command.forward_m_s * _READING_S, command.turn_rad_s * _READING_S
        self.pose = np.array([x + way_m * np.cos(yaw), y + way_m * np.sin(yaw), yaw + turn])
        ticks = np.rint(self._rolled_m / (WHEELS.left_m_per_tick, WHEELS.right_m_per_tick)).astype(int).tolist()
        return WheelTicks(self.now_s, *ticks)

    def stop(self) -> None:
        """As `Robot` has it."""
        self.stop_reason = STOPPED

    def close(self) -> None:
        """As `Robot` has it; nothing is open."""


class TrueLocalization:
    """A `Localization` that takes its pose from the simulator."""

    keyframes: KeyframeStore | None = None
    recognised: int | None = None

    def __init__(self, robot: DrawnRobot) -> None:
        self._robot = robot

    def process(self, events: Sequence[Event]) -> list[tuple[Event, Estimate | None]]:
        """As `Localization` has it."""
        T, C = self._robot.T_map_base, 1e-6 * np.eye(6)
        return [(event, Estimate(event.stamp_s, Status.TRACKING, T, C, body="base")) for event in events]

    def close(self) -> None:
        """No thread works for it."""


def drawn_room() -> OccupancyGrid:
    """The rehearsal's room, with its walls."""
    low, high = LOW[:2] - _CELL_M, HIGH[:2] + _CELL_M
    width, height = np.rint((high - low) / _CELL_M).astype(int)
    kind = np.full((height, width), CellKind.FREE, np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = CellKind.OBSTACLE
    return OccupancyGrid.of_kinds(kind, np.zeros(kind.shape, bool), _CELL_M, (float(low[0]), float(low[1])))


if __name__ == "__main__":
    main(sys.argv[1:])

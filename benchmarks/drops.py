"""`python -m benchmarks.drops`: a wheelchair drives at floor that is missing, or that a depth camera does not see.

A hall whose map says that all of its floor is free, by rays, without rendering. At full speed or slower, straight, in
a curve or after a turn on the spot, the chair is commanded over one of: a ledge (0.2 to 1 m down), a well that returns
no ray, stairs down, black carpet that returns none, a mat that returns one in twenty, and wet floor that mirrors the
ceiling. Nothing but the collision monitor ends the drive. The camera is a Kinect's, at 128×96 pixels, with its noise,
and a frame arrives 0.1 s after its stamp. Half of the chairs have it level (the floor begins 2 m before the camera),
half look down by 0.4 rad.

"Past the edge" is how far the deepest point of the outline lies within the place, by the truth. For carpet, mat and wet
floor it is the same: a camera cannot distinguish them from a hole.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.navigation_page import write_section
from benchmarks.plain_rooms import WHEELS, Unicycle
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.navigation import DepthViewer, NavigationSettings
from wheelsight.navigation.collision_monitor import ControlChain
from wheelsight_sim.robot import RobotModel

PAST_M = 0.05
_TITLE = "Missing floor"
_CAMERA = PinholeCamera(128, 96, 105.0, 105.0, 63.5, 47.5)
_PITCHES_RAD = (0.0, 0.4)
_PERIOD_S, _LATE_PERIODS, _LONGEST_S = 0.05, 2, 25.0
_CEILING_M, _SENSES_M, _NOISE_PER_M, _LOST = 2.8, (0.5, 6.0), 1.425e-3, 0.01
_TREAD_M, _RISER_M = 0.28, 0.17
# Beyond this it has gone over the edge, whatever follows.
_GONE_M = 0.4


class Ground(StrEnum):
    """What is wrong with the floor."""

    LEDGE = "ledge"
    WELL = "well without depth"
    STAIRS = "stairs down"
    CARPET = "black carpet"
    WET = "wet floor"
    MAT = "mat that swallows infrared"


@dataclass(frozen=True, slots=True)
class Place:
    """A rectangle of such floor, from an edge on.

    Attributes:
        edge_m: distance of the edge from the origin, along the x axis.
        slant_rad: direction, from the x axis, in which the edge is crossed.
        length_m, half_width_m: from the edge on, and to either side.
        lower_m: of a ledge: height of the edge.
    """

    ground: Ground
    edge_m: float
    slant_rad: float
    length_m: float
    half_width_m: float
    lower_m: float

    def within_m(self, points: FloatArray) -> FloatArray:
        """Return (...,) how deep points (..., 2) lie within it; negative outside."""
        along, across = self._along(points)
        return np.asarray(np.minimum(np.minimum(along, self.length_m - along), self.half_width_m - np.abs(across)))

    def _along(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        c, s = math.cos(self.slant_rad), math.sin(self.slant_rad)
        x, y = points[..., 0] - self.edge_m, points[..., 1]
        return np.asarray(c * x + s * y), np.asarray(c * y - s * x)

    def depth_m(self, T_map_camera: FloatArray, rays: FloatArray, rng: np.random.Generator) -> Float32Array:
        """Return (h, w) depth of a camera with rays (h, w, 3), 0 without any."""
        ways, at = rays @ T_map_camera[:3, :3].T, T_map_camera[:3, 3]
        down = ways[..., 2] < 0
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = np.where(down, -at[2] / ways[..., 2], np.inf)
            is_within = np.zeros(floor.shape, bool)
            is_within[down] = self.within_m(at[:2] + floor[down][:, None] * ways[down][:, :2]) > 0
            depth = np.where(is_within, self._below(floor, ways, at, rng), floor)
            # The hall's walls, far enough for a camera to see them over the place.
            for axis, wall_m in ((0, self.edge_m + self.length_m + 2.0), (1, 4.0), (1, -4.0)):
                wall = (wall_m - at[axis]) / ways[..., axis]
                depth = np.where((wall > 0) & (wall < floor), np.minimum(depth, wall), depth)
        depth = np.where(depth <= _SENSES_M[1], depth, 0.0)
        noisy = depth + _NOISE_PER_M * depth**2 * rng.standard_normal(depth.shape)
        is_lost = rng.random(depth.shape) < _LOST
        is_sensed = (depth >= _SENSES_M[0]) & ~is_lost
        return np.where(is_sensed, noisy, 0.0).astype(np.float32)

    def _below(self, floor: FloatArray, ways: FloatArray, at: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return (h, w) the depth of rays that met floor within the place; infinite without any."""
        if self.ground is Ground.LEDGE:
            return np.asarray(floor * (at[2] + self.lower_m) / at[2])
        if self.ground is Ground.WET:
            return np.asarray(floor * (at[2] + _CEILING_M) / at[2])
        if self.ground is Ground.MAT:
            return np.where(rng.random(floor.shape) < 0.05, floor, np.inf)
        if self.ground is not Ground.STAIRS:
            return np.full(floor.shape, np.inf)
        depth = np.full(floor.shape, np.inf)
        for step in range(1, 12):
            tread = floor * (at[2] + step * _RISER_M) / at[2]
            along, _ = self._along(at[:2] + np.where(np.isfinite(tread), tread, 0.0)[..., None] * ways[..., :2])
            is_on = (along >= (step - 1) * _TREAD_M) & (along < step * _TREAD_M)
            depth = np.where(is_on, np.minimum(depth, tread), depth)
        return depth


@dataclass(frozen=True, slots=True)
class DropDrive:
    """One drive, and what came of it.

    Attributes:
        past_m: how far the outline came within the place; negative if it stood before it.
        speed_m_s: highest speed on the way.
        reason: of the collision monitor, at the end.
    """

    number: int
    ground: str
    asked: str
    pitch_rad: float
    speed_m_s: float
    past_m: float
    stands: bool
    reason: str

    @property
    def sentence(self) -> str:
        """In a line."""
        ends = f"stands {-self.past_m:.2f} m before" if self.past_m < 0 else f"{self.past_m:.2f} m past the edge"
        how = f"{self.asked}, camera {self.pitch_rad:g} rad down, {self.speed_m_s:.2f} m/s"
        return f"{self.number}: {self.ground}, {how}: {ends} ({self.reason})"


def drawn(number: int, seed: int) -> tuple[Place, np.random.Generator]:
    """Return the place of a drive, and the generator of all else."""
    rng = np.random.default_rng([seed, number])
    ground = list(Ground)[number % len(Ground)]
    half_m = math.inf if rng.random() < 0.3 else float(rng.uniform(0.4, 1.5))
    length_m = float(rng.uniform(0.4, 2.0)) if ground is not Ground.STAIRS else 3.0
    slant_rad = 0.0 if rng.random() < 0.3 else float(rng.uniform(-0.7, 0.7))
    lower_m = float(rng.uniform(0.2, 1.0))
    return Place(ground, float(rng.uniform(3.6, 5.0)), slant_rad, length_m, half_m, lower_m), rng


def driven(number: int, seed: int) -> DropDrive:
    """Drive once."""
    place, rng = drawn(number, seed)
    settings = NavigationSettings()
    footprint, pitch_rad = settings.footprint.outline, _PITCHES_RAD[number // len(Ground) % 2]
    mount = RobotModel(camera_pitch_rad=pitch_rad).T_base_camera
    calibration = Calibration.registered_camera(_CAMERA, T_base_camera=mount, wheels=WHEELS)
    viewer, chain = DepthViewer(calibration, footprint, settings.live), ControlChain(settings)
    chain.monitor.trust_floor(viewer.near_m)
    full_m_s = settings.limits.forward_m_s * (1.0 if rng.random() < 0.5 else float(rng.uniform(0.3, 1.0)))
    asked = ("straight", "in a curve", "after a turn")[int(rng.integers(3))]
    # A curve that leads through the middle of the edge, or nearly: it begins aside, turned away.
    curve = float(rng.uniform(-0.25, 0.25)) if asked == "in a curve" else 0.0
    start_rad = {"straight": 0.0, "in a curve": -curve * place.edge_m / 2}.get(asked, float(rng.uniform(0.8, 2.0)))
    base = Unicycle((0.0, 0.0, start_rad))
    sides = np.linspace(0, 1, 30)[:, None, None]
    outline = footprint.corners + sides * (np.roll(footprint.corners, -1, axis=0) - footprint.corners)
    outline = outline.reshape(-1, 2)
    frames: list[tuple[float, Float32Array]] = []
    past_m, fastest_m_s, still_s, rays = -math.inf, 0.0, 0.0, _CAMERA.rays()
    for period in range(round(_LONGEST_S / _PERIOD_S)):
        now_s = _PERIOD_S * (period + 1)
        base.step(chain.command)
        chain.monitor.add_reading(now_s, base.forward_m_s, base.turn_rad_s)
        if period % 2 == 0:
            T_map_base = np.asarray(se3.from_plane(*map(float, base.pose)))
            frames.append((now_s, place.depth_m(T_map_base @ mount, rays, rng)))
        if frames and now_s - frames[0][0] > (_LATE_PERIODS - 0.5) * _PERIOD_S:
            stamp_s, depth_m = frames.pop(0)
            chain.monitor.add_view(viewer.view(depth_m, stamp_s))
        if asked == "after a turn" and base.pose[2] > 0.03 and not fastest_m_s > 0.1:
            wanted = VelocityCommand(0.0, -min(0.6, 0.1 + base.pose[2]))
        else:
            wanted = VelocityCommand(full_m_s, curve * base.forward_m_s)
        chain.ask(wanted if now_s > 0.5 else STOP, now_s, Status.TRACKING, stands_by_itself=False)
        c, s = math.cos(base.pose[2]), math.sin(base.pose[2])
        past_m = max(past_m, float(place.within_m(outline @ np.array([[c, s], [-s, c]]) + base.pose[:2]).max()))
        fastest_m_s = max(fastest_m_s, base.forward_m_s)
        still_s = still_s + _PERIOD_S if base.stands and now_s > 2.0 else 0.0
        if still_s > 1.0 or past_m > _GONE_M:
            break
    reason = "" if chain.checked.reason is None else str(chain.checked.reason)
    return DropDrive(number, str(place.ground), asked, pitch_rad, fastest_m_s, past_m, base.stands, reason)


def sheets_of(drives: Sequence[DropDrive]) -> list[Sheet]:
    """Return a row for each kind, what must be reached, and what went wrong."""
    header = ("floor", "drives", "from 0.9 m/s", "stood", "past the edge m, most", "before it m, median", "over 0.05 m")
    rows = []
    for ground in Ground:
        some = [drive for drive in drives if drive.ground == ground]
        if some:
            past = np.array([drive.past_m for drive in some])
            fast = sum(drive.speed_m_s >= 0.9 for drive in some)
            ends = str(len(some)), str(fast), str(sum(drive.stands for drive in some)), f"{past.max():.3f}"
            rows.append((str(ground), *ends, f"{-np.median(past):.2f}", str(int((past > PAST_M).sum()))))
    wrong = [drive for drive in drives if drive.past_m > PAST_M]
    most_m = max((drive.past_m for drive in drives), default=0.0)
    target = Target(f"farthest past an edge, of {len(drives)} drives", PAST_M, most_m, "m", 3)
    sheets = [Sheet("Outcomes", header, tuple(rows)), targets_sheet([target])]
    return [*sheets, Sheet("Failures", ("drive",), tuple((drive.sentence,) for drive in wrong))] if wrong else sheets


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.drops", description=__doc__)
    parser.add_argument("--drives", type=int, default=300, help="the six kinds take turns")
    parser.add_argument("--first", type=int, default=0, help="number of the first drive")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="print each drive")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    arguments = parser.parse_args()
    console = Console(width=170)
    drives = []
    for number in range(arguments.first, arguments.first + arguments.drives):
        drives.append(driven(number, arguments.seed))
        if arguments.all:
            console.print(drives[-1].sentence, asdict(drives[-1])["stands"])
    sheets = sheets_of(drives)
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        what = f"--drives {arguments.drives} --first {arguments.first} --seed {arguments.seed}"
        about = machine.description() | {"Command": f"`python -m benchmarks.drops {what}`"}
        write_section(arguments.out, _TITLE, __doc__ or "", about, sheets)


if __name__ == "__main__":
    main()

"""Trinh et al. and Ligocki dead-reckon from wheels but give no errors; here they are, on recordings with a truth.

For each recording: dead reckoning by wheels alone and, where there is one, with the gyroscope; by nominal sizes of
the wheels and by sizes fitted to the first part of the truth. Errors are those of the rest, that no fit has seen.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, InputError, WheelsightError
from wheelsight.core.files import atomic_write, make_output_folder
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import WheelSpeeds, WheelTicks, YawRate
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import ate, rpe
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.wheels import Integration, integrate_log, mean_yaw_rates, ticks_from_speeds
from wheelsight_calibration.wheel_drive import drive_of
from wheelsight_calibration.wheels import fit_wheels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = """examples:
  python papers/wheels_real.py skid_steer_run20 mocap_floor --out figures
  python papers/wheels_real.py corridor_864m --segment 5 --out figures --force
"""
HEAD = ("recording", "wheels", "way", "ATE", "end", "end, of the way", "drift", "turn a 100 m")
DRIFT_M = (100.0, 50.0, 20.0, 10.0)
TRUTH_GAP_S = 0.5
INK, PALE = "#222222", "#dddddd"
COLOURS = ("#d55e00", "#1f6fb4", "#e69f00", "#009e73")


@dataclass(frozen=True, eq=False)
class Log:
    """A recording's readings as arrays: ticks (N,) of both wheels, and stamps and yaw rates (M, 2) of a gyroscope."""

    name: str
    stamps_s: FloatArray
    left: FloatArray
    right: FloatArray
    yaw_rates: FloatArray
    calibration: Calibration
    truth: Trajectory

    def reckoned(
        self, wheels: Wheels, from_s: float, *, gyro: bool = False, integration: Integration = "arc"
    ) -> Trajectory:
        """T_odom_base of the readings; only what comes after `from_s`, though the gyroscope's bias is older."""
        rates = mean_yaw_rates(self.stamps_s - wheels.delay_s, *self.yaw_rates.T) if gyro else None
        ticks = (self.stamps_s, self.left, self.right)
        track = integrate_log(
            wheels, *ticks, integration=integration, yaw_rates_rad_s=rates, gyro=self.calibration.gyro
        )
        return track.trajectory().between(from_s, np.inf)


@dataclass(frozen=True, eq=False)
class Errors:
    """Of one way of reckoning.

    Attributes:
        ate_m: RMSE of the positions after rigid alignment.
        end_m: error of the last position when the first pose is laid upon the truth.
        way_m: length of the true path.
        stretch_m, drift_percent: mean error after each stretch of so many metres, as a share of it.
        turn_deg: mean error of the yaw after each such stretch, for 100 m.
    """

    ate_m: float
    end_m: float
    way_m: float
    stretch_m: float
    drift_percent: float
    turn_deg: float


def main(arguments: list[str] | None = None) -> int:
    """Run the script; returns 0, or 2 after a one-line error."""
    options = _parser().parse_args(arguments)
    try:
        folder = make_output_folder(options.out, options.force)
        rows = [HEAD, tuple("---" for _ in HEAD)]
        for path in options.recordings:
            recording = open_recording(path)
            log = read_log(recording)
            ways = ways_of(log, recording, options.share, options.segment)
            rows += [_row(log.name, way, errors_of(track, log.truth)) for way, track in ways.items()]
            save(figure(log, ways), folder / f"{log.name}.png")
    except WheelsightError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print("\n".join(f"| {' | '.join(row)} |" for row in rows))
    return 0


def read_log(recording: Recording) -> Log:
    """The readings of a recording of wheels. Raises InputError where it has no wheels or no truth."""
    if recording.calibration.wheels is None or recording.ground_truth is None:
        raise InputError("has no wheels, or no truth", path=recording.path)
    events = list(recording.events())
    speeds = [event for event in events if isinstance(event, WheelSpeeds)]
    ticks = [event for event in events if isinstance(event, WheelTicks)]
    stamps_s = np.array([reading.stamp_s for reading in (ticks or speeds)])
    if ticks:
        left, right = np.array([(reading.left, reading.right) for reading in ticks], float).T
    else:
        turning = np.array([(reading.left_rad_s, reading.right_rad_s) for reading in speeds])
        left, right = ticks_from_speeds(recording.calibration.wheels, stamps_s, *turning.T)
    yaw_rates = np.array([(e.stamp_s, e.yaw_rate_rad_s) for e in events if isinstance(e, YawRate)]).reshape(-1, 2)
    return Log(recording.name, stamps_s, left, right, yaw_rates, recording.calibration, recording.ground_truth)


def ways_of(log: Log, recording: Recording, share: float, segment_m: float) -> dict[str, Trajectory]:
    """T_odom_base of the part after `share` of the time, by each way of reckoning."""
    nominal = log.calibration.wheels
    assert nominal is not None
    split_s = log.stamps_s[0] + share * (log.stamps_s[-1] - log.stamps_s[0])
    ways = {
        "Euler, nominal": log.reckoned(nominal, split_s, integration="euler"),
        "midpoint, nominal": log.reckoned(nominal, split_s, integration="midpoint"),
        "arc, nominal": log.reckoned(nominal, split_s),
    }
    if len(log.yaw_rates):
        ways["arc with gyro, nominal"] = log.reckoned(nominal, split_s, gyro=True)
    fitted = _fitted(log, recording, nominal, split_s, segment_m)
    if fitted is None:
        return ways
    ways["arc, fitted"] = log.reckoned(fitted, split_s)
    if len(log.yaw_rates):
        ways["arc with gyro, fitted"] = log.reckoned(fitted, split_s, gyro=True)
    return ways


def _fitted(log: Log, recording: Recording, nominal: Wheels, until_s: float, segment_m: float) -> Wheels | None:
    """Sizes fitted to the truth until then, or None; the delay is kept where steady motion hides it."""
    drive, truth = drive_of(recording, nominal).between(-np.inf, until_s), log.truth.between(-np.inf, until_s)
    for with_delay in (True, False):
        try:
            fitted = fit_wheels(nominal, drive, truth, with_delay=with_delay, segment_m=segment_m).wheels
        except CalibrationError as error:
            print(f"{log.name}: not fitted{'' if with_delay else ' either'}: {error}", file=sys.stderr)
            continue
        sizes = (
            f"radii {fitted.left_radius_m:.4f} and {fitted.right_radius_m:.4f} m, track {fitted.track_width_m:.4f} m"
        )
        print(f"{log.name}: fitted {sizes}, delay {1e3 * fitted.delay_s:.0f} ms{'' if with_delay else ' (kept)'}")
        return fitted
    return None


def errors_of(track: Trajectory, truth: Trajectory) -> Errors:
    """Against the truth brought to the track's stamps."""
    near, true = _together(track, truth)
    way_m = true.length_m
    stretch_m = next((stretch for stretch in DRIFT_M if stretch <= way_m / 3), DRIFT_M[-1])
    drift = rpe(near, true, stretch_m, "metres", max_gap_s=1e-3)
    end = _from_start(near, true).positions_m[-1] - true.positions_m[-1]
    return Errors(
        ate_m=ate(near, true, max_gap_s=1e-3).translation.rmse,
        end_m=float(np.linalg.norm(end)),
        way_m=way_m,
        stretch_m=stretch_m,
        drift_percent=100 * drift.translation.mean / stretch_m,
        turn_deg=100 * drift.rotation.in_degrees().mean / stretch_m,
    )


def _together(track: Trajectory, truth: Trajectory) -> tuple[Trajectory, Trajectory]:
    """The track where the truth is known, and the truth at the same stamps."""
    T = truth.at(track.stamps_s, TRUTH_GAP_S)
    known = np.isfinite(T).all(axis=(1, 2))
    near = track.select(known)
    return near, Trajectory(near.stamps_s, T[known], body=truth.body)


def _from_start(near: Trajectory, true: Trajectory) -> Trajectory:
    """The track as it starts where the truth starts."""
    return near.moved(true.T_frame_body[0] @ se3.invert(near.T_frame_body[0]))


def _row(name: str, way: str, e: Errors) -> tuple[str, ...]:
    drift = f"{e.drift_percent:.2f} % of {e.stretch_m:.0f} m"
    share = f"{100 * e.end_m / e.way_m:.2f} %"
    return (name, way, f"{e.way_m:.1f} m", f"{e.ate_m:.2f} m", f"{e.end_m:.2f} m", share, drift, f"{e.turn_deg:.1f}°")


def figure(log: Log, ways: dict[str, Trajectory]) -> Figure:
    """Paths from above, all starting where the truth does, and their errors over the way."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("matplotlib is missing", fix="pip install matplotlib") from error
    drawn = Figure(figsize=(7.6, 8.6), layout="constrained")
    above, over_way = drawn.subplots(2, 1, height_ratios=(2.4, 1))
    drawn_ways = [(way, track) for way, track in ways.items() if way.startswith("arc")]  # the others lie beneath
    for (way, track), colour in zip(drawn_ways, COLOURS, strict=False):
        near, true = _together(track, log.truth)
        moved = _from_start(near, true)
        line = {"color": colour, "linewidth": 1.3, "label": way}
        above.plot(*moved.positions_m[:, :2].T, **line)
        over_way.plot(true.distances_m, np.linalg.norm(moved.positions_m - true.positions_m, axis=1), **line)
    above.plot(*true.positions_m[:, :2].T, color=INK, linewidth=2.0, label="truth", zorder=1)
    above.plot(*true.positions_m[0, :2], "o", color="white", markeredgecolor=INK, markersize=7)
    above.set(title=f"{log.name}: dead reckoning from the ring on", xlabel="x (m)", ylabel="y (m)")
    above.set_aspect("equal", adjustable="datalim")
    above.legend(loc="best", frameon=False, fontsize="small")
    over_way.set(xlabel="way (m)", ylabel="error (m)", ylim=(0, None))
    for axes in (above, over_way):
        axes.grid(color=PALE, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return drawn


def save(drawn: Figure, path: Path) -> None:
    """Write a figure as PNG, atomically, and say so."""
    with atomic_write(path, "wb") as stream:
        drawn.savefig(stream, format="png", dpi=160)
    print(f"wrote {path}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", type=Path, nargs="+", help="folders of recordings of wheels with a truth")
    parser.add_argument(
        "--share", type=float, default=0.5, help="part of the time that sizes are fitted to (%(default)s)"
    )
    parser.add_argument("--segment", type=float, default=1.0, help="way between compared poses, metres (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("wheels_real"), help="folder for the figures (%(default)s)")
    parser.add_argument("--force", action="store_true", help="write into a folder that holds something already")
    return parser


if __name__ == "__main__":
    sys.exit(main())

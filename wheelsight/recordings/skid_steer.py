"""Four encoders of a skid-steered robot beside an IMU: encoders.csv, imu.csv and, if there is one, reference.txt."""

from __future__ import annotations

from pathlib import Path

from wheelsight.events import WheelTicks, YawRate
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._tables import Row, read_table
from wheelsight.recordings._text import keep_growing
from wheelsight.recordings._wheel_recording import WheelRecording, shipped_robot
from wheelsight.recordings.protocol import OpenOptions
from wheelsight.recordings.tum import read_truth

_SIDES = (("front_left", "rear_left"), ("front_right", "rear_right"))


class SkidSteerReader:
    """Ticks since the reading before of four wheels, and the yaw rate of an IMU.

    encoders.csv: stamp_s, front_right, front_left, rear_right, rear_left, in any order. imu.csv: stamp_s and wz_radps,
    others are left alone. reference.txt: TUM text of the base, by another system. A side's ticks are the sum of its two
    encoders, so that `ticks_per_turn` of a calibration.yaml is twice that of one.
    """

    name = "skid_steer"
    needs = "encoders.csv and imu.csv"

    def recognises(self, folder: Path) -> bool:
        """Whether both are there."""
        return all(is_there(folder / name) for name in ("encoders.csv", "imu.csv"))

    def open(self, folder: Path, options: OpenOptions) -> WheelRecording:
        """The recording in `folder`. Raises InputError naming file and line."""
        calibration = choose_calibration(folder, options, lambda: shipped_robot("skid_steer"))
        ticks, warnings = _read_ticks(folder / "encoders.csv")
        rates, more = _read_rates(folder / "imu.csv")
        warnings += more
        reference = read_truth(folder / "reference.txt", warnings, body="base")
        if reference is not None:
            warnings.append("The reference trajectory is another system's estimate: errors against it hold its own.")
        return WheelRecording(
            name=folder.resolve().name,
            path=folder,
            format=self.name,
            calibration=calibration,
            wheels=tuple(ticks),
            yaw_rates=tuple(rates),
            ground_truth=reference,
            warnings=tuple(warnings),
        )


def _read_ticks(path: Path) -> tuple[list[WheelTicks], list[str]]:
    """Counts summed up from the first reading; a row whose stamp is out of order keeps its ticks."""
    rows, warnings = read_table(path, ("stamp_s", *_SIDES[0], *_SIDES[1]))
    left = right = 0
    ticks = []
    for row in rows:
        left += sum(row.whole(name) for name in _SIDES[0])
        right += sum(row.whole(name) for name in _SIDES[1])
        ticks.append(WheelTicks(row.stamp_s, left, right))
    growing, more = keep_growing(ticks, _numbers(rows), path)
    return growing, warnings + more


def _read_rates(path: Path) -> tuple[list[YawRate], list[str]]:
    rows, warnings = read_table(path, ("stamp_s", "wz_radps"))
    growing, more = keep_growing([YawRate(row.stamp_s, row["wz_radps"]) for row in rows], _numbers(rows), path)
    return growing, warnings + more


def _numbers(rows: list[Row]) -> list[int]:
    return [row.number for row in rows]

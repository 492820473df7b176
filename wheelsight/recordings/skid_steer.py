"""Four encoders of a skid-steered robot beside an IMU: encoders.csv, imu.csv and, if there is one, reference.txt."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path

from wheelsight.events import WheelTicks, YawRate
from wheelsight.inputs import is_there
from wheelsight.recordings._cameras import choose_calibration
from wheelsight.recordings._wheel_recording import WheelRecording, shipped_robot
from wheelsight.recordings.protocol import Layout, OpenOptions
from wheelsight.recordings.tables import read_columns
from wheelsight.recordings.text import keep_growing
from wheelsight.recordings.tum import read_truth

_SIDES = (("front_left", "rear_left"), ("front_right", "rear_right"))


class SkidSteerReader:
    """Ticks since the reading before of four wheels, and the yaw rate of an IMU.

    encoders.csv: stamp_s, front_right, front_left, rear_right, rear_left, in any order. imu.csv: stamp_s and wz_radps,
    others are left alone. reference.txt: TUM text of the base, by another system. A side's ticks are the sum of its two
    encoders, so that `ticks_per_turn` of a calibration.yaml is twice that of one.
    """

    name = "skid_steer"
    layout = Layout.WHEELS
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
    table, warnings = read_columns(path, counts=(*_SIDES[0], *_SIDES[1]))
    left, right = (accumulate(map(sum, zip(*(table[name] for name in side), strict=True))) for side in _SIDES)
    growing, more = keep_growing(list(map(WheelTicks, table.stamps_s, left, right)), table.lines, path)
    return growing, warnings + more


def _read_rates(path: Path) -> tuple[list[YawRate], list[str]]:
    table, warnings = read_columns(path, numbers=("wz_radps",))
    growing, more = keep_growing(list(map(YawRate, table.stamps_s, table["wz_radps"])), table.lines, path)
    return growing, warnings + more

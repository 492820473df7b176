"""camera_clock.csv: how each frame of a live camera got its stamp, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wheelsight.inputs import is_there
from wheelsight.recordings.growing_text import seconds
from wheelsight.recordings.tables import Row, read_table

CLOCK_FILE = "camera_clock.csv"
CLOCK_HEADER = "stamp_s,stamp_sigma_s,arrived_s,device_s,sequence"


@dataclass(frozen=True, slots=True)
class FrameClock:
    """Of one frame; all times but `device_s` are of the host's clock.

    Attributes:
        stamp_s: of the frame, mapped from the camera's clock.
        stamp_sigma_s: standard deviation of that mapping.
        arrived_s: when the host was handed the frame.
        device_s: the camera's own stamp, by its own clock; None where it has none.
        sequence: the camera's own number of it; None where it has none.
    """

    stamp_s: float
    stamp_sigma_s: float
    arrived_s: float
    device_s: float | None = None
    sequence: int | None = None

    @property
    def line(self) -> str:
        """Of the file; what is not known is left empty."""
        device = "" if self.device_s is None else seconds(self.device_s)
        numbers = (seconds(value) for value in (self.stamp_s, self.stamp_sigma_s, self.arrived_s))
        return ",".join([*numbers, device, "" if self.sequence is None else str(self.sequence)]) + "\n"


def read_frame_clocks(folder: Path) -> tuple[FrameClock, ...]:
    """Of each frame of a recording in wheelsight's own layout; none where it has no such file.

    Raises RecordingError.
    """
    path = folder / CLOCK_FILE
    if not is_there(path):
        return ()
    rows, _ = read_table(path, CLOCK_HEADER.split(","))
    return tuple(map(_clock, rows))


def _clock(row: Row) -> FrameClock:
    known = {name: bool(row.words[row.columns[name]]) for name in ("device_s", "sequence")}
    device_s = row["device_s"] if known["device_s"] else None
    sequence = row.whole("sequence") if known["sequence"] else None
    return FrameClock(row.stamp_s, row["stamp_sigma_s"], row["arrived_s"], device_s, sequence)

"""RealTimeRecord: how a recording went that was played in real time."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class RealTimeRecord:
    """Frames answered and dropped, and how late the answers were.

    Attributes:
        played_s: how long it was played.
        frames: how many came by; each was answered or dropped.
        dropped: overtaken by a newer one before anyone was free to look at them.
        unread: of these, overtaken before they were decoded.
        readings: of wheels and gyroscope, all answered.
        latency_median_s, latency_p95_s: from a frame's stamp to its answer (without frames, a reading's); None of none.
        wheels_from: the port, pipe or file that the wheel readings came from; None for the recording's own.
        is_live: whether no recording was played.
        camera: what the live camera is called, or None.
    """

    played_s: float
    frames: int
    dropped: int
    unread: int
    readings: int
    latency_median_s: float | None = None
    latency_p95_s: float | None = None
    wheels_from: str | None = None
    is_live: bool = False
    camera: str | None = None

    @property
    def answered_per_s(self) -> float:
        """Frames a second, or readings where there are no frames."""
        answered = self.frames - self.dropped if self.frames else self.readings
        return answered / self.played_s if self.played_s > 0 else 0.0

    @property
    def dropped_share(self) -> float:
        """Of the frames that came by."""
        return self.dropped / self.frames if self.frames else 0.0

    @property
    def sentence(self) -> str:
        """Such as "played in real time: 29.8 frames/s answered, latency 31 ms median, 52 ms 95 %"."""
        how = "live" if self.is_live else "played in real time"
        parts = [f"{how}: {self.answered_per_s:.1f} {'frames' if self.frames else 'readings'}/s answered"]
        if self.latency_median_s is not None and self.latency_p95_s is not None:
            parts.append(f"latency {1e3 * self.latency_median_s:.0f} ms median, {1e3 * self.latency_p95_s:.0f} ms 95 %")
        return ", ".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """All figures, the unit in each name, latencies in milliseconds."""
        figures = asdict(self)
        late = {name: figures.pop(f"{name}_s") for name in ("latency_median", "latency_p95")}
        return {
            **figures,
            "answered_per_s": self.answered_per_s,
            "dropped_share": self.dropped_share,
            **{f"{name}_ms": None if seconds is None else 1e3 * seconds for name, seconds in late.items()},
        }

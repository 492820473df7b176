"""LiveCamera: what every camera that is plugged in offers, whatever its library; and what is known of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from wheelsight.calibration import Calibration
from wheelsight.events import AngularVelocity, RgbdFrame, SkippedFrame
from wheelsight.geometry.arrays import UInt16Array


@dataclass(frozen=True, slots=True, eq=False)
class LiveFrame:
    """One frame of a live camera, and when and how surely it was taken.

    All times but `device_s` are of the one host clock (`host_clock.now_s`).

    Attributes:
        frame: the images; its `stamp_s` is when colour was taken, its `index` counts the frames the camera took since
            it was opened, lost ones included.
        stamp_sigma_s: standard deviation of the mapping from the device's clock to the host's. A delay that all frames
            share, from exposure to arrival, is not in it: no observer of arrivals can tell that one.
        device_s: the camera's own stamp, in seconds of its own clock; None where it has none.
        arrived_s: when the host was handed the frame.
        sequence: the camera's own number of the frame; None where it has none. Not continuous over a reconnection.
        infrared: (H, W) as the sensor gives it, on the depth image's pixels; None where it was not asked for.
    """

    frame: RgbdFrame
    stamp_sigma_s: float
    device_s: float | None
    arrived_s: float
    sequence: int | None
    infrared: UInt16Array | None = None

    def age_s(self, now_s: float) -> float:
        """How long before `now_s` it was taken."""
        return now_s - self.frame.stamp_s


class CameraStatus(StrEnum):
    """How a camera is doing."""

    STARTING = "starting: no frame has come yet"
    STREAMING = "streaming"
    STALLED = "stalled: no frame comes"
    UNPLUGGED = "unplugged: waiting for it"
    ENDED = "the recording it plays has ended"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class CameraReport:
    """How a camera is doing at one moment. Counts are since it was opened.

    Attributes:
        status: now.
        since_s: since when it has been so, host clock; a stall counts from the last frame.
        detail: what the camera's library said last of a failure, or "".
        frames: that were kept for whoever asks.
        device_drops: that the camera or the bus lost, by gaps in the camera's numbers.
        host_drops: that were dropped since nobody fetched them.
        stale: that were too old when they were fetched.
        refused: that were duplicates, out of order, or of a wrong size or kind.
        reconnects: how often the camera went away and came again.
        clock_jumps: how often the camera's clock leapt; stamps were mapped anew.
        rate_hz: of frames over the last seconds; 0 where none came.
        drift_ppm: how much faster than the host's the camera's clock runs.
        last_stamp_s: of the newest frame; None before the first.
    """

    status: CameraStatus
    since_s: float
    detail: str = ""
    frames: int = 0
    device_drops: int = 0
    host_drops: int = 0
    stale: int = 0
    refused: int = 0
    reconnects: int = 0
    clock_jumps: int = 0
    rate_hz: float = 0.0
    drift_ppm: float = 0.0
    last_stamp_s: float | None = None


@runtime_checkable
class LiveCamera(Protocol):
    """A camera that streams on a thread of its own, from when it was opened until it is closed.

    The newest few frames are kept; nothing is handed out twice, nor out of order, nor when it is older than asked for.
    A camera that is unplugged yields nothing, and goes on by itself when it is there again; `report` tells both.
    It is opened by `open_live_camera`.
    """

    @property
    def name(self) -> str:
        """Its kind and serial number or file, for people."""

    @property
    def calibration(self) -> Calibration:
        """Of its cameras, as the device or its data sheet tells; the source says which."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting its images, one sentence each."""

    def read(self, timeout_s: float) -> LiveFrame | None:
        """The next frame, or None if none comes within `timeout_s` seconds, or the camera has ended or is closed."""

    def take(self) -> Sequence[RgbdFrame | SkippedFrame]:
        """What came since the last call, in order, refused frames with the reason; waits for none."""

    def report(self) -> CameraReport:
        """Everything a person may want to see."""

    def close(self) -> None:
        """Give the camera back; may be called twice."""

    def __enter__(self) -> Self:
        """Itself, to be closed at the block's end."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""


@runtime_checkable
class HasGyro(Protocol):
    """A `LiveCamera` that may carry a gyroscope."""

    def take_angular_velocities(self) -> Sequence[AngularVelocity]:
        """Readings since the last call, at growing stamps of the host's clock; waits for none."""


def take_angular_velocities(camera: object) -> Sequence[AngularVelocity]:
    """Of a camera that may be none with a gyroscope; nothing then."""
    return camera.take_angular_velocities() if isinstance(camera, HasGyro) else ()

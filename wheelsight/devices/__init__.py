"""The wheel controller: its serial protocol, the link to it, and the telemetry pipe."""

from wheelsight.devices.clock import ClockMap
from wheelsight.devices.continuity import TickTracker
from wheelsight.devices.link import BAUDRATE, LinkReport, LinkStatus, WheelLink
from wheelsight.devices.pipe import TelemetryPipe
from wheelsight.devices.protocol import FrameDecoder, LineStatistics, Version
from wheelsight.devices.recognition import Format, LineDecoder
from wheelsight.devices.robot_link import LinkRobot
from wheelsight.devices.source import TelemetryReader, TicksFile, WheelSource, is_recorded, open_wheels

__all__ = [
    "BAUDRATE",
    "ClockMap",
    "Format",
    "FrameDecoder",
    "LineDecoder",
    "LineStatistics",
    "LinkReport",
    "LinkRobot",
    "LinkStatus",
    "TelemetryPipe",
    "TelemetryReader",
    "TickTracker",
    "TicksFile",
    "Version",
    "WheelLink",
    "WheelSource",
    "is_recorded",
    "open_wheels",
]

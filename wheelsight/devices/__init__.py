"""Live cameras; the wheel controller: its serial protocol, the link to it, and the telemetry pipe."""

from wheelsight.devices.camera_driver import CameraDriver, DeviceImages, OpenedDevice, PlaybackEndedError
from wheelsight.devices.cameras import open_live_camera
from wheelsight.devices.clock import ClockMap
from wheelsight.devices.continuity import TickTracker
from wheelsight.devices.link import BAUDRATE, LinkReport, LinkStatus, WheelLink
from wheelsight.devices.live_camera import CameraReport, CameraStatus, LiveCamera, LiveFrame
from wheelsight.devices.pipe import TelemetryPipe
from wheelsight.devices.protocol import FrameDecoder, LineStatistics, Version
from wheelsight.devices.recognition import Format, LineDecoder
from wheelsight.devices.robot_link import LinkRobot
from wheelsight.devices.source import TelemetryReader, TicksFile, WheelSource, is_recorded, open_wheels
from wheelsight.devices.streaming import StreamingCamera

__all__ = [
    "BAUDRATE",
    "CameraDriver",
    "CameraReport",
    "CameraStatus",
    "ClockMap",
    "DeviceImages",
    "Format",
    "FrameDecoder",
    "LineDecoder",
    "LineStatistics",
    "LinkReport",
    "LinkRobot",
    "LinkStatus",
    "LiveCamera",
    "LiveFrame",
    "OpenedDevice",
    "PlaybackEndedError",
    "StreamingCamera",
    "TelemetryPipe",
    "TelemetryReader",
    "TickTracker",
    "TicksFile",
    "Version",
    "WheelLink",
    "WheelSource",
    "is_recorded",
    "open_live_camera",
    "open_wheels",
]

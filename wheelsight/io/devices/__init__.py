"""Live cameras; the wheel controller: its serial protocol, the link to it, and the telemetry pipe."""

from wheelsight.io.devices.camera_driver import CameraDriver, DeviceImages, OpenedDevice, PlaybackEndedError
from wheelsight.io.devices.cameras import open_live_camera
from wheelsight.io.devices.host_clock import ClockMap
from wheelsight.io.devices.live_camera import CameraReport, CameraStatus, LiveCamera, LiveFrame, StreamingCamera
from wheelsight.io.devices.robot_link import LinkRobot
from wheelsight.io.devices.tick_tracking import TickTracker
from wheelsight.io.devices.wheel_link import BAUDRATE, LinkReport, LinkStatus, WheelLink
from wheelsight.io.devices.wheel_source import (
    TelemetryPipe,
    TelemetryReader,
    TicksFile,
    WheelSource,
    is_recorded,
    open_wheels,
)
from wheelsight.io.devices.wire_formats import Format, FrameDecoder, LineDecoder, LineStatistics, Version

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

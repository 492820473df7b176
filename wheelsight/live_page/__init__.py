"""The live page: a robot seen and led from a browser, on this computer or, with a token, from another."""

from wheelsight.live_page.access import Access, is_loopback
from wheelsight.live_page.driven import Driven, Maps, Places, Watch
from wheelsight.live_page.maps import NEW, DriveMaps
from wheelsight.live_page.session import Session
from wheelsight.live_page.snapshot import Snapshot
from wheelsight.live_page.stop_switch import StoppableRobot, StopSwitch

__all__ = [
    "NEW",
    "Access",
    "DriveMaps",
    "Driven",
    "Maps",
    "Places",
    "Session",
    "Snapshot",
    "StopSwitch",
    "StoppableRobot",
    "Watch",
    "is_loopback",
]

"""The live page: a robot seen and led from a browser, on this computer or, with a token, from another.

A name is loaded when it is first asked for: the door (`live_page.door`), a process of its own, needs few of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
_NAMES_OF = {
    "access": ("Access", "is_loopback"),
    "driven": ("Driven", "Maps", "Places", "Watch"),
    "maps": ("NEW", "DriveMaps"),
    "session": ("Session",),
    "snapshot": ("Snapshot",),
    "stop_switch": ("StopSwitch", "StoppableRobot"),
}
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'wheelsight.live_page' has no attribute {name!r}")
    return getattr(import_module(f"wheelsight.live_page.{_MODULE_OF[name]}"), name)

"""The live page: a robot seen and led from a browser, on this computer or, with a token, from another.

Each name is loaded at its first use: the door (`page.door`), a process of its own, needs few of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wheelsight.app.page.access import Access, is_loopback
    from wheelsight.app.page.maps import NEW, DriveMaps
    from wheelsight.app.page.session import Session
    from wheelsight.app.page.snapshot import Driven, Watch
    from wheelsight.app.page.stop_switch import StopSwitch

__all__ = ["NEW", "Access", "DriveMaps", "Driven", "Session", "StopSwitch", "Watch", "is_loopback", "token_of"]

_MODULE_OF = {
    **dict.fromkeys(("Access", "is_loopback", "token_of"), "access"),
    **dict.fromkeys(("DriveMaps", "NEW"), "maps"),
    "Session": "session",
    **dict.fromkeys(("Driven", "Watch"), "snapshot"),
    "StopSwitch": "stop_switch",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'wheelsight.app.page' has no attribute {name!r}")
    return getattr(import_module(f"wheelsight.app.page.{_MODULE_OF[name]}"), name)

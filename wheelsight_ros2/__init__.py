"""Live interfaces to other programs: Foxglove, and ROS 2 without a ROS installation.

Each name is loaded at its first use.
"""

from typing import TYPE_CHECKING, Any

from wheelsight.core.runtime import public_name

if TYPE_CHECKING:
    from wheelsight_ros2.bridge import Bridge, LinkSettings, RunBridge, Watches, open_bridge
    from wheelsight_ros2.foxglove import FoxgloveServer
    from wheelsight_ros2.inputs import Inputs, Stick
    from wheelsight_ros2.live_topics import LiveTopics

__all__ = [
    "Bridge",
    "FoxgloveServer",
    "Inputs",
    "LinkSettings",
    "LiveTopics",
    "RunBridge",
    "Stick",
    "Watches",
    "open_bridge",
]


def __getattr__(name: str) -> Any:
    return public_name(__name__, name, __all__, ("bridge", "foxglove", "inputs", "live_topics"))

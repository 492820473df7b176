"""What a navigator's feedback is called where people read it."""

from __future__ import annotations

from wheelsight.estimates import Status
from wheelsight.navigation.collision_monitor import MonitorState
from wheelsight.navigation.navigator_values import Feedback

STATUS_WORDS = {
    Status.INITIALIZING: "looks for its place in the map",
    Status.TRACKING: "knows where it is",
    Status.COASTING: "by its wheels alone",
    Status.FAILING: "does not trust where it is",
    Status.LOST: "lost",
}


def monitor_words(feedback: Feedback) -> str:
    """What the collision monitor does and why, and what stays in the way without depth behind it."""
    found, stays = feedback.monitor, f"; {feedback.stays}" if feedback.stays else ""
    if found is None or found.state is MonitorState.FREE:
        return f"lets it drive{stays}"
    does = "slows it down" if found.state is MonitorState.SLOWED else "holds it"
    return f"{does}: {found.reason}{stays}" if found.reason is not None else f"{does}{stays}"

"""What watches a drive: the terminal and, where that is asked for, Rerun."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from wheelsight.cli._drive_view import DriveView

if TYPE_CHECKING:
    from wheelsight.config import Config
    from wheelsight.events import Event
    from wheelsight.navigation import Feedback, Navigator, Transition
    from wheelsight.robots import Robot
    from wheelsight.viewer import DriveLog


class DriveWatch:
    """See the module.

    Attributes:
        view: of the terminal; what is said before it is entered comes above it.
    """

    def __init__(self, view: DriveView, log: DriveLog | None = None) -> None:
        self.view, self._log = view, log

    def hear(self, events: Sequence[Event]) -> None:
        """What the robot's sensors said."""
        if self._log is not None:
            self._log.hear(events)

    def note(self, transition: Transition) -> None:
        """A change of the navigator's state."""
        self.view.note(transition)
        if self._log is not None:
            self._log.note(transition)

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """A period is over."""
        self.view.show(feedback, navigator)
        if self._log is not None:
            self._log.step(feedback, navigator)


@contextmanager
def watching(rerun: str | None, robot: Robot, config: Config) -> Iterator[DriveWatch]:
    """Raises as `open_drive_log`."""
    view = DriveView(config.navigation.footprint.outline)
    if rerun is None:
        yield DriveWatch(view)
        return
    from wheelsight.viewer import open_drive_log

    with open_drive_log(rerun, robot.calibration, config.viewer) as log:
        yield DriveWatch(view, log)

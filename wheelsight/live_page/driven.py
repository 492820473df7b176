"""What a session drives in: a map with its navigator and its named places, as one of several that can be chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from wheelsight.events import Event
from wheelsight.geometry import FloatArray
from wheelsight.navigation import Feedback, Navigator, Transition
from wheelsight.robots import Robot


class Places(Protocol):
    """Named places of a map."""

    def where(self) -> Mapping[str, FloatArray]:
        """(3,) x, y, yaw of each by its name, where it is by now."""

    def name(self, name: str, pose: FloatArray) -> None:
        """Call a pose (3,) so. Raises MapError, OutputError."""


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A map that is driven in.

    Attributes:
        navigator: that leads the robot in it.
        places: of it.
        is_new: whether it is being made; else it is one of before.
    """

    navigator: Navigator
    places: Places
    is_new: bool


class Maps(Protocol):
    """Maps that a session can drive in."""

    @property
    def first(self) -> str:
        """The name of the one to begin with."""

    def names(self) -> tuple[str, ...]:
        """Of all that can be driven in now."""

    def last_saved(self) -> str:
        """The name of the one that was made last."""

    def opened(
        self, name: str, robot: Robot, pose: FloatArray | None, on_transition: Callable[[Transition], None]
    ) -> AbstractContextManager[Driven]:
        """Drive in one, of a robot that stands at (3,) in it, or that is to be found. Raises WheelsightError."""


class Watch(Protocol):
    """What sees all that a session drives, beside its pages, such as `wheelsight.viewer.DriveLog`."""

    def hear(self, events: Sequence[Event]) -> None:
        """What the robot's sensors said."""

    def note(self, transition: Transition) -> None:
        """A change of the navigator's state."""

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """A period is over; another navigator than before drives in another map."""

"""What a test knows to be there, where the type allows for its absence too."""

from __future__ import annotations

from typing import TypeVar

from wheelsight.core.messages import Event, RgbdFrame

T = TypeVar("T")


def not_none(value: T | None) -> T:
    """The value, which the test fails without."""
    assert value is not None
    return value


def as_frame(event: Event) -> RgbdFrame:
    """The event, which the test fails without its being a frame."""
    assert isinstance(event, RgbdFrame)
    return event


def of_type(kind: type[T], value: object) -> T:
    """The value, which the test fails without its being of this type."""
    assert isinstance(value, kind)
    return value

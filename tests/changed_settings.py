"""Settings with one value changed, as a user may change it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from wheelsight.config import Config
from wheelsight.core.settings import Settings


def leaves(settings: Settings, name: str = "") -> Iterator[tuple[str, Any, FieldInfo]]:
    """Dotted name, value and field of each setting that is no section."""
    for own, about in type(settings).model_fields.items():
        value = getattr(settings, own)
        if isinstance(value, Settings):
            yield from leaves(value, f"{name}{own}.")
        else:
            yield f"{name}{own}", value, about


def sections(settings: Settings, name: str = "") -> Iterator[tuple[str, Settings]]:
    """Dotted name and value of each section that has settings of its own, and not only sections."""
    for own in type(settings).model_fields:
        value = getattr(settings, own)
        if isinstance(value, Settings):
            if any(True for _ in leaves(value)):
                yield f"{name}{own}", value
            yield from sections(value, f"{name}{own}.")


def all_leaves() -> list[tuple[str, Any, FieldInfo]]:
    return [*leaves(Config())]


def bounds(about: FieldInfo) -> dict[str, float]:
    """Such as {"gt": 0, "le": 10}."""
    names = ("gt", "ge", "lt", "le")
    return {name: getattr(rule, name) for rule in about.metadata for name in names if hasattr(rule, name)}


def numbers(kind: type[Settings]) -> list[str]:
    """The settings of a class that are numbers."""
    return [name for name, about in kind.model_fields.items() if type(about.default) in (int, float)]


def variants(kind: type[Settings], name: str) -> Iterator[Settings]:
    """The defaults but for one number, which is larger or smaller."""
    default = kind.model_fields[name].default
    for factor in (0.1, 0.5, 0.9, 1.1, 2.0, 10.0):
        value = round(default * factor) if isinstance(default, int) else default * factor
        try:
            yield kind(**{name: value})
        except ValidationError:
            continue

"""Settings from strangers: checked by their model, and what is wrong with the first told in a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from wheelsight.errors import InputError

_CONFLICT = "conflict"
_Settings = TypeVar("_Settings", bound=BaseModel)


@dataclass(frozen=True, slots=True, eq=False)
class Fault:
    """The first wrong setting of a model.

    Attributes:
        location: names of the sections it lies in, and its own; empty where settings do not fit each other.
        known: names of the settings that there are beside it.
        details: pydantic's.
    """

    location: tuple[str, ...]
    known: tuple[str, ...]
    details: dict[str, Any]

    @classmethod
    def of(cls, invalid: ValidationError, model: type[BaseModel]) -> Fault:
        """What `model` found."""
        details: dict[str, Any] = dict(invalid.errors(include_url=False)[0])
        location = tuple(part for part in details["loc"] if isinstance(part, str))  # a setting, not its place in a list
        if details["type"] == _CONFLICT:
            location += tuple(details["ctx"]["setting"].split("."))
        return cls(location, tuple(_known_settings(model, location[:-1])), details)

    def told(self, name: str | None = None) -> tuple[str, str | None]:
        """What is wrong with the setting, which the user knows by `name`, and what would be right."""
        details, name = self.details, ".".join(self.location) if name is None else name
        if details["type"] == _CONFLICT:
            return f"{name} {details['ctx']['problem']}", details["ctx"]["fix"]
        if details["type"] == "extra_forbidden":
            near = get_close_matches(self.location[-1], self.known, n=1)
            return f"unknown setting {name}", f"did you mean {near[0]}?" if near else f"known: {', '.join(self.known)}"
        if details["type"] == "missing":
            return f"{name} is missing", None
        if details["type"] == "literal_error":
            return f"{name} is {details['input']!r}", f"known: {details['ctx']['expected']}"
        message = details["msg"].removeprefix("Value error, ").removeprefix("Input ")
        return f"{name} is {details['input']!r}, which {message}" if name else message, None


def checked_settings(
    model: type[_Settings], values: Any, error: type[InputError], whose: str, fix: str | None = None
) -> _Settings:
    """Settings of a file.

    Args:
        model: what they are of.
        values: names and values, as the file has them.
        error: raised where they are wrong.
        whose: begins the message, such as "settings: ".
        fix: what to do; None: what would be right, where that can be said.
    """
    try:
        return model.model_validate(values)
    except ValidationError as invalid:
        problem, right = Fault.of(invalid, model).told()
        raise error(f"{whose}{problem}", fix=fix or right) from invalid


def _known_settings(model: Any, section: Sequence[str]) -> list[str]:
    for part in section:
        field = getattr(model, "model_fields", {}).get(part)
        if field is None:
            return []
        model = next((kind for kind in get_args(field.annotation) if _is_settings(kind)), field.annotation)
    return sorted(getattr(model, "model_fields", {}))


def _is_settings(kind: Any) -> bool:
    return get_origin(kind) is None and isinstance(kind, type) and issubclass(kind, BaseModel)

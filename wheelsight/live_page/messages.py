"""What a page may say, and nothing else: strict models, told apart by their `type`."""

from __future__ import annotations

import json
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from wheelsight.errors import ArgumentError

_FARTHEST_M, _LONGEST_NAME = 1e4, 60
_Name = Annotated[str, Field(min_length=1, max_length=_LONGEST_NAME)]


class _Message(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Alive(_Message):
    """The page is open, and its connection holds."""

    type: Literal["alive"]


class Take(_Message):
    """Who says so drives from now on."""

    type: Literal["take"]


class Leave(_Message):
    """Who says so drives no more."""

    type: Literal["leave"]


class ShowCostmap(_Message):
    """Whether the page shows the costmap."""

    type: Literal["costmap"]
    shown: bool


class GoToPose(_Message):
    """Drive to a place in `map`; without a yaw, to any heading."""

    type: Literal["goal"]
    x_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)
    y_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)
    yaw_rad: float | None = Field(default=None, ge=-7, le=7)


class GoToName(_Message):
    """Drive to a named place."""

    type: Literal["go"]
    name: _Name


class ClearObstacles(_Message):
    """Nothing is about a place in `map`, says the driver, who sees it: forget what the camera met there."""

    type: Literal["clear"]
    x_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)
    y_m: float = Field(ge=-_FARTHEST_M, le=_FARTHEST_M)


class Explore(_Message):
    """Look at all floor that can be reached."""

    type: Literal["explore"]


class NamePlace(_Message):
    """Call the place where the robot is."""

    type: Literal["name"]
    name: _Name


class SaveMap(_Message):
    """Write the map that is being made, and go on in it."""

    type: Literal["save"]


class StartMap(_Message):
    """Go on in another map."""

    type: Literal["start"]
    map: Annotated[str, Field(min_length=1, max_length=200)]


Task = GoToPose | GoToName | ClearObstacles | Explore | NamePlace | SaveMap | StartMap
"""What the driver alone may ask."""
Message = Alive | Take | Leave | ShowCostmap | Task
_ANY: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def says_stop(text: str) -> bool:
    """Whether a message is to stop, whatever else it holds: nobody in need is asked for the right form."""
    if '"stop"' not in text:
        return False
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return False
    return isinstance(found, dict) and found.get("type") == "stop"


def parsed(text: str) -> Message:
    """A message. Raises ArgumentError: it is none, in one line."""
    try:
        return _ANY.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"][1:])
        raise ArgumentError(f"a message of no sense: {f'{where}: ' if where else ''}{first['msg']}") from None

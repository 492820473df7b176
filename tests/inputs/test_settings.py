from __future__ import annotations

from typing import Any, Literal, Self

import pytest
from pydantic import BaseModel, ConfigDict, Field, model_validator

from wheelsight.core.errors import MapError
from wheelsight.core.settings import conflict
from wheelsight.core.settings.base import checked_settings


class Lamp(BaseModel):
    model_config = ConfigDict(extra="forbid")

    watts: float = Field(default=5.0, gt=0)
    colour: Literal["red", "blue"] = "red"


class Room(BaseModel):
    model_config = ConfigDict(extra="forbid")

    lamp: Lamp | None = None
    low_m: float = 0.0
    high_m: float = 2.5
    is_dark: bool = False

    @model_validator(mode="after")
    def _is_a_room(self) -> Self:
        if self.low_m >= self.high_m:
            raise ValueError(f"{self.low_m} to {self.high_m} m is no room")
        if self.is_dark and self.lamp is not None:
            raise conflict("is_dark", "is contradicted by a lamp", "take the lamp away")
        return self


def test_sound_settings_are_made() -> None:
    assert checked_settings(Room, {"lamp": {"watts": 7}}, MapError, "") == Room(lamp=Lamp(watts=7))


@pytest.mark.parametrize(
    ("values", "reported"),
    [
        ({"lamp": {"watts": -1}}, "settings: lamp.watts is -1, which should be greater than 0"),
        ({"lamp": {"colour": "green"}}, "settings: lamp.colour is 'green' (known: 'red' or 'blue')"),
        ({"lamp": {"wats": 1}}, "settings: unknown setting lamp.wats (did you mean watts?)"),
        ({"q": 1}, "settings: unknown setting q (known: high_m, is_dark, lamp, low_m)"),
        ({"low_m": 3}, "settings: 3.0 to 2.5 m is no room"),
        ({"is_dark": True, "lamp": {}}, "settings: is_dark is contradicted by a lamp (take the lamp away)"),
        (7, "settings: should be a valid dictionary or instance of Room"),
    ],
)
def test_the_first_wrong_setting_is_reported(values: Any, reported: str) -> None:
    with pytest.raises(MapError) as caught:
        checked_settings(Room, values, MapError, "settings: ")
    assert str(caught.value) == reported


def test_a_fix_for_all_of_them_stands() -> None:
    with pytest.raises(MapError, match=r"lamp.watts is 0, which should be greater than 0 \(make it again\)$"):
        checked_settings(Room, {"lamp": {"watts": 0}}, MapError, "", "make it again")

"""What pages may say: strict, in one line refused; and STOP, which is heard in whatever form."""

from __future__ import annotations

import json

import pytest

from wheelsight.app.page.session import ClearFault, ClearObstacles, GoToPose, NamePlace, parsed, says_stop
from wheelsight.core.errors import ArgumentError


def test_a_goal_has_a_heading_or_none() -> None:
    assert parsed('{"type": "goal", "x_m": 1, "y_m": -2.5}') == GoToPose(type="goal", x_m=1.0, y_m=-2.5)
    found = parsed('{"type": "goal", "x_m": 1.5, "y_m": 2, "yaw_rad": 3.1}')
    assert isinstance(found, GoToPose)
    assert found.yaw_rad == 3.1


def test_a_driver_may_say_that_nothing_is_at_a_place() -> None:
    assert parsed('{"type": "wheels"}') == ClearFault(type="wheels")
    assert parsed('{"type": "clear", "x_m": 1, "y_m": -2.5}') == ClearObstacles(type="clear", x_m=1.0, y_m=-2.5)


def test_a_place_is_named_in_any_letters() -> None:
    assert parsed(json.dumps({"type": "name", "name": "Küche"})) == NamePlace(type="name", name="Küche")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no json",
        "[]",
        "1",
        "null",
        '{"type": "fly"}',
        '{"x_m": 1, "y_m": 2}',
        '{"type": "goal", "x_m": 1}',
        '{"type": "goal", "x_m": "1", "y_m": 2}',
        '{"type": "goal", "x_m": NaN, "y_m": 2}',
        '{"type": "clear", "x_m": 1}',
        '{"type": "clear", "x_m": Infinity, "y_m": 2}',
        '{"type": "goal", "x_m": 1e9, "y_m": 2}',
        '{"type": "goal", "x_m": 1, "y_m": 2, "yaw_rad": 40}',
        '{"type": "goal", "x_m": 1, "y_m": 2, "z_m": 2}',
        '{"type": "name", "name": ""}',
        '{"type": "name", "name": 7}',
        json.dumps({"type": "name", "name": "n" * 61}),
        '{"type": "costmap", "shown": "yes"}',
        "[" * 1000,
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line(text: str) -> None:
    with pytest.raises(ArgumentError, match="a message of no sense") as refused:
        parsed(text)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "stops"),
    [
        ('{"type": "stop"}', True),
        ('{"type":"stop","at":[1,2],"x_m":"many"}', True),
        ('{"type": "go", "name": "stop"}', False),
        ('{"type": "name", "name": "\\"stop\\""}', False),
        ('"stop"', False),
        ('["type", "stop"]', False),
        ('{"type": "stop"', False),
        ('{"a":' * 5000 + '"stop"', False),
    ],
)
def test_stop_is_reported_from_all_else(text: str, stops: bool) -> None:
    assert says_stop(text) is stops

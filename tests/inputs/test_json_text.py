from __future__ import annotations

import pytest

from wheelsight.core.inputs import parse_json


def test_plain_json_is_read() -> None:
    assert parse_json(b'{"a": [1, 2.5, null, "\\u00e9"]}') == {"a": [1, 2.5, None, "é"]}
    assert parse_json("[" * 60 + "]" * 60)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[" * 66 + "]" * 66, "is nested deeper than 64 levels"),
        ("[" * 100_000 + "]" * 100_000, "is nested too deeply"),
        ('{"a":' * 200 + "1" + "}" * 200, "is nested deeper than 64 levels"),
        ("[" + "0," * 1_000_000 + "0]", "holds more than 1000000 values"),
        ("[NaN]", "holds NaN"),
        ("-Infinity", "holds -Infinity"),
        ("18446744073709551616", "beyond 64 bits"),
        ("9" * 5000, "digits"),
        ("[1", "Expecting"),
    ],
)
def test_hostile_json_is_a_value_error(text: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        parse_json(text)

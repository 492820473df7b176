"""YAML from strangers ends in values or in one line with file, line and fix, quickly and in little memory."""

from __future__ import annotations

from pathlib import Path

import pytest

from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.inputs import line_of, parse_yaml

PATH = Path("robot.yaml")
LAUGHS = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{now}: &{now} [{','.join([f'*{last}'] * 9)}]\n" for last, now in zip("abcdefgh", "bcdefghi", strict=True)
)


def parsed(text: str) -> object:
    return parse_yaml(text, PATH, CalibrationError)


def test_plain_values_aliases_and_merges_are_read() -> None:
    text = "robot: &r {wheels: [1, 2.5, .inf], name: ~}\nother: {<<: *r, name: 'x'}\nagain: [*r, *r]\n"
    robot = {"wheels": [1, 2.5, float("inf")], "name": None}
    assert parsed(text) == {"robot": robot, "other": robot | {"name": "x"}, "again": [robot, robot]}


def test_dates_stay_as_they_are_written() -> None:
    assert parsed("source: 2024-05-02\nother: 2024-13-45") == {"source": "2024-05-02", "other": "2024-13-45"}


def test_what_opencv_writes_is_read() -> None:
    text = "%YAML:1.0\nmatrix: !!opencv-matrix\n   rows: 1\n   data: [ 1., 2. ]\n"
    assert parsed(text) == {"matrix": {"rows": 1, "data": [1.0, 2.0]}}


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (LAUGHS, ":6: holds more than 100000 values, aliases counted as what they stand for"),
        ("a: &a [1, *a]", ":1: alias 'a' stands for what it lies in"),
        ("".join(" " * level + "a:\n" for level in range(200)), ":33: is nested deeper than 32 levels"),
        ("a: " + "[" * 33, ":1: is nested deeper than 32 levels"),
        ("{a: " * 100_000, ":1: is n"),
        ("- " * 100_000, ":1: is nested deeper than 32 levels"),
        ("a: 1\nb: " + "9" * 5000, ":2: '9999"),
        ("a: 1\nb: 18446744073709551616", ":2: '18446744073709551616' is beyond every number"),
        ("b: 1e100", ":1: '1e100' is beyond every number"),
        ("b: 1.0e+100", ":1: '1.0e+100' is beyond every number"),
        ("b: '-1e100'", ":1: '-1e100' is beyond every number"),
        ("a: !!int ''", ":1: '' is no int"),
        ("a: !!float x", ":1: 'x' is no float"),
        ("a: !!bool ''", ":1: '' is no bool"),
        ("a: !!timestamp x", ":1: has the tag 'tag:yaml.org,2002:timestamp', which means nothing here"),
        ("a: !robot {}", ":1: has the tag '!robot', which means nothing here"),
        ("[a]: 1", ":1: is not YAML: found unhashable key"),
        ("a: 1\nb: [", ":3: is not YAML: did not find expected node content"),
        ("a: 1\n--- b", ":2: is not YAML: but found another document"),
        ("a: 1\nb: \x07", ":2: holds the character '\\x07', which YAML does not allow"),
    ],
)
def test_hostile_text_is_refused_in_one_short_line(text: str, reported: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        parsed(text)
    message = str(caught.value)
    assert message.startswith(f"{PATH}{reported}")
    assert message.endswith(" (correct the line, or put the text in quotes)")
    assert len(message) < 300


def test_a_setting_is_found_on_its_line(tmp_path: Path) -> None:
    path = tmp_path / "some.yaml"
    path.write_text("one: 1\ntwo:\n  three: {four: 4}\n  five: 5\ntwo.five: 0\n")
    found = [line_of(path, names, ConfigError) for names in (["one"], ["two", "five"], ["two", "three", "four"])]
    assert found == [1, 4, 3]
    assert line_of(path, ["two", "six"], ConfigError) == 2
    assert line_of(path, ["six"], ConfigError) is None

from __future__ import annotations

import math

import pytest

from wheelsight.core.inputs import as_number, split_words


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1.0 2 \t3", ["1.0", "2", "3"]),
        ("1.0,2, 3", ["1.0", "2", "3"]),
        ("1,5;2;3", ["1,5", "2", "3"]),
        ("1,5 2,25 3", ["1,5", "2,25", "3"]),
        ('"1.0", "a b"', ["1.0", '"a', 'b"']),
        ("'1.0';\"a b\"", ["1.0", "a b"]),
        ("1;2;;", ["1", "2"]),
        ("1,2,", ["1", "2"]),
        ("", []),
    ],
)
def test_words_are_parted_as_their_line_says(line: str, words: list[str]) -> None:
    assert split_words(line) == words


def test_numbers_have_points_or_commas() -> None:
    assert [as_number(word) for word in ("1.5", "-1,5", "1,5e3", ",5")] == [1.5, -1.5, 1500.0, 0.5]
    assert all(math.isnan(as_number(word)) for word in ("", "1,2,3", "x", "1,"))

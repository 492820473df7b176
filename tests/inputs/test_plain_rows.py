"""Rows of plain numbers in bulk: the same numbers as one by one, and nothing where a line is anything else."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from wheelsight.core.inputs import plain_rows


def test_numbers_are_those_that_python_reads(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.import_module("wheelsight.core.inputs.text"), "_PIECE", 100)
    values = [repr(x) for x in (rng.normal(size=500) * 10.0 ** rng.integers(-20, 20, 500)).tolist()]
    counts = rng.integers(-(2**62), 2**62, 500).tolist()
    text = "".join(f"{x} ; {n}\n" for x, n in zip(values, counts, strict=True))
    for ending in ("", "\n", "\n\n  "):
        found = plain_rows(text.strip() + ending, [False, True], ";")
        assert found is not None
        assert found[0].tolist() == [float(x) for x in values]
        assert found[1].tolist() == counts


@pytest.mark.parametrize(
    "text",
    [
        *("", "\n", "1 2\n\n3 4", "1 2\n3", "1 2\n3 4 5", "1 2 # why\n", "1 '2'", "1 two", "1 2.0", "1 2.5"),
        *("1,5 2", "1 2\r3 4", "1 9999999999999999999", "1 0x10"),
    ],
)
def test_anything_else_is_left_to_the_reader_of_lines(text: str) -> None:
    assert plain_rows(text, [False, True], None) is None

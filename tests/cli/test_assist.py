"""`wheelsight assist`: a person drives by a stick."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (("--sim", "studio", "--level", "much"), "--level much"),
        (("--sim", "studio", "--stick", "/dev/input/js99"), "js99"),
        (("--sim", "studio", "--stick", "nothing.txt"), "nothing.txt"),
        ((), "no robot is named"),
    ],
)
def test_what_cannot_be_used_is_named(refusal: Callable[..., str], given: tuple[str, ...], named: str) -> None:
    assert named in refusal("assist", *given)


@pytest.mark.slow
def test_a_file_of_positions_drives_a_simulated_chair(wheelsight: Callable[..., Result], tmp_path: Path) -> None:
    stick = tmp_path / "stick.txt"
    stick.write_text("0 0 0\n0.5 0.3 0\n2.5 0 0.3\n3.0 0 0\n")
    out = tmp_path / "assisted"
    done = wheelsight("assist", "--sim", "studio", "--realism", "ideal", "--stick", stick, "--out", out)
    assert done.exit_code == 0, done.output
    found = json.loads((out / "assist.json").read_text())
    assert found["level"] == "steer"
    assert 45 <= found["periods"] <= 55
    assert found["contradicted_share"] == 0

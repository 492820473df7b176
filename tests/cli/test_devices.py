"""`wheelsight devices`: one line each, or JSON."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.io.devices import plugged_in
from wheelsight.io.devices.plugged_in import PluggedIn

FOUND = [
    PluggedIn("camera", "RealSense D435 123", "--camera realsense:123"),
    PluggedIn("port", "/dev/ttyUSB0", "--wheels /dev/ttyUSB0", "no permission to open it", "join its group"),
]


def test_each_is_reported_in_a_line_with_its_use_or_its_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugged_in, "plugged_in", lambda: FOUND)
    result = CliRunner().invoke(app, ["devices"])
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [
        "RealSense D435 123: ready (--camera realsense:123)",
        "/dev/ttyUSB0: no permission to open it (join its group)",
    ]
    reported = json.loads(CliRunner().invoke(app, ["devices", "--json"]).stdout)
    assert [(device["name"], device["problem"]) for device in reported] == [(d.name, d.problem) for d in FOUND]


def test_nothing_is_reported_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugged_in, "plugged_in", list)
    lines = CliRunner().invoke(app, ["devices"]).stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == ["no depth camera is seen", "no serial port is seen"]

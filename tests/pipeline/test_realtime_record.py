from __future__ import annotations

import json

import pytest

from wheelsight.app.run import RealTimeRecord


def test_the_sentence_says_rate_and_latency() -> None:
    played = RealTimeRecord(60.0, 1800, 12, 3, 3000, 0.0312, 0.0478)
    assert played.sentence == ("played in real time: 29.8 frames/s answered, latency 31 ms median, 48 ms 95 %")


def test_without_frames_readings_are_reported_and_nothing_that_was_not_measured() -> None:
    assert RealTimeRecord(10.0, 0, 0, 0, 500).sentence == "played in real time: 50.0 readings/s answered"
    assert RealTimeRecord(0.0, 0, 0, 0, 0).sentence == "played in real time: 0.0 readings/s answered"


def test_figures_have_their_units_and_are_json() -> None:
    figures = RealTimeRecord(60.0, 1800, 450, 3, 3000, 0.031, 0.048, "/dev/ttyUSB0").to_dict()
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    assert figures["dropped_share"] == 0.25
    assert figures["answered_per_s"] == 22.5
    assert figures["latency_p95_ms"] == pytest.approx(48.0)
    assert "latency_p95_s" not in figures
    assert figures["wheels_from"] == "/dev/ttyUSB0"

"""Wheels, link and firmware: what is measured is measured, and the targets speak of it."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import firmware
from benchmarks.bad_lines import Outcome, decode_damaged, decode_noise
from benchmarks.firmware import FirmwareFigures, measure_firmware
from benchmarks.link import LinkFigures, measure_latency_ms
from benchmarks.places import PlaceTimes, judge_places, places_sheet
from benchmarks.simulation import SimulationFigures, judge_simulation, simulation_sheet
from benchmarks.table import firmware_sheet, link_sheet, wheels_sheet
from benchmarks.targets import judge_firmware, judge_link, judge_wheels
from benchmarks.wheels import WheelTimes, measure_wheels


def figures(noise: Outcome, damaged: Outcome, latency_ms: float = 0.5) -> LinkFigures:
    return LinkFigures(9.0, 4.0, np.full(100, latency_ms), noise, damaged)


def test_damage_and_noise_are_judged_by_what_the_checksum_lets_through() -> None:
    noise, damaged = decode_noise(100_000), decode_damaged(5_000)
    assert (damaged.wrong, damaged.missed) == (0, 0)
    assert damaged.damaged == pytest.approx(500, abs=80)
    verdicts = [target.verdict for target in judge_link(figures(noise, damaged))]
    assert verdicts == ["met", "missed by 1.0 MB/s (20 %)", "met", "met", "met", "met"]
    misled = judge_link(figures(Outcome(wrong=1), Outcome(damaged=100_000, wrong=8, missed=2), 2.5))
    assert [target.is_met for target in misled] == [True, False, False, False, False, False]
    assert judge_link(figures(noise, Outcome(damaged=100_000, wrong=3)))[4].is_met  # 1.5 are expected


@pytest.mark.slow
def test_latency_is_from_the_real_daemon() -> None:
    latencies_ms = measure_latency_ms(frames=20)
    assert latencies_ms.shape == (20,)
    assert 0 < latencies_ms.min() < latencies_ms.max()


def test_dead_reckoning_is_timed() -> None:
    times = measure_wheels(samples=10_000, updates=500)
    assert times.samples == 10_000
    assert times.update_us > 0
    assert times.log_ms > 0
    assert [target.is_met for target in judge_wheels(WheelTimes(1_000_000, 101.0, 120.0, 9.0))] == [False, True]


def test_missing_tools_are_reported_and_meet_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(firmware, "missing_tools", lambda: ["avr-gcc"])
    missing = measure_firmware()
    assert {row[1] for row in firmware_sheet(missing).rows} == {"not measured: avr-gcc is missing"}
    assert {target.verdict for target in judge_firmware(missing)} == {"not measured"}


def test_firmware_figures_stand_in_the_sheet() -> None:
    measured = FirmwareFigures(2666, 259, 7500)
    assert [row[1] for row in firmware_sheet(measured).rows] == ["2,666 bytes", "259 bytes", "7,500 pulses/s"]
    assert [target.verdict for target in judge_firmware(measured)] == ["missed by 333 /s (4 %)", "met", "met"]


def test_every_row_is_as_wide_as_its_header() -> None:
    link = figures(decode_noise(1000), decode_damaged(100))
    for sheet in (link_sheet(link), wheels_sheet(WheelTimes(10, 1.0, 1.0, 1.0)), firmware_sheet(FirmwareFigures())):
        assert {len(row) for row in sheet.rows} == {len(sheet.header)}


def test_simulator_and_places_are_judged_by_their_limits() -> None:
    simulated = SimulationFigures(19.0, 6.5, 300.0, 310.0)
    assert [target.is_met for target in judge_simulation(simulated)] == [False, True, True]
    assert all(len(row) == 2 for row in simulation_sheet(simulated).rows)
    times = [PlaceTimes("layout", 0.5, 1.1, 11.0, 4.0)]
    assert [target.is_met for target in judge_places(times)] == [False, True, True]
    assert [len(row) for row in places_sheet(times).rows] == [len(places_sheet(times).header)]

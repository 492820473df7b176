"""ReadingTimes: readings that are stamped when they arrive, and when they were taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import simulate

from benchmarks.clock_faults import ClockFault, ReadingsJitter, ReadingsStalled, ReadingsTogether
from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.messages import WheelCounts, WheelTicks
from wheelsight.wheels import ReadingTimes

WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0, slip_m_per_sqrt_m=0.002)
LEGS = ((3.0, 0.6, 0.2), (2.0, 0.4, -0.5), (3.0, 0.7, 0.0))
SEEDS = pytest.mark.parametrize("seed", range(5))


def readings(seed: int) -> list[WheelTicks]:
    """50 a second of a robot that drives at changing speeds."""
    made = simulate(WHEELS, LEGS, rng=np.random.default_rng(seed), start_s=100.0)
    ticks = zip(made.stamps_s.tolist(), made.left, made.right, strict=True)
    return [WheelTicks(stamp_s, int(left), int(right)) for stamp_s, left, right in ticks]


def errors_s(fault: ClockFault, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Of stamps and of the times that are reported, while the robot is on its way, from the third second on."""
    true = readings(seed)
    taken_s = {(one.left, one.right): one.stamp_s for one in true}
    subject, off = ReadingTimes(WHEELS), []
    for event in fault.apply(true):
        assert isinstance(event, WheelTicks)
        time_s, true_s = subject.time_of(event), taken_s[event.left, event.right]
        if 102.0 < true_s < 107.0:
            off.append((event.stamp_s - true_s, time_s - true_s))
    stamps_s, times_s = np.array(off).T
    return stamps_s, times_s


@SEEDS
def test_stamps_that_are_exact_stand(seed: int) -> None:
    subject = ReadingTimes(WHEELS)
    assert [subject.time_of(one) for one in readings(seed)] == [one.stamp_s for one in readings(seed)]
    assert (subject.noise_s, subject.late) == (0.0, 0)


@SEEDS
def test_readings_that_wait_behind_a_gap_were_taken_when_due(seed: int) -> None:
    stamps_s, times_s = errors_s(ReadingsStalled(seed=seed), seed)
    assert np.sqrt(np.mean(stamps_s**2)) > 0.010
    assert np.sqrt(np.mean(times_s**2)) < 0.005


@SEEDS
def test_noise_of_stamps_is_found_and_made_less(seed: int) -> None:
    stamps_s, times_s = errors_s(ReadingsJitter(0.01, seed), seed)
    assert times_s.std() < 0.9 * stamps_s.std()
    subject = ReadingTimes(WHEELS)
    for event in ReadingsJitter(0.01, seed).apply(readings(seed)):
        assert isinstance(event, WheelTicks)
        subject.time_of(event)
    assert 0.005 < subject.noise_s < 0.02


@SEEDS
def test_readings_in_pairs_are_distinguished(seed: int) -> None:
    stamps_s, times_s = errors_s(ReadingsTogether(2, 1e-3), seed)
    assert times_s.std() < 0.6 * stamps_s.std()


@pytest.mark.parametrize("stop_m_s2", [1.0, 5.0])
def test_a_base_that_stops_is_not_late(stop_m_s2: float) -> None:
    speeds = np.maximum(0.6 - stop_m_s2 * np.maximum(np.arange(300) / 50 - 2, 0), 0)
    ticks = np.rint(np.cumsum(speeds / 50) / WHEELS.left_m_per_tick).astype(int)
    stopping = [WheelTicks(k / 50, int(n), int(n)) for k, n in enumerate(ticks)]
    subject = ReadingTimes(WHEELS)
    assert max(abs(subject.time_of(one) - one.stamp_s) for one in stopping) < 0.01


@SEEDS
def test_times_grow_whatever_comes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    subject, times_s = ReadingTimes(replace(WHEELS, counter_bits=16)), []
    stamp_s = 0.0
    for _ in range(500):
        stamp_s += float(rng.choice([1e-6, 0.002, 0.02, 0.09, 0.3, 5.0]))
        left, right = rng.integers(-(2**15), 2**15, 2).tolist()
        times_s.append(subject.time_of(WheelTicks(stamp_s, left, right)))
    assert (np.diff(times_s) > 0).all()
    assert np.isfinite(times_s).all()


def test_counts_of_a_holonomic_base_that_waited_are_timed_by_their_way() -> None:
    """Sideways at an even speed; one reading waits 20 ms for the next, which it arrives with."""
    wheels = HolonomicWheels("mecanum", radius_m=0.05, half_length_m=0.2, half_width_m=0.15, ticks_per_turn=4096)
    ways = wheels.jacobian @ [0.0, 0.5, 0.0] / wheels.m_per_tick
    times, off_s = ReadingTimes(wheels), []
    for index in range(200):
        taken_s = 0.02 * index
        stamp_s = taken_s + (0.018 if index % 50 == 49 else 0.0)
        counts = tuple(int(count) for count in np.rint(ways * taken_s))
        off_s.append(abs(times.time_of(WheelCounts(stamp_s, counts)) - taken_s))
    assert max(off_s[100:]) < 0.01

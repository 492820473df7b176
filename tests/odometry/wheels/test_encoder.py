"""Encoder: the paper's own figures, and what cannot be."""

from __future__ import annotations

import math

import pytest

from wheelsight.core.errors import CalibrationError
from wheelsight.wheels import Encoder

WHEELCHAIR = Encoder(counts_per_turn=100, gear_ratio=32, wheel_radius_m=0.17)


def test_the_wheelchairs_figures_of_trinh_equation_4() -> None:
    assert 1e3 * WHEELCHAIR.m_per_pulse == pytest.approx(0.3338, abs=5e-5)
    assert WHEELCHAIR.pulses_per_s(4700) == pytest.approx(7833, abs=0.5)
    assert WHEELCHAIR.interrupts_per_s(4700) == pytest.approx(15667, abs=0.5)


def test_a_turn_of_the_wheel_is_its_circumference() -> None:
    assert WHEELCHAIR.ticks_per_turn == 3200
    assert WHEELCHAIR.ticks_per_turn * WHEELCHAIR.m_per_pulse == pytest.approx(2 * math.pi * 0.17)
    assert WHEELCHAIR.wheel_speed_m_s(4700) == pytest.approx(4700 / 60 / 32 * 2 * math.pi * 0.17)


def test_a_signed_byte_is_too_small_for_a_frame_at_top_speed() -> None:
    assert WHEELCHAIR.pulses_per_s(4700) * 0.02 == pytest.approx(157, abs=0.5)
    assert 127 * WHEELCHAIR.m_per_pulse / 0.02 == pytest.approx(2.1, abs=0.05)


@pytest.mark.parametrize("numbers", [(0, 32, 0.17), (100, -1, 0.17), (100, 32, math.nan), (math.inf, 32, 0.17)])
def test_what_no_encoder_has_is_refused(numbers: tuple[float, float, float]) -> None:
    with pytest.raises(CalibrationError, match="not a positive number"):
        Encoder(*numbers)

"""Encoder: what a quadrature encoder on a geared motor can tell of a wheel (Trinh et al., eq. 4)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wheelsight.errors import CalibrationError

_SECONDS_A_MINUTE = 60


@dataclass(frozen=True, slots=True)
class Encoder:
    """An incremental encoder on a motor's shaft, whose pulses on channel A are counted.

    Attributes:
        counts_per_turn: pulses of one channel in a turn of the shaft (CPR).
        gear_ratio: turns of the shaft a turn of the wheel.
        wheel_radius_m: of the driven wheel.

    Raises:
        CalibrationError: a number that is not positive.
    """

    counts_per_turn: float
    gear_ratio: float
    wheel_radius_m: float

    def __post_init__(self) -> None:
        for name in ("counts_per_turn", "gear_ratio", "wheel_radius_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise CalibrationError(f"{name} is {value}, not a positive number")

    @property
    def ticks_per_turn(self) -> float:
        """Pulses a turn of the wheel, as `Wheels.ticks_per_turn` takes them."""
        return self.counts_per_turn * self.gear_ratio

    @property
    def m_per_pulse(self) -> float:
        """How far the wheel rolls from one pulse to the next (DistanceResolution)."""
        return 2 * math.pi * self.wheel_radius_m / self.ticks_per_turn

    def pulses_per_s(self, motor_rpm: float) -> float:
        """Pulses a second at a speed of the motor (MaxGeneratedPulse at its highest)."""
        return motor_rpm / _SECONDS_A_MINUTE * self.counts_per_turn

    def interrupts_per_s(self, motor_rpm: float) -> float:
        """Two a pulse (MaxExternalInterrupts): both edges of this encoder, or one edge of two such encoders."""
        return 2 * self.pulses_per_s(motor_rpm)

    def wheel_speed_m_s(self, motor_rpm: float) -> float:
        """How fast the wheel rolls at a speed of the motor."""
        return self.pulses_per_s(motor_rpm) * self.m_per_pulse

"""VelocityRamp: commands that a base can follow, whatever is asked."""

from __future__ import annotations

import math

from wheelsight.commands import STOP, VelocityCommand
from wheelsight.errors import ArgumentError
from wheelsight.robot_limits import RobotLimits


class VelocityRamp:
    """Keeps `RobotLimits`: speed, acceleration and jerk, from one command to the next.

    Acceleration grows by jerk, and falls by it toward the speed that is asked. Whatever slows down is not delayed by
    jerk: stops, and less speed asked, which takes acceleration away at once. Turns have a limit of acceleration alone.
    """

    def __init__(self, limits: RobotLimits | None = None) -> None:
        self._limits = limits or RobotLimits()
        self._given = STOP
        self._acceleration_m_s2 = 0.0

    @property
    def given(self) -> VelocityCommand:
        """The last command."""
        return self._given

    def follow(self, driven: VelocityCommand) -> None:
        """Go on from a command that somebody made slower after this."""
        self._given, self._acceleration_m_s2 = driven, 0.0

    def step(self, forward_m_s: float, turn_rad_s: float, period_s: float) -> VelocityCommand:
        """The command a period after the last one.

        Args:
            forward_m_s: asked; what is not finite asks for a stop of both.
            turn_rad_s: asked.
            period_s: since the last one, above 0.

        Raises:
            ArgumentError: a period that is none.
        """
        if not (math.isfinite(period_s) and period_s > 0):
            raise ArgumentError(f"a period of {period_s} s", fix="give seconds since the last command, above 0")
        if not (math.isfinite(forward_m_s) and math.isfinite(turn_rad_s)):
            forward_m_s, turn_rad_s = 0.0, 0.0
        most = self._limits
        wanted = min(max(forward_m_s, -most.backward_m_s), most.forward_m_s)
        forward = self._forward(wanted, period_s)
        turn = min(max(turn_rad_s, -most.turn_rad_s), most.turn_rad_s)
        change = most.turn_acceleration_rad_s2 * period_s
        before = self._given.turn_rad_s
        self._given = VelocityCommand(forward, before + min(max(turn - before, -change), change))
        return self._given

    def _forward(self, wanted: float, period_s: float) -> float:
        speed, limits = self._given.forward_m_s, self._limits
        slows = speed * (wanted - speed) < 0
        if slows:
            # To zero and no farther: beyond it lies the other direction, which begins with its own acceleration.
            wanted = wanted if wanted * speed > 0 else 0.0
            change = limits.braking_m_s2 * period_s
            self._acceleration_m_s2 = 0.0
            return speed + min(max(wanted - speed, -change), change)
        sign = math.copysign(1.0, wanted - speed)
        # While acceleration falls to zero by jerk, so much is gained still: a² / 2j + a period / 2, step by step.
        # Only the step that reaches the speed may fall by an eighth more.
        half = limits.jerk_m_s3 * period_s / 2
        most = math.sqrt(half * half + 2 * limits.jerk_m_s3 * abs(wanted - speed)) - half
        most = min(limits.acceleration_m_s2, most)
        grown = max(self._acceleration_m_s2 * sign, 0.0) + limits.jerk_m_s3 * period_s
        change = min(min(most, grown) * period_s, abs(wanted - speed))
        self._acceleration_m_s2 = sign * change / period_s
        return wanted if change == abs(wanted - speed) else speed + sign * change

"""VelocityCommand: what a robot is told to do."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wheelsight.errors import ArgumentError


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """Speeds that a base is to have, in its own frame.

    Attributes:
        forward_m_s: forward; negative backward.
        turn_rad_s: counter-clockwise, seen from above.

    Raises:
        ArgumentError: numbers that are not finite.
    """

    forward_m_s: float = 0.0
    turn_rad_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("forward_m_s", "turn_rad_s"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise ArgumentError(f"{name} is {value}", fix="give a finite number; a robot that is unsure stops")

    @property
    def is_stop(self) -> bool:
        """Whether it tells the base to stand."""
        return self.forward_m_s == 0.0 and self.turn_rad_s == 0.0


STOP = VelocityCommand()
"""Stand."""

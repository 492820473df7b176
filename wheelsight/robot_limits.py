"""RobotLimits: how fast a robot may go, and how fast that may change."""

from __future__ import annotations

from wheelsight.settings import CHOSEN, Settings, setting


class RobotLimits(Settings):
    """Limits that every command keeps; a limit of zero means that the robot does not do that at all."""

    forward_m_s: float = setting(1.0, "fastest forward; a person walks at 1.4 m/s", CHOSEN, ge=0, le=3)
    backward_m_s: float = setting(0.2, "fastest backward, where no camera looks", CHOSEN, ge=0, le=1)
    turn_rad_s: float = setting(1.0, "fastest turn; a camera blurs beyond", CHOSEN, ge=0, le=4)
    acceleration_m_s2: float = setting(0.5, "at which speed grows; a rider bears as much", CHOSEN, gt=0, le=3)
    braking_m_s2: float = setting(
        1.0, "at which speed falls, in a stop too; much more throws a rider forward", CHOSEN, gt=0, le=5
    )
    turn_acceleration_rad_s2: float = setting(1.5, "at which turns change", CHOSEN, gt=0, le=10)
    jerk_m_s3: float = setting(2.0, "at which acceleration changes, but for stops", CHOSEN, gt=0, le=50)

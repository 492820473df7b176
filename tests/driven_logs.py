"""Drives of a chair with a known drive model, for tests of its identification."""

from __future__ import annotations

import numpy as np

from wheelsight.core.drive_model import DriveAxis, lagged
from wheelsight_calibration.drive_log import DriveLog

CHAIR = DriveAxis(
    dead_time_s=0.3,
    rise_s=0.28,
    fall_s=0.47,
    dead_zone=(0.15, 0.2),
    gain=(2.0, 0.9),
    bend=(-0.2, -0.1),
    largest_command=(0.9, 0.9),
)
TURNS = DriveAxis(
    dead_time_s=0.2, rise_s=0.15, fall_s=0.15, dead_zone=(0.2, 0.2), gain=(-0.55, -0.6), largest_command=(0.7, 0.7)
)


def steps(rng: np.random.Generator, largest: float, seconds: float, *, one_way: bool = False) -> np.ndarray:
    """Rows of begin and command (K, 2): random steps of 1.5 to 3 s, every third of them a stop."""
    begins, commands, now_s = [0.0], [0.0], 1.0
    while now_s < seconds - 2:
        is_stop = len(begins) % 3 == 0
        side = 1.0 if one_way else rng.choice([-1.0, 1.0])
        begins.append(now_s)
        commands.append(0.0 if is_stop else side * largest * rng.uniform(0.35, 1.0))
        now_s += rng.uniform(1.5, 3.0)
    return np.column_stack([begins, commands])


def speeds_after(axis: DriveAxis, commands: np.ndarray, stamps_s: np.ndarray) -> np.ndarray:
    """Speeds (N,) by plain steps of a millisecond: no code of the identification."""
    fine_s = np.arange(stamps_s[0], stamps_s[-1] + 2e-3, 1e-3)
    index = np.searchsorted(commands[:, 0] + axis.dead_time_s, fine_s, side="right").clip(1) - 1
    towards = [axis.speed_m_s(command) for command in commands[:, 1].tolist()]
    speed, speeds = 0.0, []
    for place in index.tolist():
        speeds.append(speed)
        speed = lagged(speed, towards[place], 1e-3, axis.rise_s, axis.fall_s)
    return np.interp(stamps_s, fine_s, speeds)


def driven(
    rng: np.random.Generator,
    *,
    axis: DriveAxis = CHAIR,
    turns: DriveAxis | None = None,
    seconds: float = 60.0,
    noise_m_s: float = 0.01,
    one_way: bool = False,
    right_share: float = 1.0,
    clock_s: float = 0.0,
    period_s: float = 0.05,
) -> DriveLog:
    """A log of joystick steps straight on, or of both kinds at once."""
    stamps_s = np.arange(0.0, seconds, period_s)
    forward = steps(rng, axis.largest_command[0], seconds, one_way=one_way)
    means, across = speeds_after(axis, forward, stamps_s), np.zeros(len(stamps_s))
    side = np.array([[0.0, 0.0]])
    if turns is not None:
        side = steps(rng, turns.largest_command[0], seconds)
        across = speeds_after(turns, side, stamps_s)
    begins = np.unique(np.concatenate([forward[:, 0], side[:, 0]]))
    commands = [one[np.searchsorted(one[:, 0], begins, side="right") - 1, 1] for one in (forward, side)]
    noise = noise_m_s * rng.standard_normal((2, len(stamps_s)))
    return DriveLog(
        name="steps",
        command="joystick",
        commands_s=begins + clock_s,
        forward=commands[0],
        turn=commands[1],
        command_sigma_s=0.0,
        stamps_s=stamps_s,
        left_m_s=means - across + noise[0],
        right_m_s=right_share * means + across + noise[1],
        is_mean=False,
    )

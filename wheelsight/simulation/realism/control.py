"""Automatic exposure and white balance as cameras have them: late, in steps, and beyond the goal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.geometry import FloatArray
from wheelsight.simulation.color_sensor import Exposure


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """How a control follows what it meters.

    Between neighbouring frames of 240 each, brightness at tracked points changes by a factor e^0.04 (freiburg1_desk),
    e^0.07 (freiburg1_rpy) and e^0.02 (red_kitchen), and over all of them by e^0.7 to e^1.15; the ratios of blue and
    red to green change by e^0.2 to e^0.6 over all.

    Attributes:
        level: (least, most) mean level that a unit's control seeks, as a share of full scale, linear: 0.26 in
            red_kitchen, 0.36 in freiburg1_desk, 0.38 in freiburg1_rpy, where 2 to 8 % of the pixels are white.
        delay_s: after which a frame's light acts on the exposure: it is read out, metered, set, and exposed. Three
            frames at 30 Hz. Chosen.
        settling_s: time constant of the control. Chosen for the changes between frames above.
        overshoot: share by which it goes beyond its goal at first. Chosen.
        step: exposures come in steps of this share. Chosen: lines of a sensor's shutter.
        flicker_s: exposures longer than this are multiples of it, against lamps that flicker at 100 Hz.
        longest_s: of an exposure: a frame of 30 Hz.
        balance_s: time constant of the white balance. Chosen for the changes above.
        balance_strength: share of the colour cast that it takes out; 1 makes every picture grey on average.
    """

    level: tuple[float, float] = (0.25, 0.38)
    delay_s: float = 0.1
    settling_s: float = 0.15
    overshoot: float = 0.25
    step: float = 0.03
    flicker_s: float = 0.01
    longest_s: float = 1 / 30
    balance_s: float = 0.7
    balance_strength: float = 0.5


def response(settings: ControlSettings, period_s: float, frames: int) -> FloatArray:
    """(K,) weights of what the last K frames asked for, the newest first, on the exposure of this one; their sum is 1.

    The impulse response of a damped oscillation whose first step goes `overshoot` beyond the goal, `delay_s` late.
    """
    ages_s = period_s * np.arange(frames)
    decay = -np.log(max(settings.overshoot, 1e-6))
    damping = decay / np.hypot(np.pi, decay)
    own_rad_s = 1 / (settings.settling_s * damping)
    swing_rad_s = own_rad_s * np.sqrt(1 - damping**2)
    since_s = np.maximum(ages_s + period_s - settings.delay_s, 0.0)
    done = 1 - np.exp(-damping * own_rad_s * since_s) * (
        np.cos(swing_rad_s * since_s) + damping * own_rad_s / swing_rad_s * np.sin(swing_rad_s * since_s)
    )
    weights = np.diff(np.concatenate([[0.0], done]))
    return np.asarray(weights / weights.sum())


def exposure_of(settings: ControlSettings, wanted_s: ArrayLike, weights: ArrayLike, highest_gain: float) -> Exposure:
    """The exposure whose product the last frames asked for: time in steps and without flicker, gain for the rest.

    Args:
        settings: of the control.
        wanted_s: (K,) time times gain that each of the last frames asked for, the newest first.
        weights: (K,) from `response`; of the first frames of a drive, the oldest stands for all before it.
        highest_gain: that may be set.
    """
    logs, weights = np.log(np.asarray(wanted_s, float)), np.asarray(weights, float)
    logs = np.concatenate([logs, np.full(len(weights) - len(logs), logs[-1])])
    product_log = float(logs @ weights)
    product_s = float(np.exp(np.round(product_log / settings.step) * settings.step))
    time_s = min(product_s, settings.longest_s)
    if time_s > settings.flicker_s:
        time_s = settings.flicker_s * np.floor(time_s / settings.flicker_s + 1e-9)
    return Exposure(time_s, min(product_s / time_s, highest_gain))


def balance_of(settings: ControlSettings, colors: FloatArray, period_s: float) -> FloatArray:
    """(3,) factors of red, green and blue; mean colours (K, 3) of the last frames, the newest first."""
    weights = np.exp(-period_s * np.arange(len(colors)) / settings.balance_s)
    mean = np.exp(np.average(np.log(np.maximum(colors, 1e-6)), axis=0, weights=weights))
    factors = (mean[1] / mean) ** settings.balance_strength
    return np.asarray(factors.clip(0.5, 2.0))

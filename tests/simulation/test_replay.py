"""A camera carried along a known way: where it is, what it sees, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from small_rooms import looking, room, wall

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import express_for
from wheelsight_sim import SimulationSettings, replay

SETTINGS = SimulationSettings(camera="ideal", size=(80, 60), rate_hz=10.0)


def way(rate_hz: float = 100.0, duration_s: float = 1.0, begin_s: float = 1000.0) -> Trajectory:
    """From `looking()` on, forward at 0.5 m/s and turning, as a motion capture system stamps it."""
    stamps_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    return Trajectory(stamps_s + begin_s, looking() @ se3.exp(stamps_s[:, None] * [0, 0, 0.5, 0, 0.3, 0]))


def test_the_camera_is_where_the_way_has_it():
    recording = replay(SETTINGS, way(), room(wall(3.0)), smooth_s=0.0)
    truth = express_for("camera", recording.ground_truth, recording.true_calibration)
    assert (truth.stamps_s[0], truth.stamps_s[-1]) == (0, 1)
    np.testing.assert_allclose(truth.at([0, 0.37, 1.0]), way().at([1000, 1000.37, 1001]), atol=1e-9)
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    assert [frame.stamp_s for frame in frames] == [round(0.1 * k, 6) for k in range(11)]
    T = way().at(1000.5)[0]
    ahead_m = (3.0 - T[0, 3]) / T[0, 2]
    assert frames[5].depth_m[29:31, 39:41].mean() == pytest.approx(ahead_m, abs=1e-3)


def test_jitter_is_taken_out_and_the_way_stays(rng):
    clean = way(duration_s=4.0)
    shaken = se3.exp(rng.normal(0, 1e-3, (len(clean), 6))) @ clean.T_frame_body
    recording = replay(SETTINGS, Trajectory(clean.stamps_s, shaken), room(wall(9.0)), smooth_s=0.05)
    truth = express_for("camera", recording.ground_truth, recording.true_calibration)
    inside_s = np.linspace(0.3, 3.7, 100)
    off = se3.log(se3.invert(clean.at(inside_s + 1000)) @ truth.at(inside_s))
    assert np.abs(off).max() < 2e-3
    assert off.std() < 0.4e-3


def test_it_may_end_early_and_a_way_of_one_pose_is_refused():
    assert replay(SETTINGS, way(), room(wall(3.0))).frame_count == 11
    shorter = SimulationSettings(camera="ideal", size=(80, 60), rate_hz=10.0, duration_s=0.5)
    assert replay(shorter, way(), room(wall(3.0))).frame_count == 6
    with pytest.raises(ConfigError, match="a way of 1 poses has no motion"):
        replay(SETTINGS, way().select(slice(0, 1)), room(wall(3.0)))

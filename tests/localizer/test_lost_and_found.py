"""A camera that is carried off in the dark tracks at once in another piece of map, which loops join with the first."""

from __future__ import annotations

import numpy as np
import synthetic
from narrowing import not_none
from places.seen_room import standing

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer

RATE_HZ, STEP_RAD = 15.0, np.radians(3.0)
LOOKED, DARK, ELSEWHERE = 24, 14, 70
CALIBRATION = Calibration.registered_camera(synthetic.CAMERA)


def turned(step: float) -> FloatArray:
    """T_room_camera (4, 4): it turns in the middle of the room, and sways a little."""
    return standing(0.1 * np.sin(0.2 * step) - 0.5, 0.1 * np.cos(0.17 * step), STEP_RAD * step)


# It looks about; then, unseen, is turned by half a circle; and goes on until it sees what it saw first. The
# walls of the room have like patterns: keypoints alone would take one for another.
CARRIED = 52
STEPS = [*range(LOOKED), *range(LOOKED + CARRIED, LOOKED + CARRIED + ELSEWHERE)]
TRUTH = [se3.invert(turned(0)) @ turned(step) for step in STEPS]


def frames(elsewhere: int) -> list[RgbdFrame]:
    """What is seen first, nothing in the dark, and so many frames of where it is then."""
    seen = [synthetic.render_room(turned(step)) for step in STEPS[: LOOKED + elsewhere]]
    dark = [(np.zeros_like(seen[0][0]), np.zeros_like(seen[0][1]))] * DARK
    images = [*seen[:LOOKED], *dark, *seen[LOOKED:]]
    return [RgbdFrame(10 + number / RATE_HZ, *image) for number, image in enumerate(images)]


def answers(frames: list[RgbdFrame], loops: str) -> tuple[Localizer, list[Estimate]]:
    overrides = {"odometry": "dense", "loops.source": loops, "loops.latency_s": 0.3, "loops.apart_s": 2.5}
    subject = Localizer(CALIBRATION, load_config(overrides=overrides), waits=True)
    found = [not_none(subject.process(frame)) for frame in frames]
    return subject, [*found[:LOOKED], *found[LOOKED + DARK :]]


def off(T: FloatArray | None, truth: FloatArray) -> tuple[float, float]:
    D = se3.invert(truth) @ not_none(T)
    return float(np.linalg.norm(D[:3, 3])), float(so3.angle(D[:3, :3]))


def test_a_camera_that_was_carried_off_finds_back() -> None:
    subject, found = answers(frames(ELSEWHERE), "keyframes")
    assert {answer.status for answer in found[1:LOOKED]} == {Status.TRACKING}
    elsewhere = [answer.status for answer in found[LOOKED:]]
    # It has a pose from the first frame on that shows something, called uncertain until it is known where it lies.
    assert elsewhere[0] is Status.COASTING
    joined = elsewhere.index(Status.TRACKING)
    assert set(elsewhere[:joined]) == {Status.COASTING}
    assert set(elsewhere[joined:]) == {Status.TRACKING}
    for answer, truth in zip(found[LOOKED + joined :], TRUTH[LOOKED + joined :], strict=True):
        way_m, turn_rad = off(answer.T_map_body, truth)
        assert way_m < 0.05
        assert turn_rad < np.radians(2)
    # In odom nothing jumps, and what was not known then is not said to have been.
    before, after = (not_none(found[LOOKED + joined + k].T_odom_body) for k in (-1, 0))
    assert off(after, before)[0] < 0.05
    lost = found[LOOKED]
    error = se3.log(not_none(lost.T_odom_body) @ se3.invert(TRUTH[LOOKED]))
    assert error @ np.linalg.solve(not_none(lost.covariance), error) < 20
    # Once it is over, all of it lies where it was.
    closed = not_none(subject.loops).finish()
    subject.close()
    assert closed.submaps == 1
    for answer, truth in zip(found, TRUTH, strict=True):
        assert off(answer.pose_in(not_none(subject.keyframes)), truth)[0] < 0.08


def test_without_loops_it_stays_lost() -> None:
    subject, found = answers(frames(1), "none")
    subject.close()
    assert found[LOOKED].status is Status.LOST

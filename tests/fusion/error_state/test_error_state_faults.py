"""ErrorStateFilter when wheels slip or vision fails: who is believed, what is flagged, and whether 3σ holds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fusion.error_state.fused_drives import (
    T_BASE_CAMERA,
    Drive,
    blind,
    position_error,
    run,
    shifted,
    simulate,
    within_three_sigma,
)
from narrowing import not_none
from scipy.stats import chi2

from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.geometry import se3
from wheelsight.estimation import ErrorStateFilter
from wheelsight.estimation.fault_detection import Fault
from wheelsight.estimation.pose_belief import FilterParameters

SETTINGS = FilterParameters.of()
FLAT = replace(SETTINGS, tilt_rad_per_sqrt_m=0.002, rise_m_per_sqrt_m=0.001)
FAULT_S, BEGIN_S, END_S = 3.0, 3.0, 6.0
FRAME_S = 1 / 30


def faulty(t):
    return BEGIN_S <= t < END_S


def spinning(t, truth, wheels):
    """Wheels run away by 0.4 m/s while the base comes to a stand, as brakes would let it."""
    if not faulty(t):
        return truth, wheels
    return truth * max(0.1, 1 - 2 * (t - BEGIN_S)), wheels + np.r_[0.4 * FRAME_S, np.zeros(5)]


def on_ice(t, truth, wheels):
    """The base goes on as before while the wheels run away."""
    return (truth, wheels + np.r_[0.5 * FRAME_S, np.zeros(5)]) if faulty(t) else (truth, wheels)


def lifted(t, truth, wheels):
    """One wheel hangs in the air: the base slows down and turns, the encoders do not notice."""
    if not faulty(t):
        return truth, wheels
    share = min(1.0, (t - BEGIN_S) / 0.2)
    turned = truth * (1 - 0.5 * share)
    turned[5] += 0.6 * FRAME_S * share
    return turned, wheels


def drive_with(seed, **faults):
    drive = Drive(seconds=8.0, step_s=FRAME_S, errors=(0.02, 0.005, 0.01), **faults)
    steps = simulate(drive, np.random.default_rng(seed), FLAT)
    return steps, run(steps)


def in_fault(steps, answers):
    return [a for s, a in zip(steps, answers, strict=True) if faulty(s.begin_s)]


def off_m(step, answer):
    return float(np.linalg.norm(position_error(answer, step.T_truth)[0]))


def covered(steps, answers):
    return np.mean([within_three_sigma(a, s.T_truth) for s, a in zip(steps, answers, strict=True)])


def wheels_off_m(steps):
    T = np.eye(4)
    for step in steps:
        T = T @ step.wheels
    return float(np.linalg.norm((T - steps[-1].T_truth)[:2, 3]))


@pytest.mark.parametrize("fault", [spinning, on_ice, lifted])
@pytest.mark.parametrize("seed", range(2))
def test_slip_is_reported_and_the_camera_leads(fault, seed):
    steps, answers = drive_with(seed, wheel_fault=fault)
    assert wheels_off_m(steps) > 0.8
    assert off_m(steps[-1], answers[-1]) < 0.12
    assert covered(steps, answers) >= 0.95
    assert np.mean([a.slip for a in in_fault(steps, answers)]) > 0.6
    assert np.mean([a.slip or a.doubtful for a in in_fault(steps, answers)]) > 0.95
    assert not answers[-1].slip


@pytest.mark.parametrize("twist", [(0.3, 0.0, 0.2), (0.0, 0.3, 0.0), (-0.8, 0.0, 0.0)])
def test_vision_that_leaps_to_a_constant_bias_for_a_second_is_refused(twist):
    def briefly(t):
        return BEGIN_S <= t < BEGIN_S + 1.2

    steps, answers = drive_with(
        0, camera_fault=lambda t, motion: shifted(motion, twist, FRAME_S) if briefly(t) else motion
    )
    reported = [a for step, a in zip(steps, answers, strict=True) if briefly(step.end_s)]
    assert all(a.reason is Reason.CONTRADICTION and not a.slip for a in reported[1:])
    assert off_m(steps[-1], answers[-1]) < 0.2
    assert covered(steps, answers) >= 0.95
    assert (answers[-1].status, answers[-1].reason) == (Status.TRACKING, None)


def test_vision_that_creeps_off_with_fewer_inliers_is_refused():
    def crept(t, motion):
        if not faulty(t):
            return motion
        return replace(shifted(motion, (0.3 * min((t - BEGIN_S) / 0.5, 1), 0, 0), FRAME_S), inliers=70)

    steps, answers = drive_with(0, camera_fault=crept)
    assert np.mean([a.reason is not None for a in in_fault(steps, answers)]) > 0.8
    assert not any(a.slip for a in answers)
    assert off_m(steps[-1], answers[-1]) < 0.2


def test_vision_that_creeps_off_with_what_walks_past_is_refused():
    """It has all its inliers, and a third of the view's regions lie off: whose motion it is that the camera follows."""

    def crept(t, motion):
        if not faulty(t):
            return replace(motion, fitting=0.95)
        return replace(shifted(motion, (0.3 * min((t - BEGIN_S) / 0.5, 1), 0, 0), FRAME_S), fitting=0.65)

    steps, answers = drive_with(0, camera_fault=crept)
    assert np.mean([a.reason is not None for a in in_fault(steps, answers)]) > 0.8
    assert not any(a.slip for a in answers)
    assert off_m(steps[-1], answers[-1]) < 0.2


def test_slip_is_reported_by_a_camera_whose_whole_view_agrees():
    for share in (None, 0.95):
        _, answers = drive_with(
            0, camera_fault=lambda t, motion, of=share: replace(motion, fitting=of), wheel_fault=spinning
        )
        assert any(a.slip for a in answers)


def test_vision_out_of_the_floors_plane_is_never_slip():
    def up(t, motion):
        T = motion.T_reference_current.copy()
        T[1, 3] -= 0.1  # y of the camera is down
        return replace(motion, T_reference_current=T) if faulty(t) else motion

    steps, answers = drive_with(0, camera_fault=up)
    assert all(a.reason is Reason.CONTRADICTION and not a.slip for a in in_fault(steps, answers)[1:-1])


def test_a_view_that_hides_a_direction_never_makes_it_slip():
    """Before a bare wall a camera slides along it, and has wrong what it does see; wheels stay believed."""
    along_wall = np.array([[1.0, 0, 0, 0, 0, 0]])

    def before_a_wall(t, motion):
        if not faulty(t):
            return motion
        return replace(shifted(motion, (0.3, 0.0, 0.2), FRAME_S), degenerate=along_wall)

    steps, answers = drive_with(0, camera_fault=before_a_wall)
    reported = in_fault(steps, answers)
    assert np.mean([a.reason is Reason.CONTRADICTION for a in reported]) > 0.5
    assert not any(a.slip for a in answers)
    assert off_m(steps[-1], answers[-1]) < 0.2
    assert covered(steps, answers) >= 0.95


def test_vision_that_fails_for_long_is_followed_only_by_a_pose_that_covers_the_wheels():
    """It looks just as slip that was taken for its failure at first, so that who is right stays open."""
    steps, answers = drive_with(
        0, camera_fault=lambda t, motion: shifted(motion, (0.6, 0.0, 0.4), FRAME_S) if faulty(t) else motion
    )
    step, answer = next((s, a) for s, a in zip(steps, answers, strict=True) if a.slip)
    assert off_m(step, answer) > 0.3
    assert within_three_sigma(answer, step.T_truth)


def test_a_blackout_coasts_within_three_sigma():
    steps, answers = drive_with(0, camera_fault=lambda t, motion: blind(motion) if faulty(t) else motion)
    assert [a.status for a in in_fault(steps, answers)][15:-1] == [Status.COASTING] * 74
    assert covered(steps, answers) >= 0.95
    assert off_m(steps[-1], answers[-1]) < 1.2 * wheels_off_m(steps)


def test_a_base_that_is_stopped_dead_looks_as_vision_that_fails_until_that_lasts():
    """The camera leaps in both: the answer is the wheels', 3σ reaches the camera's; then, slip, and nothing is lost."""
    steps, answers = drive_with(0, wheel_fault=lambda t, truth, wheels: (truth * (not faulty(t)), wheels))
    reported = in_fault(steps, answers)
    assert all(a.reason is Reason.CONTRADICTION for a in reported[1:30])
    assert all(a.slip for a in reported[55:])
    assert covered(steps, answers) >= 0.9
    assert off_m(steps[-1], answers[-1]) < 0.12


def test_a_gyroscope_settles_who_is_right():
    """The camera creeps into a turn that is none, with all its inliers; by the camera alone it would pass for slip."""

    def turned(t, motion):
        rate = 0.6 * min(max(t - BEGIN_S, 0.0) / 1.0, 1.0)
        return shifted(motion, (0, 0, rate), FRAME_S) if faulty(t) else motion

    drive = Drive(seconds=8.0, step_s=FRAME_S, camera_fault=turned)
    steps = simulate(drive, np.random.default_rng(0), FLAT)
    rates = [replace(s, yaw_rate_rad_s=float(drive.twist(s.begin_s + FRAME_S / 2)[2])) for s in steps]
    without, with_it = run(steps), run(rates)
    assert any(a.slip for a in without)
    assert np.mean([a.slip for a in with_it]) < 0.05
    assert off_m(steps[-1], with_it[-1]) < 0.15 < off_m(steps[-1], without[-1])


def test_doubt_covers_both_sides():
    """While nothing settles a contradiction, the ellipse reaches to both places."""
    steps, _ = drive_with(0)
    undecided = replace(SETTINGS, contradiction_nats=0.0, leap_chi2_cap=0.0)
    fusion = ErrorStateFilter(T_BASE_CAMERA, settings=undecided)
    half = len(steps) // 2
    run(steps[:half], fusion=fusion)
    for step in steps[half : half + 15]:
        fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        fusion.update_relative(step.end_s, shifted(step.measurement, (0.5, 0, 0), FRAME_S), "frame")
        answer = fusion.clone(step.end_s, "frame")
    detection = fusion.state.detection
    assert answer.doubtful
    assert detection.fault is Fault.UNDECIDED
    assert within_three_sigma(answer, detection.primary.T[0])
    assert within_three_sigma(answer, not_none(detection.alternative).T[0])
    shift = not_none(detection.alternative).T[0][:2, 3] - detection.primary.T[0][:2, 3]
    assert np.linalg.norm(shift) > 0.1


def test_without_faults_nothing_is_flagged():
    flags = []
    for seed in range(3):
        _, answers = drive_with(seed)
        flags += [a.slip or a.doubtful or a.reason is not None for a in answers]
    assert np.mean(flags) < 0.02


@pytest.mark.slow
def test_frames_that_are_wrong_now_and_then_do_not_make_all_before_them_uncertain():
    """What wheels and camera both were uncertain of before they contradicted each other, they are afterwards, once."""
    wrong_s = np.arange(2.0, 40.0, 2.0)

    def wrong(t, motion):
        is_wrong = np.abs(wrong_s - t).min() < FRAME_S / 2
        return shifted(motion, np.array([0.0, 0.0, 0.6]), FRAME_S) if is_wrong else motion

    sigmas = []
    faults: list[dict[str, Any]] = [{}, {"camera_fault": wrong}]
    for fault in faults:
        drive = Drive(seconds=42.0, step_s=FRAME_S, **fault)
        answers = run(simulate(drive, np.random.default_rng(3), FLAT))
        assert any(answer.doubtful for answer in answers) == bool(fault)
        sigmas.append(np.sqrt(not_none(answers[-1].covariance)[5, 5]))
    right, reported_wrong = sigmas
    assert reported_wrong < 1.4 * right


def kept(steps, every):
    """Motions between frames that are kept: as reported at the later one, as poses tell them, and true ones."""
    fusion, found, before = ErrorStateFilter(T_BASE_CAMERA), [], None
    fusion.clone(steps[0].begin_s, "frame")
    for i, step in enumerate(steps):
        fusion.predict(step.end_s, step.wheels, step.wheel_covariance, step.begin_s)
        answer = fusion.update_relative(step.end_s, step.measurement, "frame")
        fusion.clone(step.end_s, "frame")
        if i % every:
            continue
        reported, now = (
            fusion.keep_frame(step.end_s),
            (step.T_truth @ T_BASE_CAMERA, not_none(answer.T_odom_body) @ T_BASE_CAMERA),
        )
        if before is not None:
            true, by_poses = (se3.invert(then) @ here for then, here in zip(before, now, strict=True))
            found.append((reported, by_poses, true))
        before = now
    return found


def off(found):
    """How far off motions (K, 6) are as reported, and as poses tell them."""
    reported = [motions.log(true @ se3.invert(reported[0])) for reported, _, true in found]
    return np.array(reported), np.array([motions.log(true @ se3.invert(by_poses)) for _, by_poses, true in found])


@pytest.mark.parametrize("fault", [spinning, on_ice, lifted])
@pytest.mark.parametrize("seed", range(2))
def test_how_far_off_motions_between_kept_frames_are_is_reported_while_wheels_slip(fault, seed):
    drive = Drive(seconds=8.0, step_s=FRAME_S, errors=(0.02, 0.005, 0.01), wheel_fault=fault)
    found = kept(simulate(drive, np.random.default_rng(seed), FLAT), every=12)
    nees = [e @ np.linalg.solve(reported[1], e) for e, (reported, _, _) in zip(off(found)[0], found, strict=True)]
    assert np.mean(np.array(nees) < chi2.ppf(0.999, 6)) >= 0.95


@pytest.mark.parametrize("seed", range(2))
def test_motions_between_kept_frames_do_not_leap_where_poses_do(seed):
    """Where it is the camera after all that is believed, the pose leaps to where that has it; the robot has not."""
    drive = Drive(
        seconds=8.0,
        step_s=FRAME_S,
        errors=(0.02, 0.005, 0.01),
        camera_fault=lambda t, motion: shifted(motion, (0.3, 0.0, 0.2), FRAME_S) if faulty(t) else motion,
    )
    reported, leaps = (
        np.linalg.norm(e[:, :3], axis=1)
        for e in off(kept(simulate(drive, np.random.default_rng(seed), FLAT), every=12))
    )
    assert leaps.max() > 0.3
    assert reported.max() < 0.5 * leaps.max()

"""What a joined localizer says where no one can know the place: after an elevator, after a silence of all sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from localizer.joined_drives import Drive, Eye, Sight, answers_to, drive, joined, of_frames, off_m, pushed, spread_m

from wheelsight.core.estimates import CameraEstimate, PoseEvidence, PoseFinding, Reason, Status
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import KeyframeId
from wheelsight.estimation import FusedEstimate
from wheelsight.estimation import fusion_localizer as by_fusion
from wheelsight.estimation.loop_updates import PlaceConfirmation, SubmapState
from wheelsight_sim.faults import Silence

pytestmark = pytest.mark.slow  # one to three seconds each
STOPS = ((2.0, 0.6, 0.0), (5.0, 0.0, 0.0), (3.0, 0.6, 0.1))
ROUND_A_CORNER = ((5.0, 0.5, 0.0), (2.0, 0.5, 0.7), (5.0, 0.5, 0.0))
SILENT_S = (4.0, 9.0)


def said(monkeypatch: pytest.MonkeyPatch, made: Drive, eye: Eye | None = None) -> list[FusedEstimate]:
    """The answers to frames."""
    return of_frames(answers_to(joined(monkeypatch, eye or made.eye())[0], made.events()))


def said_after_silence(monkeypatch: pytest.MonkeyPatch, made: Drive) -> list[FusedEstimate]:
    """The answers to frames after 5 s in which no sensor reported anything."""
    begin_s, end_s = (made.begin_s + seconds for seconds in SILENT_S)
    heard = Silence(begin_s=begin_s, end_s=end_s).apply(made.events())
    eye = made.eye()
    # Clocks are taken to have leapt: the frames that odometry is given are stamped earlier.
    eye.taken_s = {event.index: event.stamp_s for event in made.events() if hasattr(event, "index")}
    return [answer for answer in of_frames(answers_to(joined(monkeypatch, eye)[0], heard)) if answer.stamp_s > end_s]


def test_after_an_elevator_the_place_is_doubtful(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(STOPS, lambda seconds: Sight(place=int(seconds >= 6.8)))
    moved = pushed(made, 6.5, 1.5)
    after = [answer for answer in said(monkeypatch, moved) if answer.stamp_s > made.begin_s + 6.79]
    assert len(after) > 60
    assert all(answer.doubtful and answer.status is Status.COASTING for answer in after)
    assert all(1.0 < off_m(answer, moved.truth) < 3 * spread_m(answer) for answer in after)


def test_a_view_taken_for_a_known_one_that_contradicts_the_wheels_ends_no_doubt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Carried aside in the dark; some frames are of an unknown place, and then it is taken for the one before."""

    def sight(seconds: float) -> Sight:
        if 4.0 <= seconds < 5.5:
            return Sight(blind=Reason.TOO_LITTLE_DEPTH)
        if 5.5 <= seconds < 5.7:
            return Sight(place=1)
        if seconds < 4.0:
            return Sight()
        # What is seen wrongly adds up: a metre at first, and the same from then on.
        return Sight(wrong=(0.6 if seconds < 5.75 else 1e-9, 0.0, 0.0))

    moved = pushed(drive(STOPS, sight), 4.5, 1.5)
    after = [answer for answer in said(monkeypatch, moved) if answer.stamp_s > moved.begin_s + 5.51]
    assert len(after) > 60
    assert all(answer.doubtful and answer.status is Status.COASTING for answer in after)
    assert all(0.5 < off_m(answer, moved.truth) < 3 * spread_m(answer) for answer in after)


def test_who_steps_before_a_robot_that_stands_hides_the_place_only_so_long(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(STOPS, lambda seconds: Sight(place=int(5.5 <= seconds < 6.5)))
    eye = made.eye()
    frames = said(monkeypatch, made, eye)
    hidden = [answer for answer in frames if 5.51 < answer.stamp_s - made.begin_s < 6.49]
    assert all(answer.doubtful and answer.reason is Reason.NOT_RECOGNISED for answer in hidden)
    assert eye.restarts == {}
    later = [answer for answer in frames if answer.stamp_s > made.begin_s + 6.6]
    assert {(answer.status, answer.doubtful) for answer in later} == {(Status.TRACKING, False)}
    assert max(off_m(answer, made.truth) for answer in later) < 0.02


def test_a_view_that_changes_while_the_robot_drives_is_no_elevator(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(STOPS, lambda seconds: Sight(place=int(seconds >= 1.5)))
    frames = said(monkeypatch, made)
    assert not any(answer.doubtful for answer in frames)
    assert frames[-1].status is Status.TRACKING


def test_after_a_silence_of_all_sensors_an_unknown_view_is_of_a_doubtful_place(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(ROUND_A_CORNER, lambda seconds: Sight(place=int(seconds >= SILENT_S[1])))
    after = said_after_silence(monkeypatch, made)
    assert len(after) > 60
    assert all(answer.doubtful or answer.status is Status.COASTING for answer in after)
    assert all(answer.doubtful for answer in after[-40:])
    assert max(off_m(answer, made.truth) for answer in after) > 0.1
    assert all(off_m(answer, made.truth) < 3 * spread_m(answer) for answer in after)


@dataclass
class Loops:
    """Stand in for LoopClosureClient: after a number of questions, loops join the new keyframes to the old ones."""

    times: int
    submap: SubmapState = SubmapState.PLACED
    asked: list[int] = field(default_factory=list)
    has_new: bool = False
    has_pending: bool = False
    tracked_s: float = -np.inf
    recognised: int | None = None
    confirmation: PlaceConfirmation = field(default_factory=lambda: PlaceConfirmation(is_given=False))

    def forget_tracked(self) -> None:
        pass

    def move_keyframes(self, stamp_s: float, keyframe: KeyframeId | None) -> None:
        pass

    def add_tracked(self, seen: CameraEstimate, T_odom_map: FloatArray, covariance: FloatArray) -> None:
        pass

    def has_loop_across(self, number: int) -> bool:
        self.asked.append(number)
        return len(self.asked) >= self.times

    def update_evidence(self, *_: object) -> PoseEvidence:
        return PoseEvidence(PoseFinding.PLACE_KNOWN)


def test_after_a_silence_loops_tell_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(ROUND_A_CORNER, lambda seconds: Sight(place=int(seconds >= SILENT_S[1])))
    loops = Loops(30)
    monkeypatch.setattr(by_fusion, "loop_closure_client", lambda *_, **__: loops)
    after = said_after_silence(monkeypatch, made)
    doubts = [answer.doubtful for answer in after]
    begun = doubts.index(True)
    known = doubts.index(False, begun)
    assert known > begun + 10
    assert {(answer.status, answer.doubtful) for answer in after[known:]} == {(Status.TRACKING, False)}
    assert loops.asked == [0] * 30  # what stands in for odometry keeps no keyframes


def test_after_a_silence_a_known_view_shows_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(ROUND_A_CORNER)
    after = said_after_silence(monkeypatch, made)[10:]
    assert {(answer.status, answer.doubtful) for answer in after} == {(Status.TRACKING, False)}
    assert np.max([off_m(answer, made.truth) for answer in after]) < 0.05

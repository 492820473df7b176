"""A loop detector of a user's own names candidates; geometry verifies them, and its mistakes are typed errors."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from places.seen_room import EXACT, kept, seen
from room_drive import make_room_drive
from test_live import SETTINGS, WAY, lived

from wheelsight import Localizer, load_config, run
from wheelsight.app.run import run_each
from wheelsight.core.errors import ConfigError, PartError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.estimation.odometry_choice import OwnParts
from wheelsight.io.recordings import open_recording
from wheelsight.places.recognition import Recognizer
from wheelsight.slam import place_recognition
from wheelsight.slam.loop_closing import LiveLoops
from wheelsight.slam.place_recognition import PlaceWatcher

LAP = 8
APART_S = 5.0


@pytest.fixture(autouse=True)
def detected_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Candidates are those of the detector, none for being near."""
    monkeypatch.setattr(place_recognition, "_NEAR_CANDIDATES", 0)


DRIVE = {"features.keyframe_share": 0.95, "loops.latency_s": 0.1}


class Named:
    """A detector by a function of a keyframe's number; it keeps what it was shown."""

    def __init__(self, names: Callable[[int], Any] = lambda number: ()) -> None:
        self._names, self.shown = names, list[int]()

    def candidates(self, number: KeyframeId, keyframe: Keyframe) -> Iterable[int]:
        assert keyframe.grey.shape == keyframe.depth_m.shape
        self.shown.append(number)
        answer: Iterable[int] = self._names(number)
        return answer


@pytest.fixture(scope="module")
def store() -> KeyframeStore:
    made = KeyframeStore()
    for second, T in enumerate(WAY):
        made.add(replace(kept(seen(T)), stamp_s=float(second)), np.eye(4))
    return made


def loops_by(store: KeyframeStore, detector: Named) -> dict[int, list[int]]:
    """The older ends of loops, by the newer one."""
    watcher = PlaceWatcher(store, EXACT, APART_S, detector=detector)
    return {number: [loop.first for loop in watcher.find_loops(number)] for number in store}


def test_what_it_names_is_verified_and_nothing_else_is(store: KeyframeStore) -> None:
    detector = Named(lambda number: np.array([number - LAP]) if number in (10, 12) else [])
    found = loops_by(store, detector)
    assert detector.shown == list(range(len(WAY)))
    assert {number: older for number, older in found.items() if older} == {10: [2], 12: [4]}


def test_a_wrong_candidate_makes_no_loop(store: KeyframeStore) -> None:
    """The other side of the room; and keyframes of just now, which are no places seen again."""
    found = loops_by(store, Named(lambda number: [0, number - 1, number - 2] if number >= 13 else []))
    assert not any(found.values())


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (lambda number: 1 / 0, "Named.candidates raised ZeroDivisionError"),
        (lambda number: None, "Named.candidates answered NoneType, not numbers"),
        (lambda number: [99], "Named.candidates answered 99 at keyframe 0: it was not shown"),
        (lambda number: [-1], "Named.candidates answered -1 at keyframe 0: it was not shown"),
        (lambda number: [number], "Named.candidates answered 0 at keyframe 0: it was not shown"),
        (lambda number: [0.5], "Named.candidates answered 0.5 at keyframe 0"),
        (lambda number: ["0"], "Named.candidates answered '0' at keyframe 0"),
    ],
)
def test_a_mistake_of_the_detector_is_one_typed_error(
    store: KeyframeStore, answer: Callable[[int], Any], why: str
) -> None:
    watcher = PlaceWatcher(store, EXACT, APART_S, detector=Named(answer))
    with pytest.raises(PartError, match=why):
        watcher.find_loops(KeyframeId(0))


def test_keyframes_of_before_are_shown_first_and_their_answers_do_not_count(store: KeyframeStore) -> None:
    known = Recognizer()
    for number in range(LAP):
        known.add(KeyframeId(number), store[KeyframeId(number)])
    detector = Named(lambda number: [number - LAP] if number >= LAP else [77])
    watcher = PlaceWatcher(store, EXACT, APART_S, None, known, detector)
    found = [loop.first for number in (10, 11) for loop in watcher.find_loops(KeyframeId(number))]
    assert detector.shown == [*range(LAP), 10, 11]
    assert found == [2, 3]


def test_who_does_not_know_where_he_is_asks_it_too(store: KeyframeStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that are adrift with the robot cannot tell where in the map it is: others of those named come first."""
    monkeypatch.setattr(place_recognition, "_MOST_PLACES", 1)
    detector = Named(lambda number: [1, 2] if number == 10 else [])
    watcher = PlaceWatcher(store, EXACT, 0.5, detector=detector)
    for number in list(store)[:10]:
        watcher.find_loops(number)
    assert [loop.first for loop in watcher.find_loops(KeyframeId(10), unjoined=(KeyframeId(1),))] == [2]


def driven(store: KeyframeStore, detector: Named) -> LiveLoops:
    own = KeyframeStore()
    live = LiveLoops(own, EXACT, SETTINGS, waits=True, detector=detector)
    for number, way in zip(store, lived(), strict=True):
        own.add(store[number], way.T_odom_keyframe)
        live.due(way.stamp_s)
        live.add(way)
    return live


def apart_m(T_map_keyframe: FloatArray) -> float:
    """How far off the last keyframe is from where it was, a lap before."""
    reported, truth = (se3.invert(T[-1 - LAP]) @ T[-1] for T in (T_map_keyframe, np.array(WAY)))
    return float(np.linalg.norm((reported - truth)[:3, 3]))


def test_its_loops_move_the_keyframes_to_where_they_belong(store: KeyframeStore) -> None:
    without = driven(store, Named()).finish()
    near = (LAP, LAP - 1, LAP + 1, LAP - 2, LAP + 2)
    closed = driven(store, Named(lambda number: [number - back for back in near if number >= back])).finish()
    assert len(without.loops.kept) == 0
    assert len(closed.loops.kept) > LAP
    assert apart_m(closed.T_map_keyframe) < 0.05 < 0.1 < apart_m(without.T_map_keyframe)


def test_an_error_at_the_last_keyframe_is_raised_by_close_and_only_warned_of_in_the_end(
    store: KeyframeStore, caplog: pytest.LogCaptureFixture
) -> None:
    live = driven(store, Named(lambda number: 1 / 0 if number == len(WAY) - 1 else ()))
    with pytest.raises(PartError):
        live.close()
    live.close()
    last = driven(store, Named(lambda number: 1 / 0 if number == len(WAY) - 1 else ()))
    with caplog.at_level(logging.WARNING):
        assert len(last.finish().stamps_s) == len(WAY)
    assert "loops of the last keyframes are missing: Named.candidates raised ZeroDivisionError" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize("odometry", ["features", "wheels,features"])
def test_a_localizer_and_a_run_take_it(tmp_path: Path, odometry: str) -> None:
    make_room_drive(tmp_path / "room", frames=16)
    recording = open_recording(tmp_path / "room")
    config = load_config(overrides={"odometry": odometry} | DRIVE)
    detector = Named()
    with Localizer(recording.calibration, config, waits=True, loop_detector=detector) as subject:
        for event in recording.events():
            subject.process(event)
        not_none(subject.loops).finish()
        assert detector.shown == list(not_none(subject.keyframes))
    assert len(detector.shown) > 3
    again = Named()
    record = run(recording, config, tmp_path / "out", loop_detector=again)
    assert again.shown == detector.shown
    assert len(record.estimate) > 16
    with pytest.raises(PartError, match=r"Named.candidates raised ZeroDivisionError"):
        run(recording, config, tmp_path / "broken", loop_detector=Named(lambda number: 1 / 0 if number == 2 else ()))
    assert next((tmp_path / "broken").rglob("trajectory.txt")).stat().st_size > 500


def test_two_odometries_by_a_camera_do_not_share_it(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "room", frames=2)
    config = load_config(overrides={"odometry": "dense,features"})
    with pytest.raises(ConfigError, match="loop_detector is for one odometry by a camera"):
        run_each(open_recording(tmp_path / "room"), config, tmp_path / "out", parts=OwnParts(loop_detector=Named()))
    assert not (tmp_path / "out").exists()

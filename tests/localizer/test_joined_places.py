"""Wheels and camera joined, with places: they hold the position where no camera looks, and never harm much."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import Any, cast

import numpy as np
import pytest
from area_drive import AREAS, T_WORLD_START, area_drive, calibration
from grids import mostly_slow
from localizer.joined_drives import Eye, MapOfFrames, Sight
from narrowing import not_none
from places.made import trained

from wheelsight.config import load_config
from wheelsight.core.errors import ConfigError, PlaceError
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks, YawRate
from wheelsight.estimation import FusedEstimate, Localizer, Places
from wheelsight.places import PlaceMatch, PlaceModel

DARK = Sight(Reason.TOO_LITTLE_DEPTH)
Answers = list[tuple[Event, Estimate]]


class Forest:
    """The trained one, its probabilities changed."""

    def __init__(self, change: Callable[[FloatArray], FloatArray] = np.asarray) -> None:
        self._change, self.area_shares, self.asked = change, trained().area_shares, 0

    def predict(self, frame: RgbdFrame) -> PlaceMatch:
        self.asked += 1
        match = trained().predict(frame)
        return replace(match, probabilities=self._change(match.probabilities))


@pytest.fixture(scope="module")
def made() -> Iterator[Callable[..., Localizer]]:
    """Makes a localizer by wheels, a camera that sees the truth but where it is blind, and places."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("camera_localizer", "fusion_localizer"):
            patch.setattr(f"wheelsight.estimation.{module}.DenseOdometry", Eye)
        yield partial(make, patch)


def make(
    patch: pytest.MonkeyPatch,
    forest: Forest | None,
    sight: Callable[[float], Sight] = lambda stamp_s: Sight(),
    begin_s: float = -np.inf,
    kept: MapOfFrames | None = None,
) -> Localizer:
    eye = Eye(area_drive().truth, sight, np.eye(4))
    patch.setattr("wheelsight.estimation.camera_localizer.camera_odometry", lambda *_: (eye, kept))
    settings: dict[str, Any] = {"odometry": "wheels,dense"}
    if forest is None:
        return Localizer(calibration(), load_config(overrides=settings))
    config = load_config(overrides=settings | {"places.model": "three.places"})
    return Localizer(calibration(), config, Places(cast(PlaceModel, forest), AREAS, T_WORLD_START, begin_s))


@cache
def dark_after(seconds: float) -> Callable[[float], Sight]:
    return lambda stamp_s: DARK if stamp_s > area_drive().events[0].stamp_s + seconds else Sight()


def answers_to(subject: Localizer, events: tuple[Event, ...] = area_drive().events) -> Answers:
    given = ((event, subject.process(event)) for event in events)
    return [(event, answer) for event, answer in given if answer is not None]


def errors_m(answers: Answers, T_odom_begin: FloatArray | None = None) -> FloatArray:
    """Metres between each pose and the truth; `T_odom_begin` where the answers' world is that of the start."""
    T_odom_begin = np.eye(4) if T_odom_begin is None else T_odom_begin
    truth = area_drive().truth
    stamps_s = np.minimum([event.stamp_s for event, _ in answers], truth.stamps_s[-1])
    T = np.array([T_odom_begin @ not_none(answer.T_filter_body) for _, answer in answers])
    return np.asarray(np.linalg.norm((T - truth.at(stamps_s))[:, :2, 3], axis=1))


@pytest.fixture(scope="module")
def alone_m(made: Callable[..., Localizer]) -> Callable[[float], FloatArray]:
    """How far it is off without places where the camera sees for so many seconds."""
    return cache(lambda seeing_s: errors_m(answers_to(made(None, dark_after(seeing_s))), T_WORLD_START))


@pytest.fixture(scope="module")
def held_in_the_dark(made: Callable[..., Localizer]) -> Answers:
    return answers_to(made(Forest(), dark_after(0.0)))


def test_places_hold_the_position_while_the_camera_is_dark(
    held_in_the_dark: Answers, alone_m: Callable[[float], FloatArray]
) -> None:
    answers, alone = held_in_the_dark, alone_m(0.0)
    held = errors_m(answers)
    assert alone[-1] > 5
    assert held.mean() < 0.3 * alone.mean()
    assert held[-1] < 0.2 * alone[-1]
    late = [answer for event, answer in answers[200:] if isinstance(event, RgbdFrame)]
    assert {answer.status for answer in late} == {Status.COASTING}, "a place is no look"
    assert {answer.reason for answer in late} == {Reason.TOO_LITTLE_DEPTH}


def test_the_covariance_is_honest_while_they_hold_it(held_in_the_dark: Answers) -> None:
    answers = held_in_the_dark
    spread_m = []
    for _, answer in answers:
        assert answer.T_filter_body is not None
        x, y, _ = answer.T_filter_body[:3, 3]
        J = np.array([[1.0, 0, 0, 0, 0, -y], [0, 1.0, 0, 0, 0, x]])
        spread_m.append(np.sqrt(np.trace(J @ not_none(answer.filter_covariance) @ J.T)))
    assert (errors_m(answers) < 3 * np.array(spread_m)).mean() > 0.95


@pytest.mark.parametrize(
    ("kind", "seeing_s"),
    mostly_slow(
        [("next one", 0.0), ("shuffled", 0.0), ("always one", 20.0), ("next one", 20.0), ("shuffled", 1000.0)],
        quick=[("next one", 0.0), ("shuffled", 0.0), ("always one", 20.0)],
    ),
)
def test_a_forest_that_is_worth_nothing_harms_little(
    made: Callable[..., Localizer], alone_m: Callable[[float], FloatArray], kind: str, seeing_s: float
) -> None:
    rng = np.random.default_rng(1)
    changes: dict[str, Callable[[FloatArray], FloatArray]] = {
        "next one": lambda probabilities: np.roll(probabilities, 1),
        "shuffled": lambda probabilities: rng.permutation(probabilities),
        "always one": lambda probabilities: np.array([0.02, 0.02, 0.96]),
    }
    misled = errors_m(answers_to(made(Forest(changes[kind]), dark_after(seeing_s)))).mean()
    assert misled < 1.2 * alone_m(seeing_s).mean()


def test_it_shows_what_the_model_said_and_how_long_it_took(made: Callable[..., Localizer]) -> None:
    subject, events = made(Forest()), area_drive().events
    assert subject.frame == "map"
    answers_to(subject, events[:60])
    frame = next(event for event in events[60:] if isinstance(event, RgbdFrame))
    answer = subject.process(frame)
    assert isinstance(answer, FusedEstimate)
    assert (answer.matches, answer.inliers) == (200, 160)
    place = not_none(subject.last_place)
    np.testing.assert_array_equal(place.probabilities, trained().predict(frame).probabilities)
    assert set(subject.stage_seconds) > {"track", "filter", "name the area", "measure by the area"}
    subject.process(SkippedFrame(frame.stamp_s + 0.1, "depth/1.png is cut off"))
    assert subject.last_place is None
    assert made(None).last_place is None


def test_it_starts_where_places_say(made: Callable[..., Localizer]) -> None:
    events = area_drive().events
    begin_s = events[30].stamp_s
    forest = Forest()
    subject = made(forest, begin_s=begin_s)
    early = [subject.process(event) for event in events if event.stamp_s < begin_s]
    assert all(answer is not None and answer.T_odom_body is None for answer in early)
    assert {answer.status for answer in early if answer is not None} == {Status.INITIALIZING}
    assert subject.process(SkippedFrame(begin_s - 0.01, "cut off")).status is Status.INITIALIZING  # type: ignore[union-attr]
    assert subject.note == "cut off"
    assert subject.process(YawRate(begin_s - 0.005, 0.1)) is None
    assert forest.asked == 0
    first = next(event for event in events if isinstance(event, WheelTicks) and event.stamp_s >= begin_s)
    answer = subject.process(first)
    assert answer is not None
    np.testing.assert_allclose(not_none(answer.T_odom_body), T_WORLD_START, atol=1e-9)
    assert answer.covariance is not None
    J = np.array([[1.0, 0, 0, 0, 0, -T_WORLD_START[1, 3]], [0, 1.0, 0, 0, 0, T_WORLD_START[0, 3]]])
    np.testing.assert_allclose(J @ answer.covariance @ J.T, 0.05**2 * np.eye(2), atol=1e-4)
    assert answer.covariance[5, 5] == pytest.approx(0.01**2, rel=0.05)


def test_frames_before_any_reading_wait_for_the_start(made: Callable[..., Localizer]) -> None:
    forest = Forest()
    subject = made(forest)
    answer = subject.process(replace(area_drive().frames[0], stamp_s=area_drive().events[0].stamp_s - 0.1))
    assert answer is not None
    assert (answer.status, answer.T_odom_body) == (Status.INITIALIZING, None)
    assert forest.asked == 0


def test_a_frame_without_depth_is_no_place(made: Callable[..., Localizer]) -> None:
    subject, events = made(Forest(), dark_after(0.0)), area_drive().events
    before = answers_to(subject, events[:60])[-1][1]
    whole = area_drive().frames[0]
    answer = subject.process(replace(whole, stamp_s=before.stamp_s, depth_m=np.zeros_like(whole.depth_m)))
    assert answer is not None
    np.testing.assert_allclose(not_none(answer.T_odom_body), not_none(before.T_odom_body), atol=1e-9)


def test_the_map_comes_along_with_the_pose(made: Callable[..., Localizer]) -> None:
    kept = MapOfFrames()
    subject = made(Forest(), kept=kept)
    answers = answers_to(subject, area_drive().events[:700])
    event, answer = next(pair for pair in reversed(answers) if isinstance(pair[0], RgbdFrame))
    assert answer.T_odom_body is not None
    T_map_camera = se3.invert(subject.T_odom_map) @ answer.T_odom_body
    moved = [a for e, a in answers if isinstance(e, WheelTicks) and e.stamp_s > event.stamp_s]
    assert len(moved) <= 5
    np.testing.assert_allclose(T_map_camera, kept.fused[event.stamp_s], atol=1e-3)  # but for the camera's lag


def test_a_frame_of_another_size_is_refused_by_its_number(made: Callable[..., Localizer]) -> None:
    subject = made(Forest())
    before = answers_to(subject, area_drive().events[:60])[-1][1]
    frame = area_drive().frames[13]
    smaller = replace(frame, stamp_s=before.stamp_s, color=frame.color[::2, ::2], depth_m=frame.depth_m[::2, ::2])
    with pytest.raises(PlaceError, match=r"^frame 13 at .* is 16x12 with depth 16x12"):
        subject.process(smaller)


def test_ligockis_filter_takes_none() -> None:
    given = {"odometry": "wheels,dense", "fusion": "ligocki", "places.model": "three.places"}
    with pytest.raises(ConfigError, match="is a measurement of the default filter alone"):
        load_config(overrides=given)

"""A motion that somebody expects, from wheels for instance: it helps where right and does no harm where wrong."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from odometry.views import error_of, from_start, odometry, room_frames
from synthetic import wobbling_trajectory

from wheelsight.core.estimates import Status
from wheelsight.core.geometry import se3
from wheelsight.vision.features.tracking import match_all, match_near

TRUTH = wobbling_trajectory(24, speed=2.0)
WORLD = from_start(TRUTH.T_frame_body)
STEPS = se3.invert(WORLD[:-1]) @ WORLD[1:]
MODES = ["keyframes", "previous"]


@pytest.fixture(scope="module")
def frames():
    return room_frames(TRUTH, depth_noise=True)


def run_with_prior(frames, T_wrong=None, **settings):
    """Answers where each frame's prior is the true motion, multiplied by an error."""
    subject = odometry(**settings)
    answers = [subject.process(frames[0])]
    for frame, step in zip(frames[1:], STEPS, strict=True):
        answers.append(subject.process(frame, step if T_wrong is None else step @ T_wrong))
    return answers


def worst(answers):
    return max(error_of(answer, truth)[0] for answer, truth in zip(answers, WORLD, strict=True))


@pytest.mark.parametrize("reference", MODES)
def test_a_right_prior_gives_the_same_within_noise(frames, reference):
    subject = odometry(reference=reference)
    without = [subject.process(frame) for frame in frames]
    given = run_with_prior(frames, reference=reference)
    assert worst(given) < max(0.02, 1.5 * worst(without))
    for one, other in zip(given, without, strict=True):
        apart = se3.invert(one.T_odom_body) @ not_none(other.T_odom_body)
        assert np.linalg.norm(apart[:3, 3]) < 0.03


WRONG = {
    "2 m aside": np.array([2.0, 0, 0, 0, 0, 0]),
    "2 m ahead": np.array([0, 0, 2.0, 0, 0, 0]),
    "1 m ahead": np.array([0, 0, 1.0, 0, 0, 0]),
    "turned back": np.array([0, 0, 0, 0, np.pi, 0]),
    "turned a little": np.array([0, 0, 0, 0, 0.3, 0]),
}


@pytest.mark.parametrize("reference", MODES)
@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG.keys())
def test_a_wrong_prior_costs_no_frame_and_no_accuracy(frames, reference, wrong):
    answers = run_with_prior(frames, se3.exp(wrong), reference=reference)
    assert all(answer.status is Status.TRACKING for answer in answers)
    assert worst(answers) < 0.06


def test_a_prior_or_a_known_velocity_bounds_the_search(frames, monkeypatch):
    called: list[str] = []

    def spy(search: Callable[..., Any], *given: object) -> Any:
        called.append(search.__name__)
        return search(*given)

    for search in (match_all, match_near):
        monkeypatch.setattr(f"wheelsight.vision.features.tracking.{search.__name__}", partial(spy, search))
    subject = odometry(reference="previous")
    subject.process(frames[0])
    subject.process(frames[1])
    assert called == ["match_all"]  # no velocity yet
    called.clear()
    subject.process(frames[2])
    assert called == ["match_near"]
    called.clear()
    subject.process(frames[3], se3.exp(WRONG["2 m aside"]))
    assert called == ["match_near", "match_all"]
    subject = odometry(reference="previous")
    subject.process(frames[0])
    called.clear()
    subject.process(frames[1], STEPS[0])
    assert called == ["match_near"]

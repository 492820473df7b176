"""LocalizerBeside and LocalizerInStep: every reading is answered in order, frames that wait give way to newer ones."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from wheelsight.core.errors import ArgumentError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.estimation import LocalizerBeside, LocalizerInStep


class Slow:
    """A localizer whose frames take until somebody lets them go."""

    keyframes = None
    recognised = None
    warnings: tuple[str, ...] = ()

    def __init__(self) -> None:
        self.may_go, self.begun = threading.Event(), threading.Event()
        self.closed = 0

    def process(self, event: Event) -> Estimate | None:
        if isinstance(event, RgbdFrame):
            self.begun.set()
            assert self.may_go.wait(10)
        if event.stamp_s == 13:
            raise ArgumentError("an unlucky event")
        return Estimate(event.stamp_s, Status.TRACKING)

    def close(self) -> None:
        self.closed += 1


def frame(stamp_s: float) -> RgbdFrame:
    return RgbdFrame(stamp_s, np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32))


def answers_of(subject: LocalizerBeside, count: int) -> list[float]:
    reported: list[float] = []
    waiting = threading.Event()
    for _ in range(1000):
        reported += [event.stamp_s for event, _ in subject.process([])]
        if len(reported) >= count:
            return reported
        waiting.wait(0.01)
    raise AssertionError(f"only {reported}")


def test_a_frame_that_takes_long_keeps_no_one_waiting_and_older_frames_give_way() -> None:
    slow = Slow()
    subject = LocalizerBeside(slow)
    reported = [event.stamp_s for event, _ in subject.process([WheelTicks(0.0, 0, 0), frame(0.1)])]
    assert slow.begun.wait(10)
    reported += [
        event.stamp_s
        for event, _ in subject.process([WheelTicks(0.2, 0, 0), frame(0.3), WheelTicks(0.4, 0, 0), frame(0.5)])
    ]
    slow.may_go.set()
    assert reported + answers_of(subject, 5 - len(reported)) == [0.0, 0.1, 0.2, 0.4, 0.5]
    assert subject.dropped == 1
    subject.close()
    subject.close()
    assert slow.closed == 2


def test_what_goes_wrong_beside_is_raised_to_who_asks() -> None:
    subject = LocalizerBeside(Slow())
    subject.process([WheelTicks(13.0, 0, 0)])
    with pytest.raises(ArgumentError, match="unlucky"):
        answers_of(subject, 1)
    subject.close()


def test_in_step_each_event_has_its_answer_at_once() -> None:
    slow = Slow()
    slow.may_go.set()
    subject = LocalizerInStep(slow)
    reported = subject.process([WheelTicks(0.0, 0, 0), frame(0.1)])
    assert [event.stamp_s for event, _ in reported] == [0.0, 0.1]
    assert all(estimate is not None for _, estimate in reported)
    subject.close()
    assert slow.closed == 1

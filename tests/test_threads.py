"""Threads that yield come after others; objects with a state are used by one thread at a time."""

from __future__ import annotations

import copy
import os
import pickle
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic import CAMERA, render_room, wobbling_trajectory

from wheelsight import Calibration, Localizer, RgbdFrame, Wheels, WheelTicks
from wheelsight.config import load_config
from wheelsight.core.errors import ArgumentError
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.threads import OneCaller, ends, one_at_a_time, yield_to_others
from wheelsight.estimation import LocalizerBeside, LocalizerInStep
from wheelsight.io.recordings import RecordingWriter
from wheelsight.navigation import Navigator
from wheelsight.vision.dense import DenseOdometry
from wheelsight.vision.features import FeatureOdometry
from wheelsight.wheels import WheelOdometry
from wheelsight_sim.simulator import Simulator

MOUNT = np.array([[0.0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 1.1], [0, 0, 0, 1]])
_LESS_A_STEP = 1.25  # by which Linux divides a thread's share for each step of `nice`


def niceness() -> int:
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


@pytest.mark.skipif(sys.platform != "linux", reason="threads differ in priority on Linux alone")
def test_a_thread_that_yields_has_less_than_the_others_and_enough_to_let_go_of_python() -> None:
    with ThreadPoolExecutor(1, "yields", yield_to_others) as pool:
        share = _LESS_A_STEP ** (niceness() - pool.submit(niceness).result())
    assert 0.25 < share < 1.0


READINGS = [WheelTicks(k / 50, 30 * k, 29 * k) for k in range(60)]
WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
CALIBRATION = Calibration.registered_camera(CAMERA, wheels=WHEELS, T_base_camera=MOUNT)
FRAME = RgbdFrame(1.0, *render_room(wobbling_trajectory(1).T_frame_body[0]))


def localizer() -> Localizer:
    return Localizer(Calibration(wheels=WHEELS), load_config(overrides={"odometry": "wheels"}))


class Slow(OneCaller):
    """One call takes until it is released."""

    def __init__(self) -> None:
        self.begun, self.released = threading.Event(), threading.Event()

    @one_at_a_time
    def process(self) -> str:
        self.begun.set()
        assert self.released.wait(60)
        return self.within()

    @one_at_a_time
    def within(self) -> str:
        return "done"

    @ends
    def close(self) -> None:
        self.released.set()


def test_a_call_beside_another_is_refused_and_the_other_goes_on() -> None:
    slow = Slow()
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(slow.process)
        assert slow.begun.wait(60)
        for refused in (slow.within, slow.close):
            with pytest.raises(ArgumentError, match=r"^this Slow is at work in another thread \(one call"):
                refused()
        slow.released.set()
        assert answer.result(60) == "done"
    assert slow.within() == "done"


def test_many_threads_on_one_localizer_get_answers_or_one_line() -> None:
    one, events, refused, others = localizer(), iter(READINGS * 50), [], []
    lock, ready = threading.Lock(), threading.Barrier(3)

    def work() -> None:
        ready.wait(60)
        while True:
            with lock:
                event = next(events, None)
            if event is None:
                return
            try:
                one.process(event)
            except ArgumentError as error:
                refused.append(str(error))
            except Exception as error:
                others.append(error)

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert others == []
    assert set(refused) <= {"this Localizer is at work in another thread (one call after another, or one a thread)"}


def test_threads_may_take_turns() -> None:
    """As those of an executor do, in which a program of asyncio localizes."""
    alone, shared = localizer(), localizer()
    with ThreadPoolExecutor(4) as pool:
        for event in READINGS:
            mine, theirs = alone.process(event), pool.submit(shared.process, event).result(60)
            assert mine is not None
            assert theirs is not None
            np.testing.assert_array_equal(mine.T_odom_body, theirs.T_odom_body)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing is forked here")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("use", ["process", "close"])
def test_what_was_made_before_a_fork_is_refused_after_it(use: str) -> None:
    one = localizer()
    one.process(READINGS[0])
    ours, theirs = os.pipe()
    if (child := os.fork()) == 0:
        try:
            one.process(READINGS[1]) if use == "process" else one.close()
        except BaseException as error:
            os.write(theirs, f"{type(error).__name__}: {error}".encode())
        os._exit(0)
    os.close(theirs)
    with os.fdopen(ours) as said:
        assert said.read() == "ArgumentError: this Localizer was made in another process (make it after the fork)"
    os.waitpid(child, 0)
    assert one.process(READINGS[1]) is not None


def closed_by_a_block() -> Localizer:
    with localizer() as one:
        one.process(READINGS[0])
    return one


def test_after_its_end_nothing_is_answered() -> None:
    one = closed_by_a_block()
    one.close()
    with pytest.raises(ArgumentError, match=r"^this Localizer is closed \(make another\)$"):
        one.process(READINGS[1])
    assert one.keyframes is None
    for kind in (LocalizerInStep, LocalizerBeside):
        other = kind(localizer())
        other.process(READINGS[:2])
        other.close()
        other.close()
        with pytest.raises(ArgumentError, match=f"this {kind.__name__} is closed"):
            other.process(READINGS[2:3])


# What a user holds: how one is made, and a call that changes it.
HELD: dict[str, Callable[[Path], tuple[Any, Callable[[], Any]]]] = {
    "Localizer": lambda folder: with_call(localizer(), "process", READINGS[0]),
    "LocalizerInStep": lambda folder: with_call(LocalizerInStep(localizer()), "process", READINGS[:1]),
    "DenseOdometry": lambda folder: with_call(DenseOdometry(CALIBRATION), "process", FRAME),
    "FeatureOdometry": lambda folder: with_call(FeatureOdometry(CALIBRATION), "process", FRAME),
    "WheelOdometry": lambda folder: with_call(WheelOdometry(WHEELS), "process", READINGS[0]),
    "KeyframeStore": lambda folder: with_call(KeyframeStore(), "move", [], np.zeros((0, 4, 4))),
    "RecordingWriter": lambda folder: with_call(RecordingWriter(folder / "new", CALIBRATION), "add", READINGS[0]),
}


def with_call(one: Any, method: str, *given: Any) -> tuple[Any, Callable[[], Any]]:
    return one, lambda: getattr(one, method)(*given)


@pytest.mark.parametrize("kind", HELD)
def test_each_object_with_a_state_is_guarded(kind: str, tmp_path: Path) -> None:
    one, call = HELD[kind](tmp_path)
    with ThreadPoolExecutor(1) as pool:
        pool.submit(one._turn.acquire).result(60)  # noqa: SLF001 - as a call in that thread does
        with pytest.raises(ArgumentError, match=f"this {kind} is at work in another thread"):
            call()
        pool.submit(one._turn.release).result(60)  # noqa: SLF001
    for copied in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(ArgumentError, match=f"a {kind} can be neither copied nor pickled"):
            copied(one)
    call()
    if hasattr(one, "close"):
        one.close()


def test_guarded_are_those_that_lead_a_robot_too() -> None:
    assert issubclass(Navigator, OneCaller)
    assert issubclass(Simulator, OneCaller)

"""LocalizerApart: it answers as it would here, and where its process goes wrong or dies that is said."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from localizer.made_apart import (
    CANNOT_BE_SENT,
    DIES,
    IS_ENDED,
    MOVES,
    RAISES,
    frame,
    real,
    refusing,
    slow_to_close,
    telling,
    ticks,
)
from narrowing import not_none

from benchmarks.plain_rooms import WHEELS
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError, DeviceError, MapError, WheelsightError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.estimation import Localizer, LocalizerApart, LocalizerBeside

pytestmark = pytest.mark.slow  # each begins a process
ENDING_S = 20.0


@pytest.fixture
def closed(tmp_path: Path) -> Path:
    return tmp_path / "closed.txt"


@pytest.fixture
def subject(closed: Path) -> Iterator[LocalizerApart]:
    made = LocalizerApart(telling, closed, keeps_keyframes=True)
    yield made
    made.close()
    assert not multiprocessing.active_children()


def test_it_answers_as_it_would_here() -> None:
    calibration, config = Calibration(wheels=WHEELS), load_config(overrides={"odometry": "wheels"})
    here, subject = Localizer(calibration, config), LocalizerApart(real, calibration, config)
    for n in range(50):
        answer, expected = subject.process(ticks(0.02 * n)), not_none(here.process(ticks(0.02 * n)))
        assert not_none(answer).status is expected.status
        np.testing.assert_array_equal(not_none(answer).T_odom_body, expected.T_odom_body)
        np.testing.assert_array_equal(not_none(answer).covariance, expected.covariance)
    subject.close()


def test_what_is_kept_and_moved_there_is_kept_and_moved_here(subject: LocalizerApart) -> None:
    assert subject.recognised == 0
    store = not_none(subject.keyframes)
    for stamp_s in (1.0, 2.0, 3.0):
        assert not_none(subject.process(frame(stamp_s))).stamp_s == stamp_s
    # That of the newest frame is reported with the next one.
    assert (len(store), subject.recognised, store.revision) == (2, 3, 0)
    assert subject.warnings == ("3 keyframes",)
    subject.process(frame(MOVES))
    assert (len(store), store.revision) == (3, 1)
    for number, stamp_s in enumerate((1.0, 2.0, 3.0)):
        keyframe = store[KeyframeId(number)]
        np.testing.assert_allclose(keyframe.depth_m, 1.0 + stamp_s / 10, atol=1e-4)
        assert (keyframe.stamp_s, keyframe.grey_png) == (stamp_s, b"")
        np.testing.assert_allclose(store.pose(KeyframeId(number)), se3.from_plane(MOVES + stamp_s, 0.0, 0.0))


def test_between_frames_nothing_is_reported_of_keyframes(subject: LocalizerApart) -> None:
    subject.process(frame(1.0))
    subject.process(ticks(2.0))
    assert len(not_none(subject.keyframes)) == 0


def test_it_is_closed_there(subject: LocalizerApart, closed: Path) -> None:
    assert not closed.exists()
    subject.close()
    assert closed.read_text() == "closed"


def test_what_is_raised_there_is_raised_here_and_it_is_closed(subject: LocalizerApart, closed: Path) -> None:
    with pytest.raises(MapError, match="a/map:7: an unlucky event") as caught:
        subject.process(ticks(RAISES))
    assert (caught.value.line, caught.value.fix) == (7, "another one")
    assert "made_apart.py" in caught.value.__notes__[0]
    assert closed.exists()
    with pytest.raises(DeviceError, match="has ended"):
        subject.process(ticks(1.0))


def test_what_cannot_be_reported_is_reported_in_words(subject: LocalizerApart, closed: Path) -> None:
    with pytest.raises(WheelsightError, match="StrangeError"):
        subject.process(ticks(CANNOT_BE_SENT))
    assert closed.exists()


def test_where_it_cannot_be_made_that_is_said() -> None:
    with pytest.raises(ConfigError, match=r"nobody can make it \(another one\)"):
        LocalizerApart(refusing)
    assert not multiprocessing.active_children()


def test_a_process_that_is_killed_is_reported_to_who_leads_the_robot(closed: Path) -> None:
    subject = LocalizerApart(telling, closed)
    beside, until_s = LocalizerBeside(subject), time.monotonic() + ENDING_S

    def hear() -> None:
        while time.monotonic() < until_s:
            beside.process([ticks(DIES)])
            time.sleep(0.01)

    with pytest.raises(DeviceError, match="the localization process has ended by signal 9"):
        hear()
    beside.close()
    assert not multiprocessing.active_children()


def test_a_process_that_hangs_is_killed_at_the_end(closed: Path) -> None:
    """Nothing waits for it for ever: neither the end of the program nor the call that it does not answer."""
    subject = LocalizerApart(telling, closed)
    beside, until_s = LocalizerBeside(subject), time.monotonic() + ENDING_S
    beside.process([ticks(1.0)])
    while not beside.process([]):
        assert time.monotonic() < until_s
        time.sleep(0.01)
    (process,) = multiprocessing.active_children()
    os.kill(not_none(process.pid), signal.SIGSTOP)
    for n in range(2, 20):
        assert beside.process([ticks(float(n))]) == []
        time.sleep(0.05)  # until the thread waits for an answer
    beside.close()
    assert not multiprocessing.active_children()
    assert not closed.exists()


def test_a_process_that_hangs_while_it_closes_is_said(closed: Path) -> None:
    subject = LocalizerApart(telling, closed)
    (process,) = multiprocessing.active_children()
    os.kill(not_none(process.pid), signal.SIGSTOP)
    with pytest.raises(DeviceError, match="hung and was killed"):
        subject.close()
    assert not multiprocessing.active_children()


def test_a_process_that_closes_slowly_is_waited_for(closed: Path) -> None:
    """Longer than a process is that gives no sign of life: a map is written."""
    LocalizerApart(slow_to_close, closed, 7.0).close()
    assert closed.read_text() == "closed"


def test_a_process_that_the_system_ends_closes_what_was_made(subject: LocalizerApart, closed: Path) -> None:
    with pytest.raises(DeviceError, match="with exit code 143"):
        subject.process(ticks(IS_ENDED))
    assert closed.exists()


@pytest.mark.parametrize("ending", ["os.kill(os.getpid(), 9)", "sys.exit(0)"], ids=["killed", "exits"])
def test_where_the_robots_program_ends_what_was_made_is_closed(closed: Path, ending: str) -> None:
    """A map is written to its end, and no process is left."""
    tests = Path(__file__).parent.parent
    script = closed.with_name("script.py")
    script.write_text(
        "import os, sys, pathlib\n"
        f"sys.path.insert(0, {str(tests)!r})\n"
        "from localizer.made_apart import telling\n"
        "from wheelsight.estimation import LocalizerApart\n"
        "if __name__ == '__main__':\n"
        f"    subject = LocalizerApart(telling, pathlib.Path({str(closed)!r}))\n"
        f"    {ending}\n"
    )
    assert subprocess.run([sys.executable, script], check=False, timeout=60).returncode in (-9, 0)
    until_s = time.monotonic() + ENDING_S
    while not closed.exists() and time.monotonic() < until_s:
        time.sleep(0.05)
    assert closed.exists()

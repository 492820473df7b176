"""The link against a simulated controller behind a pseudo-terminal."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from wheelsight.core.errors import DeviceError
from wheelsight.core.messages import WheelTicks
from wheelsight.io.devices import Format, LinkStatus, WheelLink
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.io.devices.wire_formats import Counts, LinkCommand, drive_body, encode_message


@pytest.fixture
def controller(tmp_path: Path) -> Iterator[SimulatedController]:
    with SimulatedController(tmp_path) as simulated:
        yield simulated


@pytest.fixture
def port(controller: SimulatedController) -> str:
    return str(controller.port)


def wait(is_so: Callable[[], bool], seconds: float = 60.0) -> None:
    ends_s = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < ends_s, "it did not come"
        time.sleep(0.005)


def catch_up(link: WheelLink, controller: SimulatedController) -> None:
    """Let the wheels rest, and wait until the link has counted what the controller has; one tick off is for ever."""
    controller.speeds = (0, 0)
    wait(
        lambda: (
            (last := link.report().last) is not None and (last.left, last.right) == (controller.left, controller.right)
        )
    )


def waiting(link: WheelLink) -> list[WheelTicks]:
    gathered = []
    while (ticks := link.read(0)) is not None:
        gathered.append(ticks)
    return gathered


def connected(link: WheelLink) -> Callable[[], bool]:
    return lambda: link.status is LinkStatus.CONNECTED


def test_ticks_arrive_complete_in_order_and_by_the_hosts_clock(controller: SimulatedController, port: str) -> None:
    controller.speeds = (157, -100)
    with WheelLink(port) as link:
        wait(lambda: link.report().line.frames > 25)
        catch_up(link, controller)
        report, gathered, now_s = link.report(), waiting(link), time.time()
    assert report.format is Format.FRAMED
    assert (report.line.crc_errors, report.line.malformed, report.line.lost, report.restarts) == (0, 0, 0, 0)
    assert all(before.stamp_s < after.stamp_s for before, after in pairwise(gathered))
    assert gathered[-1].stamp_s == pytest.approx(now_s, abs=3600)  # the controller's begins at zero


def test_it_only_listens_until_reported(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        wait(connected(link))
    assert controller.commands == []


def test_ticks_wait_and_end_with_the_link(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        gathered = []
        for ticks in link.ticks():
            gathered.append(ticks)
            if len(gathered) == 5:
                link.close()
    assert len(gathered) >= 5
    assert list(link.ticks()) == []
    assert link.read(0.01) is None
    assert link.status is LinkStatus.CLOSED


def test_garbage_on_the_line_costs_nothing(controller: SimulatedController, port: str) -> None:
    controller.speeds = (50, 60)
    with WheelLink(port) as link:
        wait(connected(link))
        for _ in range(10):
            controller.send(os.urandom(30))
            time.sleep(0.03)
        catch_up(link, controller)
        report = link.report()
    assert report.restarts == 0
    assert report.line.crc_errors + report.line.malformed > 5


def test_unplugged_and_plugged_in_again(controller: SimulatedController, port: str) -> None:
    controller.speeds = (80, 70)
    reported: list[LinkStatus] = []
    with WheelLink(port, on_status=reported.append) as link:
        wait(connected(link))
        link.drive(0.5, 0.5)
        wait(lambda: controller.duties == (500, 500))
        controller.unplug()
        wait(lambda: link.status is LinkStatus.VANISHED)
        with pytest.raises(DeviceError, match="the port vanished"):
            link.drive(0.5, 0.5)
        time.sleep(0.1)
        commands = len(controller.commands)
        time.sleep(0.3)
        controller.plug()
        wait(connected(link))
        catch_up(link, controller)
        report = link.report()
        assert controller.commands[commands:] == []  # it does not drive on by itself
    assert (report.reconnects, report.restarts) == (1, 0)
    connected_again = [LinkStatus.CONNECTED, LinkStatus.VANISHED, LinkStatus.LISTENING, LinkStatus.CONNECTED]
    assert reported == [*connected_again, LinkStatus.CLOSED]


@pytest.mark.parametrize("is_unplugged", [True, False])
def test_a_restarted_controller_invents_no_ticks(
    controller: SimulatedController, port: str, is_unplugged: bool
) -> None:
    controller.left, controller.right = 1_000_000, -2_000_000
    time.sleep(0.2)
    with WheelLink(port) as link:
        wait(connected(link))
        if is_unplugged:
            controller.unplug()
            wait(lambda: link.status is LinkStatus.VANISHED)
            controller.restart()
            controller.plug()
        else:
            controller.restart()
        wait(lambda: link.report().restarts == 1)
        controller.speeds = (10, 20)
        time.sleep(0.2)
        catch_up(link, controller)
        gathered = waiting(link)
        assert link.report().line.lost == 0
    assert all(0 <= after.left - before.left <= 20 for before, after in pairwise(gathered))


def test_frames_that_come_together_with_those_of_a_restart_are_no_loss(
    controller: SimulatedController, port: str
) -> None:
    """As a busy host reads them; the test above meets it by chance alone."""
    controller.is_muted = True
    controller.unplug()  # with what it has said by itself
    controller.plug()
    before = [Counts(100 + k, 1_000_000 + 1000 * k, 5000, 7000) for k in range(3)]
    after = [Counts(k, 1000 * k, 0, 0) for k in range(40)]
    with WheelLink(port) as link:
        controller.send(b"".join(map(encode_message, before + after)))
        wait(lambda: link.report().line.frames == len(before + after))
        wait(lambda: link.report().restarts == 1)
        wait(lambda: link.report().line.lost == 0)  # forgiven right after it is known
        assert {(ticks.left, ticks.right) for ticks in waiting(link)} == {(5000, 7000)}


def test_reset_counts_is_no_motion(controller: SimulatedController, port: str) -> None:
    controller.speeds = (30, -20)
    with WheelLink(port) as link:
        wait(connected(link))
        time.sleep(0.1)
        link.reset_counts()
        time.sleep(0.1)
        catch_up(link, controller)
        assert link.report().restarts == 0


def test_version(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        version = link.ask_version()
        assert version[1:] == (1, 2, 3, 0)
        assert link.report().version == version


def test_the_papers_format_end_to_end(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        wait(connected(link))
        controller.speeds = (99, -98)
        link.set_format(Format.PAPER)
        wait(lambda: link.report().format is Format.PAPER)
        link.stop()  # not answered, and not waited for
        time.sleep(0.2)
        catch_up(link, controller)
        link.set_format(Format.FRAMED)
        wait(lambda: link.report().format is Format.FRAMED)
        time.sleep(0.1)
        catch_up(link, controller)
    assert controller.commands[1][0] == LinkCommand.STOP


@pytest.mark.parametrize("is_known", [True, False])
def test_the_papers_format_may_be_asked_for_twice(controller: SimulatedController, port: str, is_known: bool) -> None:
    controller.is_paper = True
    with WheelLink(port) as link:
        if is_known:
            wait(lambda: link.report().format is Format.PAPER)
        link.set_format(Format.PAPER)
        assert link.report().format is Format.PAPER
        with pytest.raises(DeviceError, match=r"paper's format, which has no answers \(set_format"):
            link.ask_version()
        controller.answers = False
        with pytest.raises(DeviceError, match="does not answer SET_FORMAT"):
            link.set_format(Format.FRAMED)


def test_drive_is_kept_up_and_ends_with_stop(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        link.drive(0.3, -0.25)
        wait(lambda: controller.duties == (300, -250))
        before = len(controller.commands)
        wait(lambda: len(controller.commands) >= before + 10)
        assert set(controller.commands) == {(LinkCommand.DRIVE, drive_body(0.3, -0.25))}
        assert controller.duties == (300, -250)
        link.stop()
        assert controller.duties == (0, 0)
        link.drive(1, 1)
        wait(lambda: controller.duties == (1000, 1000))
    wait(lambda: controller.duties == (0, 0))
    assert controller.commands[-1][0] == LinkCommand.STOP


def test_drive_with_a_limit_stops_a_program_that_hangs(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        link.drive(0.5, 0.5, hold_s=0.2)
        wait(lambda: controller.commands[-1:] == [(LinkCommand.STOP, b"")])
        assert link.status is not LinkStatus.CLOSED


def test_an_exception_stops_the_motors(controller: SimulatedController, port: str) -> None:
    def broken() -> None:
        with WheelLink(port) as link:
            link.drive(0.5, 0.5)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        broken()
    wait(lambda: controller.commands[-1:] == [(LinkCommand.STOP, b"")])


@pytest.mark.parametrize("ending", ["", "raise SystemExit(3)", "1 / 0", "os.kill(os.getpid(), 9)"])
def test_a_program_that_ends_in_any_way_stops_the_motors(
    controller: SimulatedController, port: str, ending: str
) -> None:
    program = textwrap.dedent(f"""
        import os, sys
        from wheelsight.io.devices import WheelLink
        link = WheelLink(sys.argv[1])
        link.drive(0.5, 0.5)
        sys.stdout.write("driving\\n"); sys.stdout.flush()
        sys.stdin.readline()
        {ending}
    """)
    arguments = [sys.executable, "-c", program, port]
    pipe, nowhere = subprocess.PIPE, subprocess.DEVNULL
    with subprocess.Popen(arguments, stdin=pipe, stdout=pipe, stderr=nowhere) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"driving\n"
        wait(lambda: controller.duties == (500, 500))
        process.communicate(b"\n", timeout=30)
    wait(lambda: controller.duties == (0, 0))
    is_reported = controller.commands[-1][0] == LinkCommand.STOP
    assert is_reported != ("kill" in ending)  # only the watchdog is left to stop for a program that was killed


def test_impossible_duties_are_refused(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        for duties in ((1.01, 0), (0, -2), (float("nan"), 0)):
            with pytest.raises(DeviceError, match="not -1 to 1"):
                link.drive(*duties)
    assert controller.commands == []


def test_a_controller_that_does_not_answer(controller: SimulatedController, port: str) -> None:
    controller.answers = False
    with WheelLink(port) as link, pytest.raises(DeviceError, match="does not answer GET_VERSION"):
        link.ask_version()


def test_silence_is_reported_and_ends(controller: SimulatedController, port: str) -> None:
    controller.is_muted = True
    with WheelLink(port) as link:
        wait(lambda: link.status is LinkStatus.NO_DATA)
        controller.is_muted = False
        wait(connected(link))


def test_noise_is_reported(controller: SimulatedController, port: str) -> None:
    """A controller heard at the wrong baud rate."""
    controller.is_muted = True
    time.sleep(0.1)  # for what was on its way
    with WheelLink(port) as link:
        while link.status is LinkStatus.LISTENING:
            controller.send(os.urandom(7))
            time.sleep(0.02)
        assert link.status is LinkStatus.NOISE
        assert "wrong baud rate" in link.status


def test_no_such_port(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=rf"^{tmp_path / 'none'}: there is no such port \("):
        WheelLink(str(tmp_path / "none"))


def test_two_programs_on_one_port(controller: SimulatedController, port: str) -> None:
    with WheelLink(port) as link:
        with pytest.raises(DeviceError, match="in use by another program"):
            WheelLink(port)
        wait(connected(link))
    WheelLink(port).close()


def test_no_permission(port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Anyone who runs the tests may be root, who may open anything; so the system's answer is given for it."""

    def denied(*_: object) -> int:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(os, "open", denied)
    with pytest.raises(DeviceError, match=r"no permission to open the port \(join its group"):
        WheelLink(port)


def test_not_a_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("text")
    with pytest.raises(DeviceError, match="is not a serial port"):
        WheelLink(str(tmp_path / "file"))
    with pytest.raises(DeviceError, match=r"cannot be opened|is not a serial port"):
        WheelLink(str(tmp_path))


def test_ticks_that_no_one_fetches_are_dropped_from_the_oldest(
    controller: SimulatedController, port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wheelsight.io.devices.wheel_link._MOST_QUEUED", 5)
    controller.speeds = (1, 1)
    with WheelLink(port) as link:
        wait(lambda: link.report().overrun >= 10)
        newest = link.report().last
        gathered = waiting(link)
    assert len(gathered) <= 6
    assert newest is not None
    assert gathered[-1].left >= newest.left

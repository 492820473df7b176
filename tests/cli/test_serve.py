"""`wheelsight serve`: what is refused before anything moves, who may speak to it, and that Ctrl-C ends it."""

from __future__ import annotations

import re
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from running import interrupted
from sessions.kept_views import write_map

from wheelsight.app.cli.console import CountedLines, print_warning
from wheelsight.app.cli.serve import PageOptions, access_of, addresses
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import why_missing

Refusal = Callable[..., str]


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ((), "no robot is named (one of --sim WORLD and --robot PORT)"),
        (("--sim", "flat", "--robot", "p"), "a robot is either simulated or real"),
        (("--sim", "flat"), "there is no map to drive in (--map DIR; or --out DIR"),
        (("--sim", "flat", "--yes"), "--yes is of a real robot"),
        (("--sim", "flat", "--map", "nowhere"), "there is no such folder"),
        (("--sim", "flat", "--out", "maps", "--known-start", "0,0,0"), "--known-start is of a map (--map DIR)"),
        (("--sim", "flat", "--out", "maps", "--token", "short"), "--token can be guessed"),
        (("--sim", "flat", "--out", "maps", "--token", "with signs; 0123456789"), "--token can be guessed"),
        (("--sim", "nowhere", "--out", "maps"), "--sim is 'nowhere', no world and no file"),
        (("--sim", "flat", "--out", "maps", "--set", "page.updates_hz=0"), "page.updates_hz"),
    ],
)
def test_what_means_nothing_is_refused_in_a_line(refusal: Refusal, options: tuple[str, ...], problem: str) -> None:
    assert problem in refusal("serve", *options)


def test_where_a_robot_stands_needs_a_heading(refusal: Refusal, tmp_path: Path) -> None:
    write_map(tmp_path / "home", 3)
    reported = refusal("serve", "--sim", "flat", "--map", tmp_path / "home", "--known-start", "1,2")
    assert reported.startswith("--known-start is '1,2' (X,Y,YAW_DEG")


def test_a_file_for_rerun_that_is_there_is_refused_before_a_robot_is_made(refusal: Refusal, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    (tmp_path / "drive.rrd").write_text("mine")
    reported = refusal("serve", "--sim", "flat", "--out", tmp_path / "maps", "--rerun", tmp_path / "drive.rrd")
    assert reported == f"{tmp_path / 'drive.rrd'}: is there already (choose another --rerun)"
    assert (tmp_path / "drive.rrd").read_text() == "mine"


def served(host: str, token: str | None = None) -> PageOptions:
    return PageOptions(host=host, token=token)


def test_a_token_is_made_for_all_but_this_computer() -> None:
    assert access_of(served("127.0.0.1")).token == ""
    assert access_of(served("::1")).is_loopback
    made = {access_of(served(host)).token for host in ("0.0.0.0", "192.168.1.3", "robot.home", "::")}
    assert len(made) == 4
    assert min(map(len, made)) >= 32
    assert not access_of(served("0.0.0.0")).is_loopback
    given = access_of(served("127.0.0.1", "0123456789abcdef"))
    assert given.token == "0123456789abcdef"
    with pytest.raises(ConfigError, match="16 letters and digits"):
        access_of(served("0.0.0.0", "0123"))


def test_the_address_that_is_printed_holds_the_token() -> None:
    assert addresses("127.0.0.1", 8765, "") == ["http://127.0.0.1:8765/"]
    assert addresses("::1", 80, "abc") == ["http://[::1]:80/?token=abc"]
    (reported,) = addresses("0.0.0.0", 80, "abc")
    assert "0.0.0.0" not in reported


def test_a_flood_of_refusals_is_counted_and_not_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with CountedLines(print_warning) as refusals:
        for number in range(500):
            refusals.add(f"refused {number}")
            refusals.add("refused 10.0.0.7: no token")
        refusals.add("refused 10.0.0.8: no HTTP (70 times)")
        refusals.add("the port is gone", is_problem=True)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) <= 14
    assert "warning: the port is gone" in lines, "a problem is not among the others"
    counts = [re.search(r"\((\d+) times\)", line) for line in lines]
    assert sum(1 if count is None else int(count[1]) for count in counts) == 1071, "each is counted"


def test_a_terminal_that_takes_nothing_holds_up_no_thread() -> None:
    goes_on, printed = threading.Event(), list[str]()

    def hangs(line: str) -> None:
        goes_on.wait(20)
        printed.append(line)

    with CountedLines(hangs) as refusals:
        for _ in range(1000):
            refusals.add("refused 10.0.0.7: no token")
        assert not printed
        goes_on.set()
    assert printed


@pytest.mark.slow
def test_it_serves_until_it_is_interrupted_and_leaves_a_map(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "wheelsight", "serve", "--sim", "studio", "--size", "160x120", "--port", "0"]
    command += ["--out", str(tmp_path / "maps"), "--host", "0.0.0.0"]
    shown = [] if why_missing("rerun") else ["--rerun", str(tmp_path / "drive.rrd")]
    command += shown
    with interrupted(command) as output:
        line = output.readline()
        found = re.fullmatch(r"http://[^:/]+:(\d+)/\?token=(\w{32,})\n", line)
        assert found is not None, line
        port, token = found.groups()
        home = f"http://127.0.0.1:{port}/"
        with pytest.raises(HTTPError, match="401"):
            urlopen(home, timeout=20)
        with urlopen(f"{home}?token={token}", timeout=20) as answer:
            assert b"STOP" in answer.read()
        time.sleep(5)  # there is something to write
    (made,) = (tmp_path / "maps").iterdir()
    assert (made / "map" / "map.json").is_file()
    assert not shown or (tmp_path / "drive.rrd").stat().st_size > 10_000

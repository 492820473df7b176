"""A Dask scheduler and two workers in processes of their own: one is killed while it works, and nothing is lost."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import batch_jobs as works
import pytest
from batch_jobs import job, tries, until

from wheelsight.core.errors import ConfigError, DeviceError
from wheelsight_batch import run_on_fleet

pytest.importorskip("distributed", reason="Dask is not installed (the extra fleet)")
pytestmark = [
    pytest.mark.slow,
    # Dask's client closes its sockets when it is collected.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start(tmp_path: Path, project_folder: Path) -> Iterator[Start]:
    """Starts a program of Dask, whose end is that of the test."""
    path = os.pathsep.join([str(project_folder), str(project_folder / "tests")])
    started: list[subprocess.Popen[str]] = []

    def begin(*words: str) -> subprocess.Popen[str]:
        (tmp_path / "log").mkdir(exist_ok=True)
        log = (tmp_path / "log" / f"{len(started)}.txt").open("w")
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:], "--no-dashboard"]
        environment = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
        started.append(subprocess.Popen(command, env=environment, cwd=tmp_path, stdout=log, stderr=log, text=True))
        log.close()
        return started[-1]

    yield begin
    for process in reversed(started):
        process.kill()
        process.wait()


@pytest.fixture
def scheduler(start: Start, tmp_path: Path) -> str:
    """Its address, on loopback."""
    start("scheduler", "--host", "127.0.0.1", "--port", "0")
    log = tmp_path / "log" / "0.txt"
    until(lambda: re.search(r"Scheduler at:\s+(tcp://127\.0\.0\.1:\d+)", log.read_text()))
    found = re.search(r"Scheduler at:\s+(\S+)", log.read_text())
    assert found is not None
    return found[1]


@pytest.fixture
def worker(start: Start, scheduler: str) -> Callable[[], subprocess.Popen[str]]:
    """Starts one, which nothing starts again once it is killed."""
    return lambda: start("worker", scheduler, "--no-nanny", "--nthreads", "1", "--host", "127.0.0.1")


def test_a_worker_that_is_killed_while_it_works_takes_no_job_with_it(
    scheduler: str, worker: Callable[[], subprocess.Popen[str]], tmp_path: Path
) -> None:
    workers = {process.pid: process for process in (worker(), worker())}
    jobs = [job(name, marks=tmp_path) for name in "abcdef"]
    answers = run_on_fleet(jobs, scheduler, works.waits)
    begun: list[int] = []

    def both_work() -> bool:
        begun[:] = [pid for name in "abcdef" for pid in tries(tmp_path, name)]
        return len(set(begun)) == 2

    def kill_one() -> None:
        until(both_work)
        os.kill(begun[0], signal.SIGKILL)
        workers[begun[0]].wait()
        (tmp_path / "go").write_text("")

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    outcomes = list(answers)
    killer.join()
    assert sorted(outcome.job for outcome in outcomes) == list("abcdef")
    assert [outcome.problem for outcome in outcomes] == [None] * 6
    again = [name for name in "abcdef" if len(tries(tmp_path, name)) == 2]
    assert len(again) == 1
    assert tries(tmp_path, again[0])[0] == begun[0]


def test_one_that_kills_each_worker_is_given_up(
    scheduler: str, worker: Callable[[], subprocess.Popen[str]], tmp_path: Path
) -> None:
    for _ in range(5):
        worker()
    jobs = [job(name, marks=tmp_path) for name in ("fatal", "a")]
    outcomes = {outcome.job: outcome for outcome in run_on_fleet(jobs, scheduler, works.dies_always)}
    assert outcomes["fatal"].is_killed
    assert outcomes["fatal"].problem == f"{len(tries(tmp_path, 'fatal'))} workers died while they ran it"
    assert outcomes["a"].problem is None


def test_a_scheduler_without_workers_is_reported(scheduler: str, tmp_path: Path) -> None:
    reported: list[str] = []
    with suppress(_EnoughError):
        list(run_on_fleet([job("a")], scheduler, works.quick, on_note=_raising(reported)))
    assert reported == ["the scheduler has no worker yet; work begins when one comes: dask worker ADDRESS --nthreads 1"]


class _EnoughError(Exception):
    """Ends a test that would wait."""


def _raising(reported: list[str]) -> Callable[[str], None]:
    def tell(note: str) -> None:
        reported.append(note)
        raise _EnoughError

    return tell


def test_where_no_scheduler_answers_that_is_said() -> None:
    with pytest.raises(DeviceError, match=r"no scheduler answers at tcp://127\.0\.0\.1:9"):
        next(run_on_fleet([job("a")], "tcp://127.0.0.1:9", works.quick, connect_s=1.0))
    with pytest.raises(DeviceError, match="no scheduler answers"):
        next(run_on_fleet([job("a")], "nonsense://x", works.quick, connect_s=1.0))


def test_without_dask_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"Dask is missing \(pip install distributed\)"):
        next(run_on_fleet([job("a")], "tcp://127.0.0.1:9", works.quick))

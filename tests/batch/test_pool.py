"""Processes that run jobs: all are answered, whatever becomes of a process."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import batch_jobs as works
import pytest
from batch_jobs import job, tries, until

from wheelsight_batch import Job, run_on_processes


@pytest.fixture(autouse=True)
def none_is_left() -> object:
    """Processes of earlier tests are none of ours."""
    before = {process.pid for process in multiprocessing.active_children()}
    yield None
    assert {process.pid for process in multiprocessing.active_children()} <= before


def is_running(process: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.slow
def test_a_job_whose_process_is_killed_is_run_again_in_another_and_none_is_lost(tmp_path: Path) -> None:
    jobs = [job(name, marks=tmp_path) for name in ("a", "fatal", "b", "c", "d")]
    reported: list[tuple[Job, str]] = []
    tell: Callable[[Job, str], None] = lambda *death: reported.append(death)  # noqa: E731
    outcomes = list(run_on_processes(jobs, 2, works.dies_once, tmp_path, on_death=tell))
    assert sorted(outcome.job for outcome in outcomes) == sorted(one.id for one in jobs)
    assert [outcome.problem for outcome in outcomes] == [None] * 5
    first, second = tries(tmp_path, "fatal")
    assert first != second
    ((which, why),) = reported
    assert which.id == "fatal"
    assert why == "its process was killed by SIGKILL, as the system does where memory runs out"
    assert {len(tries(tmp_path, name)) for name in "abcd"} == {1}


@pytest.mark.slow
def test_one_that_kills_each_process_is_given_up_and_the_rest_goes_on(tmp_path: Path) -> None:
    jobs = [job(name, marks=tmp_path) for name in ("fatal", "a", "b")]
    outcomes = {outcome.job: outcome for outcome in run_on_processes(jobs, 1, works.dies_always, tmp_path, tries=2)}
    assert len(tries(tmp_path, "fatal")) == 2
    assert outcomes["fatal"].is_killed
    assert outcomes["fatal"].problem is not None
    assert outcomes["fatal"].problem.endswith("where memory runs out, twice")
    assert [outcomes[name].problem for name in "ab"] == [None, None]


def test_one_that_ends_its_process_says_with_what_code(tmp_path: Path) -> None:
    (outcome,) = run_on_processes([job("a")], 1, works.ends_itself, tmp_path, tries=1)
    assert outcome.problem == "its process ended with code 1: no more, once"


def test_processes_do_not_hear_ctrl_c_and_one_runs_several_jobs(tmp_path: Path) -> None:
    jobs = [job(name) for name in "abc"]
    outcomes = list(run_on_processes(jobs, 1, works.hears, tmp_path, tries=1))
    assert [outcome.job for outcome in outcomes] == ["a", "b", "c"]
    assert [outcome.problem for outcome in outcomes] == [None] * 3
    assert len([path for path in tmp_path.iterdir() if path.name.startswith("worker-")]) == 1


@pytest.mark.slow
def test_who_stops_asking_leaves_no_process(tmp_path: Path) -> None:
    (tmp_path / "now").mkdir()
    (tmp_path / "now" / "go").write_text("")
    jobs = [job("a", marks=tmp_path / "now"), job("b", marks=tmp_path)]
    answers = run_on_processes(jobs, 2, works.waits, tmp_path)
    assert next(answers).problem is None
    until(lambda: tries(tmp_path, "b"))
    answers.close()
    assert not is_running(tries(tmp_path, "b")[0])


def test_ctrl_c_while_jobs_run_leaves_no_process(tmp_path: Path) -> None:
    before, here = signal.signal(signal.SIGINT, signal.default_int_handler), threading.get_ident()

    def press() -> None:
        until(lambda: tries(tmp_path, "a"))
        signal.pthread_kill(here, signal.SIGINT)

    presser = threading.Thread(target=press)
    try:
        presser.start()
        with pytest.raises(KeyboardInterrupt):
            next(run_on_processes([job("a", marks=tmp_path)], 1, works.waits, tmp_path))
    finally:
        presser.join()
        signal.signal(signal.SIGINT, before)
    (worker,) = tries(tmp_path, "a")
    assert not is_running(worker)


@pytest.mark.slow
def test_processes_end_with_the_one_that_started_them(tmp_path: Path, project_folder: Path) -> None:
    code = (
        "import batch_jobs, pathlib, sys\nfrom wheelsight_batch import run_on_processes\n"
        "if __name__ == '__main__':\n"
        f"    here = pathlib.Path({str(tmp_path)!r})\n"
        "    jobs = [batch_jobs.job(name, marks=here) for name in 'ab']\n"
        "    list(run_on_processes(jobs, 2, batch_jobs.waits, here))\n"
    )
    (tmp_path / "program.py").write_text(code)
    path = os.pathsep.join([str(project_folder), str(project_folder / "tests")])
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "program.py")], env={**os.environ, "PYTHONPATH": path}
    ) as one:
        until(lambda: all(tries(tmp_path, name) for name in "ab"))
        workers = [tries(tmp_path, name)[0] for name in "ab"]
        assert all(map(is_running, workers))
        one.kill()
    until(lambda: not any(map(is_running, workers)))
    until(lambda: not list(tmp_path.glob("worker-*")))

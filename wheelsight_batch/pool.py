"""Runs jobs in processes of this computer or on workers of a Dask scheduler. The death of one process does not affect
the others.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Protocol

from wheelsight.core.errors import DeviceError
from wheelsight.core.files import StrPath
from wheelsight.core.runtime import needed
from wheelsight_batch.jobs import Job, Outcome, problem_of
from wheelsight_batch.worker import serve

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_END_S = 10.0


class Work(Protocol):
    """An importable function, so that another process can call it."""

    def __call__(self, job: Job, /) -> Outcome:
        """Run a job."""


@dataclass(slots=True)
class _Worker:
    """A process with its connection, its job, and its stderr."""

    process: SpawnProcess
    connection: Connection
    log: Path
    job: Job | None = None


def run_on_processes(
    jobs: Sequence[Job],
    processes: int,
    work: Work,
    scratch: StrPath,
    *,
    tries: int = 2,
    on_death: Callable[[Job, str], None] = lambda job, why: None,
) -> Generator[Outcome]:
    """Yield outcomes in the order of their ends. No process remains after the iteration.

    Only this process gets Ctrl-C and the end of the terminal; it ends the others.

    Args:
        jobs: in this order.
        processes: maximum number of processes.
        work: called with each job.
        scratch: folder for temporary files.
        tries: number of runs of a job whose process dies, each in another process.
        on_death: called with each job whose process died and that is tried again, and the cause.
    """
    waiting, tried, workers = deque(jobs), Counter[str](), list[_Worker]()
    try:
        while waiting or any(worker.job is not None for worker in workers):
            _hand_out(waiting, workers, processes, lambda: _start(work, Path(scratch)))
            # Wait until busy workers have answered or died
            busy = [worker for worker in workers if worker.job is not None]
            ready = wait([worker.connection for worker in busy])
            answered = [worker for worker in busy if worker.connection in ready]
            for worker in answered:
                job, outcome = _take(worker)
                if outcome is None:
                    workers.remove(worker)
                    # The reason for the end of the process
                    worker.process.join(_END_S)
                    code = worker.process.exitcode
                    _end(worker)
                    if code is not None and code < 0:
                        name = signal.Signals(-code).name if -code in list(signal.Signals) else f"signal {-code}"
                        hint = ", as the system does where memory runs out" if name == "SIGKILL" else ""
                        why = f"its process was killed by {name}{hint}"
                    else:
                        lines = (
                            worker.log.read_text(encoding="utf-8", errors="replace").split("\n")
                            if worker.log.exists()
                            else []
                        )
                        said = [line.strip() for line in lines if line.strip()]
                        last_line = f": {said[-1]}" if said else ""
                        why = f"its process ended with code {code}{last_line}"
                    tried[job.id] += 1
                    if tried[job.id] < tries:
                        waiting.appendleft(job)
                        on_death(job, why)
                        continue
                    count = tried[job.id]
                    times = {1: "once", 2: "twice"}.get(count, f"{count} times")
                    outcome = Outcome(job.id, f"{why}, {times}", is_killed=True)
                yield outcome
    finally:
        for worker in workers:
            _end(worker)


def _hand_out(waiting: deque[Job], workers: list[_Worker], processes: int, start: Callable[[], _Worker]) -> None:
    """Give a job to each free worker, and start workers while there are jobs and cores."""
    for worker in [worker for worker in workers if worker.job is None]:
        if waiting and not _give(worker, waiting):
            workers.remove(worker)
            _end(worker)
    while waiting and len(workers) < processes:
        worker = start()
        workers.append(worker)
        if not _give(worker, waiting):
            worker.job = waiting.popleft()  # it died at its start, which counts as the job's


def _give(worker: _Worker, waiting: deque[Job]) -> bool:
    """Give a worker the next job; False if the worker has died."""
    try:
        worker.connection.send(waiting[0])
    except OSError:
        return False
    worker.job = waiting.popleft()
    return True


def _take(worker: _Worker) -> tuple[Job, Outcome | None]:
    """The job of a worker that has answered and its outcome; None if the worker died. The worker is free then."""
    ended, worker.job = worker.job, None
    assert ended is not None
    try:
        answer = worker.connection.recv()
    except (EOFError, OSError):
        return ended, None
    assert isinstance(answer, Outcome)
    return ended, answer


def _start(work: Work, scratch: Path) -> _Worker:
    context = get_context("spawn")  # forked, it would inherit threads' locks, and kernels being compiled
    folder = Path(tempfile.mkdtemp(prefix="worker-", dir=scratch))
    ours, theirs = context.Pipe()
    process = context.Process(target=serve, args=(theirs, work, str(folder)), daemon=True)
    with _quiet_and_single():
        process.start()
    theirs.close()
    return _Worker(process, ours, folder / "stderr.txt")


@contextmanager
def _quiet_and_single() -> Iterator[None]:
    """Processes that start in the block ignore Ctrl-C and SIGHUP, and their libraries use one thread.

    Signals during the block reach this process after it.
    """
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    held = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGHUP]) if sys.platform != "win32" else None
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if held is not None and sys.platform != "win32":
            signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _end(worker: _Worker) -> None:
    worker.connection.close()
    worker.process.kill()
    worker.process.join(_END_S)


def run_on_fleet(
    jobs: Sequence[Job],
    address: str,
    work: Work,
    *,
    connect_s: float = 10.0,
    on_note: Callable[[str], None] = lambda note: None,
) -> Generator[Outcome]:
    """Yield outcomes in the order of their ends. Unfinished jobs are cancelled after the iteration.

    The scheduler gives the job of a dead worker to another one, up to its `distributed.scheduler.allowed-failures` (3
    by default).

    Args:
        jobs: in this order; workers find recordings and files of settings at the same paths.
        address: of the scheduler, such as tcp://192.168.1.5:8786.
        work: called with each job.
        connect_s: timeout for the scheduler, seconds.
        on_note: called with remarks about the workers.

    Raises:
        ConfigError: the extra `fleet` is missing.
        DeviceError: no scheduler answers, or the connection is lost.
    """
    distributed = needed("distributed")
    try:
        connected = distributed.Client(address, timeout=connect_s, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        fix = "start one: dask scheduler; it prints its address"
        raise DeviceError(f"no scheduler answers at {address}", fix=fix) from error
    with connected as client:
        workers = client.scheduler_info(n_workers=-1)["workers"]
        if not workers:
            on_note("the scheduler has no worker yet; work begins when one comes: dask worker ADDRESS --nthreads 1")
        elif any(worker["nthreads"] > 1 for worker in workers.values()):
            on_note("workers run several jobs in one process: memory is theirs together (dask worker … --nthreads 1)")
        futures = {
            client.submit(work, job, key=f"wheelsight-{job.id}", pure=False, priority=-number): job
            for number, job in enumerate(jobs)
        }
        try:
            for future in distributed.as_completed(list(futures), loop=client.loop):
                yield _outcome(future, futures[future], distributed)
        finally:
            if client.status == "running":
                client.cancel([future for future in futures if not future.done()])


def _outcome(future: Any, job: Job, distributed: Any) -> Outcome:
    try:
        answer = future.result()
    except distributed.KilledWorker as killed:
        times = killed.allowed_failures + 1
        return Outcome(job.id, f"{times} workers died while they ran it", is_killed=True)
    except distributed.CancelledError as error:
        raise DeviceError("the scheduler went away", fix="start it again; what is done is kept") from error
    except Exception as error:  # the worker could not even begin: another wheelsight, or none
        return Outcome(job.id, problem_of(error))
    assert isinstance(answer, Outcome)
    return answer

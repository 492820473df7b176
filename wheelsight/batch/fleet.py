"""The same jobs on the workers of a Dask scheduler, on as many computers as they are."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any

from wheelsight.batch.jobs import Job
from wheelsight.batch.outcome import Outcome, problem_of
from wheelsight.batch.pool import Work
from wheelsight.errors import DeviceError
from wheelsight.extras import needed


def run_on_fleet(
    jobs: Sequence[Job],
    address: str,
    work: Work,
    *,
    connect_s: float = 10.0,
    on_note: Callable[[str], None] = lambda note: None,
) -> Generator[Outcome]:
    """Outcomes as they come; however the iteration ends, what is not done is taken back.

    A worker that dies takes nothing with it: the scheduler hands its job to another one, as often as its
    `distributed.scheduler.allowed-failures` says (3 unless set).

    Args:
        jobs: in this order; workers find recordings and files of settings at the same paths.
        address: of the scheduler, such as tcp://192.168.1.5:8786.
        work: what each worker does with a job.
        connect_s: how long the scheduler may take to answer, seconds.
        on_note: told what is odd about the workers.

    Raises:
        ConfigError: the extra `fleet` is missing.
        DeviceError: no scheduler answers, or it went away.
    """
    distributed = needed("distributed")
    with _client(distributed, address, connect_s) as client:
        _look_at(client.scheduler_info(n_workers=-1)["workers"], on_note)
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


def _client(distributed: Any, address: str, connect_s: float) -> Any:
    try:
        return distributed.Client(address, timeout=connect_s, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        fix = "start one: dask scheduler; its address is told then"
        raise DeviceError(f"no scheduler answers at {address}", fix=fix) from error


def _look_at(workers: dict[str, Any], on_note: Callable[[str], None]) -> None:
    if not workers:
        on_note("the scheduler has no worker yet; work begins when one comes: dask worker ADDRESS --nthreads 1")
    elif any(worker["nthreads"] > 1 for worker in workers.values()):
        on_note("workers run several jobs in one process: memory is theirs together (dask worker … --nthreads 1)")


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

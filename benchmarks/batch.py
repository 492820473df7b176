"""`python -m benchmarks.batch`: how much sooner a batch is done on two cores than on one.

A simulated drive of wheels and camera (320×240 at 10 Hz) is copied into as many recordings as are asked for, and a
batch runs all of them, wheels and camera joined: by one process that is held to one core, and by two that are held to
two. Starting processes and loading kernels counts; compiling them does not. "Processor" is the time that all processes
of the batch used together, which other work on the machine hardly changes; the time until all is done it does change.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from benchmarks import machine
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.app.run.kernels import compile_kernels, missing_parts, parts_of
from wheelsight.config import load_config
from wheelsight_batch import BatchPlan, plan_of, run_batch, run_job, run_on_processes
from wheelsight_sim import SimulationSettings, simulate, write_simulation

TIMES = 1.9
SETTINGS = "odometry: wheels,dense\n"
HEADER = "processes and cores", "jobs", "until done, s", "processor, s", "slowest job, s"


@dataclass(frozen=True, slots=True)
class Pass:
    """One batch: on how many cores, how many jobs ended well, and seconds."""

    cores: int
    jobs: int
    elapsed_s: float
    processor_s: float
    slowest_s: float

    @property
    def row(self) -> tuple[str, ...]:
        """As HEADER."""
        figures = (f"{self.elapsed_s:.1f}", f"{self.processor_s:.1f}", f"{self.slowest_s:.1f}")
        return (str(self.cores), str(self.jobs), *figures)


def write_recordings(folder: Path, count: int, seconds: float) -> list[Path]:
    """Copies of one drive, each with a file of its own number: equal ones would be one job."""
    first = folder / "00"
    settings = SimulationSettings("square", size=(320, 240), rate_hz=10, duration_s=seconds)
    write_simulation(simulate(settings), first)
    paths = [first, *(folder / f"{number:02d}" for number in range(1, count))]
    for path in paths[1:]:
        shutil.copytree(first, path)
    for number, path in enumerate(paths):
        (path / "number.txt").write_text(f"{number}\n")
    return paths


@contextmanager
def held_to(cores: int) -> Iterator[None]:
    """This process and those that it starts, on so many cores."""
    if not hasattr(os, "sched_setaffinity"):
        raise SystemExit("this system does not hold processes to cores")
    usual = os.sched_getaffinity(0)
    if len(usual) < cores:
        raise SystemExit(f"{cores} cores are needed, and there are {len(usual)}")
    os.sched_setaffinity(0, sorted(usual)[:cores])
    try:
        yield
    finally:
        os.sched_setaffinity(0, usual)


def run(plan: BatchPlan, cores: int, folder: Path) -> Pass:
    """A batch by as many processes as cores; raises SystemExit where a job breaks."""
    scratch, slowest = folder / "scratch", [0.0]
    scratch.mkdir(parents=True)
    before, began_s = _processor_s(), time.perf_counter()
    with held_to(cores):
        runner = partial(run_on_processes, processes=cores, work=run_job, scratch=scratch)
        rows = run_batch(
            plan,
            folder / "out",
            runner,
            lambda done: slowest.append(0.0 if done.outcome is None else done.outcome.elapsed_s),
        )
    elapsed_s = time.perf_counter() - began_s
    broken = [row.problem for row in rows if row.problem]
    if broken:
        raise SystemExit(broken[0])
    return Pass(cores, len(plan.jobs), elapsed_s, _processor_s() - before, max(slowest))


def _processor_s() -> float:
    """Of this process and of those it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def sheets_of(passes: Sequence[Pass]) -> list[Sheet]:
    """What was measured, and whether it is enough."""
    one, two = passes
    times = one.elapsed_s / two.elapsed_s
    target = Target("two cores, times as fast as one", TIMES, times, "times", 2, is_least=True)
    return [Sheet("Batches", HEADER, tuple(one.row for one in passes)), targets_sheet([target])]


def main(words: Sequence[str] | None = None) -> int:
    """Measure, print, write where asked to, and answer 0 where the target is met."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.batch", description=__doc__)
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each recording")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args(words)
    about, console = machine.description(), Console(width=120)
    about["Command"] = (
        f"`python -m benchmarks.batch --recordings {arguments.recordings} --seconds {arguments.seconds:g}`"
    )
    if machine.is_busy():
        console.print("the machine is busy: the time until all is done says little")
    compile_kernels(missing_parts(parts_of(load_config(overrides={"odometry": "wheels,dense"}))))
    with tempfile.TemporaryDirectory(prefix="wheelsight-") as folder:
        (Path(folder) / "joined.yaml").write_text(SETTINGS)
        paths = write_recordings(Path(folder) / "data", arguments.recordings, arguments.seconds)
        plan = plan_of(paths, [Path(folder) / "joined.yaml"], 1)
        passes = [run(plan, cores, Path(folder) / str(cores)) for cores in (1, 2)]
    sheets = sheets_of(passes)
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_page(arguments.out, "Many recordings", __doc__ or "", about, sheets)
    return 0 if passes[0].elapsed_s >= TIMES * passes[1].elapsed_s else 1


if __name__ == "__main__":
    sys.exit(main())

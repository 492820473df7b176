"""`python -m benchmarks.fuzz`: hostile files for every reader; none may end in a traceback, hang, or fill memory.

Each input is made by random numbers of its own (seed and number), and read in a process that is ended where it takes
longer than five seconds over one input, and begun anew where it has held a gigabyte more than at its beginning. Time in
which it had to wait for a processor does not count.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import shutil
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.fuzz_damage import damaged, replace_with_no_file
from benchmarks.fuzz_files import Target, controls, targets
from benchmarks.measure import peak_memory_mb
from wheelsight.errors import WheelsightError

LONGEST_S = 5.0
MOST_BYTES = 1 << 30
LONGEST_MESSAGE = 2000  # a screen of 25 lines of 80 columns
_LOOK_S = 0.2
_START_S, _MAKING_S = 120.0, 30.0
_NO_FILE_SHARE = 0.05
_ROOM = 6
_BEGIN_ANEW = 75


@dataclass(frozen=True, slots=True)
class Fault:
    """An input that was not answered as it must be.

    Attributes:
        number: of the input; with the seed it makes the input again.
        reader: that read it.
        kind: traceback, hang, memory or message.
        told: the last line of the traceback, or what it took.
    """

    number: int
    reader: str
    kind: str
    told: str


@dataclass
class Outcome:
    """What came of some inputs.

    Attributes:
        read, refused: how many were taken, and refused by an error of wheelsight's.
        faults: what must not be.
        slowest_s: the longest over one input.
        on_fault: told of each fault as it is found.
    """

    read: int = 0
    refused: int = 0
    faults: list[Fault] = field(default_factory=list)
    slowest_s: float = 0.0
    on_fault: Callable[[Fault], None] = lambda fault: None

    def add_fault(self, fault: Fault) -> None:
        """Keep a fault, and tell of it."""
        self.faults.append(fault)
        self.on_fault(fault)

    @property
    def count(self) -> int:
        """Of all inputs."""
        return self.read + self.refused + len(self.faults)


def fuzz(
    count: int,
    seed: int = 0,
    begin: int = 0,
    within_s: float = float("inf"),
    reader: str = "",
    *,
    are_controls: bool = False,
    on_fault: Callable[[Fault], None] = lambda fault: None,
) -> Outcome:
    """Read `count` hostile inputs, or as many as `within_s` seconds allow.

    Args:
        count: how many.
        seed: of all random numbers.
        begin: the first one's number.
        within_s: no input is begun later.
        reader: a part of the names of the only readers to try, or "" for all.
        are_controls: whether `fuzz_files.controls` are tried in place of the readers, to see that each is found.
        on_fault: told of each fault as it is found.
    """
    outcome, number, end = Outcome(on_fault=on_fault), begin, begin + count
    deadline = time.monotonic() + within_s
    while number < end and time.monotonic() < deadline:
        number = _watch(outcome, number, end, deadline, (seed, reader, are_controls))
    return outcome


def _watch(outcome: Outcome, number: int, end: int, deadline: float, chosen: tuple[int, str, bool]) -> int:
    """Let a process read inputs until it ends or must be ended; the number of the next input."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(there, number, end, deadline - time.monotonic(), *chosen))
    process.start()
    there.close()
    begun, current = _own_s(process.pid) + _START_S, ""
    while True:
        if here.poll(_LOOK_S):
            try:
                told = here.recv()
            except EOFError:
                break
            if told[0] == "begin":
                _, number, current = told
                begun = _own_s(process.pid)
            else:
                number += 1
                begun = _own_s(process.pid) + _MAKING_S
                _count(outcome, told)
        elif _own_s(process.pid) - begun > LONGEST_S:
            outcome.add_fault(Fault(number, current, "hang", f"over {LONGEST_S:g} s"))
            process.kill()
            process.join()
            return number + 1
    process.join()
    if process.exitcode in (0, _BEGIN_ANEW):
        return end if process.exitcode == 0 else number
    outcome.add_fault(Fault(number, current, "traceback", f"the process ended with {process.exitcode}"))
    return number + 1


def _own_s(pid: int | None) -> float:
    """The time, in seconds, without what a process was ready to run and had to wait: a busy computer is no hang."""
    waited_ns = 0
    with suppress(OSError, IndexError):  # kernels without it: all time counts
        waited_ns = int(Path(f"/proc/{pid}/schedstat").read_text().split()[1])
    return time.monotonic() - 1e-9 * waited_ns


def _count(outcome: Outcome, told: tuple[Any, ...]) -> None:
    _, is_read, fault, took_s = told
    outcome.slowest_s = max(outcome.slowest_s, took_s)
    if fault is not None:
        outcome.add_fault(fault)
    elif is_read:
        outcome.read += 1
    else:
        outcome.refused += 1


def _work(pipe: Connection, begin: int, end: int, within_s: float, seed: int, reader: str, are_controls: bool) -> None:
    """The process that reads: inputs one after the other, telling what came of each."""
    warnings.simplefilter("error")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # what libpng and libjpeg say of damaged images
    deadline = time.monotonic() + within_s
    chosen = [target for target in (controls() if are_controls else targets()) if reader in target.name]
    for target in [] if are_controls else chosen:
        with TemporaryDirectory() as folder:  # whatever is loaded or compiled at first is no input's doing
            write_sound(target, Path(folder))
            target.read(Path(folder))
    held = peak_memory_mb()
    # Who asks for far more than there is must be stopped; who uses more than may be is seen afterwards.
    limit = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") + _ROOM * MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with TemporaryDirectory() as folder:
        for number in range(begin, end):
            if time.monotonic() > deadline:
                break
            target = chosen[number % len(chosen)]
            place = Path(folder) / str(number)
            make_input(target, place, seed, number)
            pipe.send(("begin", number, target.name))
            before_s = time.perf_counter()
            is_read, fault = _try(target, place, number)
            used = 1e6 * (peak_memory_mb() - held)
            if used > MOST_BYTES and fault is None:
                fault = Fault(number, target.name, "memory", f"{used / MOST_BYTES:.1f} GB")
            pipe.send(("end", is_read, fault, time.perf_counter() - before_s))
            shutil.rmtree(place)
            if used > MOST_BYTES:
                sys.exit(_BEGIN_ANEW)  # the most that was held cannot be set back
    pipe.close()


def make_input(target: Target, place: Path, seed: int, number: int) -> None:
    """Write a reader's sound files into a new folder, one or two of them changed."""
    rng = np.random.default_rng([seed, number])
    write_sound(target, place)
    names = sorted(target.files)
    for name in rng.choice(names, min(int(rng.integers(1, 3)), len(names)), replace=False).tolist():
        if rng.random() < _NO_FILE_SHARE:
            replace_with_no_file(place / name, rng)
        else:
            (place / name).write_bytes(damaged(name, target.files[name], rng))


def write_sound(target: Target, place: Path) -> None:
    """Write a reader's sound files into a folder."""
    for name, data in target.files.items():
        path = place / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def _try(target: Target, place: Path, number: int) -> tuple[bool, Fault | None]:
    """Whether an input was read, and what was wrong with the answer."""
    try:
        target.read(place)
    except WheelsightError as error:
        message = str(error)
        if len(message) > LONGEST_MESSAGE or not message.isprintable():
            return False, Fault(number, target.name, "message", f"{len(message)} characters: {message[:200]!r}")
        if "MemoryError" in message:
            return False, Fault(number, target.name, "memory", message[-200:])
        return False, None
    except MemoryError:
        return False, Fault(number, target.name, "memory", traceback.format_exc(limit=-3)[-900:])
    except BaseException:
        return False, Fault(number, target.name, "traceback", traceback.format_exc(limit=-6)[-1500:])
    return True, None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print what came of it, and answer 1 where there is a fault."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20_000, help="how many inputs (20000)")
    parser.add_argument("--seed", type=int, default=0, help="of all random numbers (0)")
    parser.add_argument("--begin", type=int, default=0, help="number of the first input (0)")
    parser.add_argument("--within", type=float, default=float("inf"), help="seconds after which none is begun")
    parser.add_argument("--reader", default="", help="only readers whose name holds this")
    given = parser.parse_args(arguments)
    console = Console(markup=False, highlight=False, soft_wrap=True)
    outcome = fuzz(
        given.count,
        given.seed,
        given.begin,
        given.within,
        given.reader,
        on_fault=lambda fault: console.print(f"{fault.kind} {fault.number} {fault.reader}: {fault.told}"),
    )
    kinds = Counter(fault.kind for fault in outcome.faults)
    faults = ", ".join(f"{kinds[kind]} {kind}" for kind in ("traceback", "hang", "memory", "message"))
    told = f"{outcome.count} inputs: {outcome.read} read, {outcome.refused} refused; {faults}"
    console.print(f"{told}; slowest {outcome.slowest_s:.2f} s")
    return 1 if outcome.faults else 0


if __name__ == "__main__":
    sys.exit(main())

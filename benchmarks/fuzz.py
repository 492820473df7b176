"""`python -m benchmarks.fuzz`: damaged and hostile files for every reader of `benchmarks.fuzz_files`.

No input may end in a traceback, end the process, or take more than five seconds, a gigabyte of memory or one of disk.
A reader accepts an input or refuses it by one of wheelsight's own errors, in a message that fits on a screen.

Each input follows from the seed, the reader's name and the input's number. A process of its own reads them one after
the other. It is killed where one input takes too long, and started again after that or a crash. Time for which it
waits for a processor does not count. Inputs that were answered wrongly stay in --keep; --replay reads one again.
"""

from __future__ import annotations

import argparse
import faulthandler
import gc
import multiprocessing
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from benchmarks.fuzz_damage import changed_files, damaged, replace_with_no_file
from benchmarks.fuzz_files import Target, controls, targets
from wheelsight.core.errors import WheelsightError

LONGEST_S = 5.0
MOST_BYTES = 1 << 30
LONGEST_MESSAGE = 2000  # a screen of 25 lines of 80 columns
KINDS = ("traceback", "crash", "time", "memory", "disk", "message")
_LOOK_S = 0.05
# A worker loads a reader's libraries, compiles its kernels and writes its sound files before the first input; a bomb is
# packed while an input is made.
_START_S, _MAKING_S = 180.0, 60.0
_NO_FILE_SHARE, _OTHER_FILES_SHARE = 0.05, 0.1
# Who asks for far more memory than there is must be stopped before others are; who uses too much is seen afterwards.
_ROOM = 6
# Memory that inputs leave behind, caches mostly, after which a worker is started again.
_MOST_LEFT_BYTES = 1 << 29
_STARTS_AGAIN = 75
# Inputs of a reader before those of the next: a worker that is started again loads what few readers need.
_BLOCK = 500


class Cost(NamedTuple):
    """What one input took: seconds, and bytes of memory and disk at most."""

    seconds: float = 0.0
    memory: int = 0
    disk: int = 0


@dataclass(frozen=True, slots=True)
class Fault:
    """An input that was not answered as it must be.

    Attributes:
        reader: that read it.
        number: of the input; with the seed it makes the input again.
        kind: of `KINDS`.
        what: the end of the traceback, or what the input took.
        kept: the folder in which the input is, or None.
    """

    reader: str
    number: int
    kind: str
    what: str
    kept: Path | None = None

    @property
    def group(self) -> tuple[str, str, str]:
        """Alike for inputs that fail at one place: the reader, the kind, and the last frame of the traceback."""
        frames = [line.strip() for line in self.what.splitlines() if line.lstrip().startswith("File ")]
        last = self.what.strip().splitlines()[-1:] if self.kind == "traceback" else []
        error = last[0].partition(":")[0] if last else ""
        return self.reader, self.kind, f"{frames[-1] if frames else ''} {error}".strip()


@dataclass
class Tally:
    """What became of a reader's inputs.

    Attributes:
        accepted, refused: how many were read, and how many were refused by an error of wheelsight's own.
        faults: all other inputs.
        worst: the most that one input took of each.
    """

    accepted: int = 0
    refused: int = 0
    faults: list[Fault] = field(default_factory=list)
    worst: Cost = field(default_factory=Cost)

    @property
    def count(self) -> int:
        """Of all inputs."""
        return self.accepted + self.refused + len(self.faults)

    def add(self, is_accepted: bool, fault: Fault | None, cost: Cost) -> None:
        """Count an input."""
        worst = self.worst
        self.worst = Cost(max(worst.seconds, cost.seconds), max(worst.memory, cost.memory), max(worst.disk, cost.disk))
        if fault is not None:
            self.faults.append(fault)
        elif is_accepted:
            self.accepted += 1
        else:
            self.refused += 1


@dataclass(frozen=True, slots=True)
class Plan:
    """Which inputs are read: some of each reader, then some more.

    Attributes:
        readers: their names.
        inputs: how many a reader.
        seed: of all random numbers.
        begin: number of the first input.
        within_s: no input is started later than that.
        are_controls: whether `readers` are of `fuzz_files.controls`.
        replayed: a folder that is read as it is, in place of inputs that are made.
        keep: the folder for inputs that were answered wrongly, or None.
    """

    readers: tuple[str, ...]
    inputs: int = 1
    seed: int = 0
    begin: int = 0
    within_s: float = float("inf")
    are_controls: bool = False
    replayed: Path | None = None
    keep: Path | None = None

    @property
    def count(self) -> int:
        """Of inputs."""
        return self.inputs * len(self.readers)

    def at(self, job: int) -> tuple[str, int]:
        """Reader and number of an input."""
        block, rest = divmod(job, _BLOCK * len(self.readers))
        length = min(_BLOCK, self.inputs - block * _BLOCK)
        return self.readers[rest // length], self.begin + block * _BLOCK + rest % length


def fuzz(plan: Plan, on_input: Callable[[str, Tally, Fault | None], None] = lambda *_: None) -> dict[str, Tally]:
    """What became of the inputs of each reader; `on_input` is called with reader, tally and fault after each."""
    tallies = {reader: Tally() for reader in plan.readers}
    deadline = time.monotonic() + plan.within_s
    with tempfile.TemporaryDirectory(prefix="wheelsight-fuzz-") as folder:
        watch = _Watch(plan, Path(folder), tallies, on_input)
        while watch.job < plan.count and time.monotonic() < deadline:
            watch.run_worker(deadline)
    return tallies


class _Watch:
    """Lets workers read inputs, one worker at a time, and counts what becomes of them."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        tallies: dict[str, Tally],
        on_input: Callable[[str, Tally, Fault | None], None],
    ) -> None:
        self.job = 0
        self._plan, self._folder, self._tallies, self._on_input = plan, folder, tallies, on_input
        self._disk = 0

    def run_worker(self, deadline: float) -> None:
        """Start a worker and follow it until it ends or must be ended."""
        for name in ("inputs", "scratch"):
            shutil.rmtree(self._folder / name, ignore_errors=True)
            (self._folder / name).mkdir()
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(there, self._plan, self._folder, self.job, deadline))
        process.start()
        there.close()
        try:
            self._follow(here, process)
        finally:
            _end_group(process)

    def _follow(self, here: Connection, process: Any) -> None:
        clock = _OwnClock(process.pid)
        until_s, is_reading = clock.now_s() + _START_S, False
        while True:
            if here.poll(_LOOK_S):
                try:
                    message = here.recv()
                except EOFError:
                    break
                now_s, is_reading = clock.now_s(), message[0] == "begin"
                self._take(message, now_s - until_s + LONGEST_S)
                until_s = now_s + _allowed_s(message[0])
            elif clock.now_s() > until_s:
                if not is_reading:
                    raise RuntimeError(f"a worker could not make its next input in time: {self._next}")
                self._count(False, ("time", f"over {LONGEST_S:g} s"), Cost(LONGEST_S, 0, self._disk))
                return
            elif is_reading:
                self._disk = max(self._disk, _bytes_in(self._folder / "scratch"))
        process.join()
        if is_reading:
            self._count(False, ("crash", f"exit code {process.exitcode}\n{self._last_words()}"), Cost())
        elif process.exitcode not in (0, _STARTS_AGAIN):
            raise RuntimeError(f"a worker ended before {self._next}\n{self._last_words()}")

    def _take(self, message: tuple[Any, ...], took_s: float) -> None:
        if message[0] == "begin":
            self._disk = 0
        elif message[0] == "end":
            is_accepted, fault, cost = message[1:]
            # The worker does not see for how long its own processes waited, and looked here is only now and again.
            self._count(is_accepted, fault, cost._replace(seconds=min(cost.seconds, took_s)))

    def _count(self, is_accepted: bool, fault: tuple[str, str] | None, cost: Cost) -> None:
        reader, number = self._plan.at(self.job)
        cost = cost._replace(disk=max(cost.disk, self._disk))
        if fault is None and cost.disk > MOST_BYTES:
            fault = "disk", f"{cost.disk / MOST_BYTES:.1f} GB"
        found = None if fault is None else Fault(reader, number, *fault, self._kept(reader, number))
        shutil.rmtree(self._folder / "inputs" / str(self.job), ignore_errors=True)
        self._tallies[reader].add(is_accepted, found, cost)
        self._on_input(reader, self._tallies[reader], found)
        self.job += 1

    @property
    def _next(self) -> tuple[str, int]:
        return self._plan.at(self.job)

    def _kept(self, reader: str, number: int) -> Path | None:
        """Where an input that was answered wrongly is from now on."""
        if self._plan.keep is None or self._plan.replayed is not None:
            return self._plan.replayed
        place, kept = self._folder / "inputs" / str(self.job), self._plan.keep / reader / f"{self._plan.seed}-{number}"
        if not place.exists():
            return None
        shutil.rmtree(kept, ignore_errors=True)
        kept.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(place, kept)
        return kept

    def _last_words(self) -> str:
        """What faulthandler wrote about a crash, and the end of what the worker printed."""
        words = ""
        for name, part in (("crash.txt", slice(0, 1500)), ("printed.txt", slice(-1500, None))):
            with suppress(OSError):
                words += (self._folder / name).read_text(errors="replace")[part]
        return words


def _allowed_s(what: str) -> float:
    """Until the next message, after one of this kind."""
    return {"ready": _START_S, "begin": LONGEST_S, "end": _MAKING_S}[what]


def _end_group(process: Any) -> None:
    """End a worker with all processes that its readers started."""
    with suppress(ProcessLookupError, PermissionError):
        if os.getpgid(process.pid) == process.pid:
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()


class _OwnClock:
    """Time without that for which a process, with its threads and children, had to wait for a processor.

    From look to look the longest wait of any thread counts, since the others may wait for it: a busy computer is no
    hang, and threads that wait for each other are one.
    """

    def __init__(self, pid: int | None) -> None:
        self._pid, self._waited_ns, self._last_ns = pid, 0, dict[Path, int]()

    def now_s(self) -> float:
        """Seconds."""
        with suppress(OSError, IndexError):  # kernels without these files: all time counts
            children = Path(f"/proc/{self._pid}/task/{self._pid}/children").read_text().split()
            threads = [thread for pid in (self._pid, *children) for thread in Path(f"/proc/{pid}/task").iterdir()]
            waits_ns = [self._waited(thread) for thread in threads]
            self._waited_ns += max(waits_ns, default=0)
        return time.monotonic() - 1e-9 * self._waited_ns

    def _waited(self, thread: Path) -> int:
        """For how long, in nanoseconds, since the last look."""
        waited_ns = 0
        with suppress(OSError, IndexError):  # it has ended
            waited_ns = int((thread / "schedstat").read_text().split()[1])
        before_ns, self._last_ns[thread] = self._last_ns.get(thread, 0), waited_ns
        return max(waited_ns - before_ns, 0)


def _bytes_in(folder: Path) -> int:
    """What the files below a folder take on the disk."""
    total = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += 512 * os.lstat(f"{root}/{name}").st_blocks
    return total


def _work(pipe: Connection, plan: Plan, folder: Path, job: int, deadline: float) -> None:
    """The worker: reads inputs one after the other, and sends what became of each."""
    os.setsid()
    warnings.simplefilter("error")
    faulthandler.enable((folder / "crash.txt").open("w"))  # stays open as long as the worker lives
    for stream in (1, 2):  # what libpng and FFmpeg print about damaged files
        os.dup2(os.open(folder / "printed.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
    tempfile.tempdir = os.environ["TMPDIR"] = str(folder / "scratch")
    known = {target.name: target for target in (controls() if plan.are_controls else targets())}
    ready: set[str] = set()
    least = _resident_bytes()
    for one in range(job, plan.count):
        reader, number = plan.at(one)
        if time.monotonic() > deadline:
            return
        if reader not in ready:
            pipe.send(("ready",))
            known[reader] = _kept_files(known[reader], folder / f"{reader}.pickle")
            _warm_up(known[reader], folder / "sound", plan)
            ready.add(reader)
            gc.collect()
            gc.freeze()  # what stays need not be looked at after each input
            least = max(least, _resident_bytes())
        target = known[reader]
        place = plan.replayed or folder / "inputs" / str(one)
        if plan.replayed is None:
            make_input(target, place, plan.seed, number)
        gc.collect()
        pipe.send(("begin",))
        pipe.send(("end", *_measured(target, place, folder / "scratch")))
        if _resident_bytes() - least > _MOST_LEFT_BYTES:
            sys.exit(_STARTS_AGAIN)
    pipe.close()


def _kept_files(target: Target, kept: Path) -> Target:
    """The target with the sound files of the first worker: some take seconds to make, and never come out the same."""
    if not kept.exists():
        kept.write_bytes(pickle.dumps(dict(target.files())))
    files = pickle.loads(kept.read_bytes())
    return replace(target, make=lambda: files)


def _warm_up(target: Target, place: Path, plan: Plan) -> None:
    """Read a target's sound files: what is loaded, compiled or cached then is not counted for any input."""
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    if not plan.are_controls:
        write_sound(target, place)
        target.read(place)
        shutil.rmtree(place)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") + _ROOM * MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (size, resource.RLIM_INFINITY))


def _measured(target: Target, place: Path, scratch: Path) -> tuple[bool, tuple[str, str] | None, Cost]:
    """Whether an input was accepted, what was wrong with the answer, and what it took."""
    written = _bytes_in(place)
    Path("/proc/self/clear_refs").write_text("5")  # sets the peak back to what is held now
    clock = _OwnClock(os.getpid())
    held, of_others, began_s = _resident_bytes(), _peak_of_children(), clock.now_s()
    resource.setrlimit(resource.RLIMIT_FSIZE, (2 * MOST_BYTES, resource.RLIM_INFINITY))
    is_accepted, fault = answer(target, place)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    took_s = clock.now_s() - began_s
    peak, others = _status_bytes("VmHWM"), _peak_of_children()
    memory = max(peak - held, others if others > of_others else 0)
    cost = Cost(took_s, memory, _bytes_in(scratch) + max(_bytes_in(place) - written, 0))
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(exist_ok=True)
    if fault is None and memory > MOST_BYTES:
        fault = "memory", f"{memory / MOST_BYTES:.1f} GB"
    return is_accepted, fault, cost


def _resident_bytes() -> int:
    return _status_bytes("VmRSS")


def _status_bytes(name: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return int(line.split()[1]) << 10
    return 0


def _peak_of_children() -> int:
    """The most that any ended process of this one's held."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss << 10


def make_input(target: Target, place: Path, seed: int, number: int) -> None:
    """Write a reader's sound files into a new folder, some of them changed."""
    rng = np.random.default_rng([seed, zlib.crc32(target.name.encode()), number])
    files = dict(target.files())
    names = sorted(files)
    for name in rng.choice(names, min(int(rng.integers(1, 3)), len(names)), replace=False).tolist():
        files[name] = damaged(name, files[name], rng)
    if rng.random() < _OTHER_FILES_SHARE:
        files = changed_files(files, rng)
    _write(files, place)
    there = [name for name in names if name in files]
    if there and rng.random() < _NO_FILE_SHARE:
        replace_with_no_file(place / there[int(rng.integers(len(there)))], rng)


def write_sound(target: Target, place: Path) -> None:
    """Write a reader's sound files into a folder."""
    _write(target.files(), place)


def _write(files: Any, place: Path) -> None:
    place.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        path = Path(os.fsdecode(os.path.join(os.fsencode(place), os.fsencode(name))))  # noqa: PTH118 (names of bytes)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def answer(target: Target, place: Path) -> tuple[bool, tuple[str, str] | None]:
    """Whether an input was accepted, and what was wrong with the answer."""
    try:
        target.read(place)
    except WheelsightError as error:
        message = str(error)
        if len(message) > LONGEST_MESSAGE or not message.isprintable():
            return False, ("message", f"{len(message)} characters: {message[:200]!r}")
        if "MemoryError" in message:
            return False, ("memory", f"over {_ROOM} GB: {message[-200:]}")
        if "File too large" in message:
            return False, ("disk", message[-200:])
        return False, None
    except MemoryError:
        return False, ("memory", f"over {_ROOM} GB\n{traceback.format_exc(limit=-4)[-1200:]}")
    except BaseException:
        return False, ("traceback", traceback.format_exc(limit=-6)[-1800:])
    return True, None


def faults_in(tallies: dict[str, Tally]) -> list[Fault]:
    """All of them, one of each place first."""
    every = [fault for tally in tallies.values() for fault in tally.faults]
    first = {fault.group: fault for fault in reversed(every)}
    return [*first.values(), *(fault for fault in every if first[fault.group] is not fault)]


def markdown(tallies: dict[str, Tally]) -> Iterable[str]:
    """The table for docs/bad-input.md, line by line."""
    yield "| reader | inputs | accepted | refused | tracebacks, crashes | over 5 s, 1 GB, a screen | worst |"
    yield "|---|---:|---:|---:|---:|---:|---|"
    for reader, tally in tallies.items():
        kinds = [fault.kind for fault in tally.faults]
        broken = sum(kinds.count(kind) for kind in KINDS[:2])
        worst = (
            f"{tally.worst.seconds:.2f} s, {tally.worst.memory / 1e6:.0f} MB, {tally.worst.disk / 1e6:.0f} MB of disk"
        )
        counts = " | ".join(_spaced(count) for count in (tally.count, tally.accepted, tally.refused))
        yield f"| `{reader}` | {counts} | {broken} | {len(kinds) - broken} | {worst} |"


def _spaced(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def chosen_readers(words: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Readers whose name is one of some words, or begins with one that ends in `*`; all where there are no words."""
    wanted = [word for given in words for word in given.split(",")]
    if not wanted:
        return tuple(known)
    unknown = [word for word in wanted if not any(_fits(name, word) for name in known)]
    if unknown:
        raise SystemExit(f"no reader {', '.join(unknown)}; known are {', '.join(known)}")
    return tuple(name for name in known if any(_fits(name, word) for word in wanted))


def _fits(name: str, word: str) -> bool:
    return name.startswith(word[:-1]) if word.endswith("*") else name == word


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, print what became of the inputs, and return 1 where there is a fault."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1000, help="how many a reader (1000)")
    parser.add_argument("--seed", type=int, default=0, help="of all random numbers (0)")
    parser.add_argument("--begin", type=int, default=0, help="number of the first input (0)")
    parser.add_argument("--within", type=float, default=float("inf"), help="seconds after which none is started")
    parser.add_argument("--readers", nargs="*", default=[], help="names, or beginnings as in rosbag*; else all")
    parser.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="for inputs that fail (out/fuzz)")
    parser.add_argument("--replay", type=Path, help="read a folder of --keep again, and print the traceback")
    given = parser.parse_args(arguments)
    console = Console(markup=False, highlight=False, soft_wrap=True)
    names = [target.name for target in targets()]
    if given.replay is not None:
        readers = chosen_readers(given.readers or [given.replay.absolute().parent.name], names)
        plan = Plan(readers, replayed=given.replay.absolute())
    else:
        readers = chosen_readers(given.readers, names)
        plan = Plan(readers, given.inputs, given.seed, given.begin, given.within, keep=given.keep.absolute())
    tallies = fuzz(plan, _printed(console, plan))
    for line in markdown(tallies):
        console.print(line)
    faults = faults_in(tallies)
    groups = len({fault.group for fault in faults})
    console.print(f"{sum(tally.count for tally in tallies.values())} inputs, {len(faults)} faults at {groups} places")
    return 1 if faults else 0


def _printed(console: Console, plan: Plan) -> Callable[[str, Tally, Fault | None], None]:
    """Prints the first fault of each place in full, others in a line, and how far it is every thousand inputs."""
    seen: set[tuple[str, str, str]] = set()
    done = 0

    def on_input(reader: str, tally: Tally, fault: Fault | None) -> None:
        nonlocal done
        done += 1
        if fault is not None:
            console.print(f"{fault.kind} {reader} {fault.number}: {fault.kept or ''}")
            if fault.group not in seen:
                console.print(fault.what)
            seen.add(fault.group)
        elif done % 1000 == 0:
            console.print(f"{done} of {plan.count} inputs")
        if plan.replayed is not None:
            console.print(f"{'accepted' if tally.accepted else 'refused' if tally.refused else 'fault'}: {tally.worst}")

    return on_input


if __name__ == "__main__":
    sys.exit(main())

"""`python -m benchmarks`: measure contenders on all recordings, and the parts; judge, print, and keep."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence as Many
from pathlib import Path

from rich.console import Console

from benchmarks import contenders, dense, machine, parts
from benchmarks.dense import judge_dense
from benchmarks.mapping import judge_whole
from benchmarks.parts import Judged, Part, Scope
from benchmarks.published import judge_published
from benchmarks.run import Result, run
from benchmarks.sequences import Sequence, default_data_folder, find_sequences
from benchmarks.table import document, problems_of, results_sheets, shown, targets_sheet
from benchmarks.targets import Target, judge
from wheelsight.core.errors import WheelsightError
from wheelsight.core.files import write_text

# Where the output is piped, as wide as the tables need.
_CONSOLE = Console(width=None if sys.stdout.isatty() else 140)


def main(words: Many[str] | None = None) -> int:
    """The exit code: 0 when all were measured (targets met or not), 1 when one failed, 2 for bad input."""
    arguments = _parse(words)
    try:
        return _benchmark(arguments)
    except WheelsightError as error:
        print(error, file=sys.stderr)
        return 2


def _benchmark(arguments: argparse.Namespace) -> int:
    about = machine.description()
    if machine.is_busy():
        _CONSOLE.print(f"The machine is busy ({about['Load']}): times will be too long.", style="yellow")
    sequences = find_sequences(arguments.data) if arguments.chosen else []
    results = _measure_all(arguments.chosen, sequences, arguments.frames)
    measured = _measure_parts(arguments.parts, Scope(arguments.data, arguments.frames))
    targets = [*_judge(results), *(target for judged in measured for target in judged.targets)]
    sheets = (targets_sheet(targets), *results_sheets(results), *(sheet for j in measured for sheet in j.sheets))
    for sheet in sheets:
        _CONSOLE.print(sheet.to_rich())
    problems = [*problems_of(results), *(problem for judged in measured for problem in judged.problems)]
    for problem in problems:
        _CONSOLE.print(problem, style="red", markup=False)
    if arguments.out is not None:
        of_parts = (contender for part in arguments.parts for contender in part.contenders)
        taking_part = tuple(dict.fromkeys([*arguments.chosen, *of_parts]))
        write_text(arguments.out, document(sheets, about, _command(arguments), taking_part, problems))
    return 1 if problems else 0


def _judge(results: Many[Result]) -> list[Target]:
    """Feature odometry, dense tracking and surfels; of the latter two only what took part."""
    names = {result.contender.name for result in results}
    targets = judge(results)
    targets += judge_dense(results) if dense.SUBJECT.name in names else []
    return [*targets, *judge_whole(results), *judge_published(results)]


def _measure_all(chosen: Many[contenders.Contender], sequences: Many[Sequence], limit: int | None) -> list[Result]:
    results = []
    for sequence in sequences:
        for contender in chosen:
            if contender.registers and sequence.is_registered:
                continue
            _CONSOLE.print(f"{sequence.name}: {contender.name} …", style="dim")
            results.append(run(contender, sequence, limit))
    return results


def _measure_parts(chosen: Many[Part], scope: Scope) -> list[Judged]:
    measured = []
    for part in chosen:
        _CONSOLE.print(f"{part.name} …", style="dim")
        measured.append(part.measure(scope))
    return measured


def _parse(words: Many[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--frames", type=int, help="only the first so many frames of each recording")
    parser.add_argument(
        "--only",
        action="append",
        metavar="NAME",
        help=f"contenders whose name holds NAME, or one of {', '.join(p.name for p in parts.ALL)}; repeatable",
    )
    parser.add_argument("--out", type=Path, help="keep the tables in this file, e.g. docs/benchmarks/peers.md")
    arguments = parser.parse_args(words)
    wanted = {name.lower() for name in arguments.only or ["", *(part.name for part in parts.ALL)]}
    arguments.parts = [part for part in parts.ALL if part.name in wanted]
    others = wanted - {part.name for part in parts.ALL}  # `wheels` would else be wheelsight's contenders too
    arguments.chosen = [c for c in contenders.ALL if any(name in c.name.lower() for name in others)]
    if not arguments.chosen and not arguments.parts:
        there = ", ".join([*(contender.name for contender in contenders.ALL), *(part.name for part in parts.ALL)])
        parser.error(f"--only: no such contender or part; there are {there}")
    if arguments.frames is not None and arguments.frames < 1:
        parser.error("--frames: must be at least 1")
    if arguments.out is not None and not arguments.out.parent.is_dir():
        parser.error(f"--out: the folder {arguments.out.parent} does not exist")
    return arguments


def _command(arguments: argparse.Namespace) -> str:
    """The command that repeats this run, without this machine's paths."""
    words = ["python -m benchmarks"]
    words += [f"--frames {arguments.frames}"] if arguments.frames is not None else []
    words += [f'--only "{name}"' for name in arguments.only or []]
    return " ".join([*words, f"--out {shown(arguments.out)}"])


if __name__ == "__main__":
    sys.exit(main())

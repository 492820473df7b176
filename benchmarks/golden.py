"""`python -m benchmarks.golden`: whether results are the same, byte for byte, as before a restructuring.

`--write` keeps the results of this tree in `golden.json`: a SHA-256 hash of each table of numbers, and a few figures to
read. Without it they are made again and compared; a difference is exit code 1. `--keep FOLDER` keeps the tables
themselves, so that a difference is named by its first row. `--quick` takes a short part of everything.

Results are those of four simulated drives, the real recordings, a session of two days, a drive to a goal and an
exploration. They are made as a user makes them, by names of `wheelsight.__all__` and by the command line.

The results do not depend on the computer's load: a recording is played as fast as it can be, a simulated robot goes by
simulated time, and both wait for the threads that close loops and make plans. These are left out, because they differ
between two runs of the same code:

- times, memory, folders, and the date of a result;
- the journal of a map's graph: the writer adds poses to it once a second by the wall clock.

Sentences are left out as well, so that a text can be improved; a reason counts by its place in the order of appearance.

Sums of floats depend on how many threads share them: libraries have one thread here. OpenCV runs without IPP, whose
exact distance transform gives one of two results by where memory lies, in about equal shares: on one thread, and for
small images on any. A controller turns that difference of one unit in the last place into another drive. The processor
and the versions of libraries matter too, and `golden.json` names them.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import llvmlite.binding
import numpy as np
from rich.console import Console
from rich.table import Table

from wheelsight import Trajectory, WheelsightError, load_config, load_map, open_recording, run_each, write_ply

GOLDEN = Path(__file__).with_name("golden.json")
FAMILIES = ("drives", "recordings", "session", "goal", "exploration")
# One thread in each library that would choose by the computer, and no IPP; read when the library is loaded.
LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
STEADY = {**dict.fromkeys(LIBRARIES, "1"), "OPENCV_IPP": "disabled", "OPENCV_LOG_LEVEL": "ERROR"}
DRIVES = {
    "flat": ("flat", "--realism", "ideal", "--gyro", "--seed", "1"),
    "real": ("floor4", "--realism", "real", "--seed", "2"),
    "people": ("studio", "--realism", "ideal", "--passers-by", "3", "--seed", "3"),
    "faults": ("flat", "--realism", "real", "--reverse", "--lift", "3:5", "--cover", "6:8", "--seed", "4"),
}
RECORDINGS = ("freiburg1_rpy_part", "openloris_sample", "red_kitchen", "rgbd_dataset_freiburg1_desk")
MAPPED = {"map": "surfels", "loops.source": "keyframes"}
# What depends on the computer and its load, on the folder, or on the journal of the graph.
NOT_KEPT = {"timing", "seconds", "bytes", "peak_memory_mb", "path", "versions", "realtime", "late"}
_WORD = re.compile(r"[A-Za-z_-]+")
_SURFELS_A_ROW = 1000


@dataclass(frozen=True)
class Length:
    """How much is taken.

    Attributes:
        name: in `golden.json`.
        drive_s: of each simulated drive, at 10 frames a second.
        recording_s: of each real recording, at 30 frames a second; None: all of it.
        room: rows and columns of the plan that is explored, cells of 5 cm.
    """

    name: str
    drive_s: float
    recording_s: float | None
    room: tuple[int, int]


FULL, QUICK = Length("full", 30.0, None, (60, 80)), Length("quick", 9.0, 1.5, (46, 52))


@dataclass(frozen=True)
class Result:
    """Figures to read, and tables of rows, each of text that gives every float exactly."""

    figures: dict[str, Any]
    tables: dict[str, list[str]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """For `golden.json`."""
        hashes = {name: hash_of("\n".join(rows).encode()) for name, rows in self.tables.items()}
        return {"figures": self.figures, "sha256": hashes}


def hash_of(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def made_with() -> dict[str, str]:
    """What results depend on beside the package."""
    libraries = ("numpy", "scipy", "numba", "opencv-python-headless", "gtsam", "mujoco")
    found = {name: version(name) for name in libraries}
    return {"processor": llvmlite.binding.get_host_cpu_name(), "python": platform.python_version(), **found}


def commit() -> str:
    """The commit of the tree; "" outside of a clone."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


# From files and values to rows ---------------------------------------------------------------------------------------


def pose_rows(trajectory: Trajectory) -> list[str]:
    """A row a pose: stamp, three rows of T_frame_body, and the upper half of the covariance if there is one."""
    columns = [trajectory.stamps_s[:, None], trajectory.T_frame_body[:, :3].reshape(-1, 12)]
    if trajectory.covariances is not None:
        columns.append(trajectory.covariances[:, *np.triu_indices(6)])
    frames = f"T_{trajectory.frame}_{trajectory.body}"
    return [frames, *(" ".join(map(repr, row)) for row in np.hstack(columns).tolist())]


def status_rows(path: Path) -> list[str]:
    """A row an answer of status.csv, without its time and note; a reason is its number in order of appearance."""
    with path.open(encoding="utf-8", newline="") as stream:
        answers = list(csv.DictReader(stream))
    number_of = {reason: number for number, reason in enumerate(dict.fromkeys(row["reason"] for row in answers))}
    kept = ("stamp_s", "status", "reason", "matches", "inliers", "flags", "dropped")
    return [",".join(str({**row, "reason": number_of[row["reason"]]}[name]) for name in kept) for row in answers]


def figure_rows(figures: Any, name: str = "") -> Iterator[str]:
    """A row a number or word of a JSON file: where it stands, and what it is. Sentences are left out."""
    if isinstance(figures, dict):
        if any(" " in key for key in figures):  # counted by what was said
            figures = dict(enumerate(sorted(figures.values(), key=repr)))
        for key in sorted(figures, key=str):
            if key not in NOT_KEPT:
                yield from figure_rows(figures[key], f"{name}.{key}" if name else str(key))
    elif isinstance(figures, list):
        for number, figure in enumerate(figures):
            yield from figure_rows(figure, f"{name}.{number}")
    elif not isinstance(figures, str) or _WORD.fullmatch(figures):
        yield f"{name} {figures!r}"


def surfel_rows(path: Path) -> list[str]:
    """A row for each thousand surfels of a PLY file: where they begin, and their hash."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    count = next(int(line.split()[-1]) for line in header.splitlines() if line.startswith(b"element vertex"))
    step = _SURFELS_A_ROW * len(body) // count
    return [hash_of(header), *(f"{at} {hash_of(body[at : at + step])}" for at in range(0, len(body), step))]


def file_rows(folder: Path, pattern: str) -> list[str]:
    """A row for each file in a folder: its name and hash."""
    files = sorted(path for path in folder.rglob(pattern) if path.is_file())
    return [f"{path.relative_to(folder).as_posix()} {hash_of(path.read_bytes())}" for path in files]


# Results -------------------------------------------------------------------------------------------------------------


def command(*words: str, leaves: Path | None = None) -> None:
    """A command of `wheelsight`; where it leaves a file its exit code may say that a robot did not arrive.

    Raises WheelsightError with what it printed last.
    """
    done = subprocess.run([sys.executable, "-m", "wheelsight", "--quiet", *words], capture_output=True, text=True)
    if done.returncode and (leaves is None or not leaves.exists()):
        raise WheelsightError(f"wheelsight {' '.join(words)}: {done.stderr.strip()[-500:]} (run it by hand)")


def run_results(
    recording: Path, odometry: str, out: Path, length_s: float | None, more: dict[str, Any]
) -> dict[str, Result]:
    """Of each track of a run, by its name."""
    config = load_config(overrides={"odometry": odometry, **more})
    records = run_each(open_recording(recording), config, out, duration_s=length_s)
    return {
        record.odometry: track_result(record.estimate, record.odom, out if len(records) == 1 else out / record.odometry)
        for record in records
    }


def track_result(estimate: Trajectory, odom: Trajectory | None, folder: Path) -> Result:
    """Of one track, by its poses and the folder of what it left."""
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    evaluation = metrics.get("evaluation") or {}
    status = status_rows(folder / "status.csv")
    figures = {"poses": len(estimate), "rows": len(status), "ate_m": evaluation.get("ate_m", {}).get("rmse")}
    figures["tracking"] = sum(row.split(",")[1] == "tracking" for row in status)
    tables = {"poses": pose_rows(estimate), "status": status, "figures": list(figure_rows(metrics))}
    if odom is not None:
        tables["odom"] = pose_rows(odom)
    for name in ("trajectory_corrected.txt", "loops_judged.csv"):
        if (folder / name).exists():
            tables[Path(name).stem] = (folder / name).read_text(encoding="utf-8").splitlines()
    if (folder / "map" / "map.surfels").exists():
        figures["surfels"] = write_ply(load_map(folder / "map" / "map.surfels"), folder / "all.ply", stable_only=False)
        tables["surfels"] = surfel_rows(folder / "all.ply")
        tables["keyframes"] = file_rows(folder / "map", "keyframes*")
        tables["occupancy"] = file_rows(folder / "map", "occupancy*")
    return Result(figures, tables)


def drive_result(folder: Path) -> Result:
    """Of a robot that drove by itself."""
    about = json.loads((folder / "drive.json").read_text(encoding="utf-8"))
    figures = {name: about[name] for name in ("has_arrived", "time_s", "way_m", "clearance_m")}
    tables = {
        "poses": (folder / "trajectory.txt").read_text(encoding="utf-8").splitlines(),
        "figures": list(figure_rows(about)),
    }
    if (folder / "map").exists():
        tables |= {name: file_rows(folder / "map", f"{name}*") for name in ("keyframes", "occupancy")}
    return Result(figures, tables)


class Maker:
    """Makes results in a folder.

    Args:
        length: of drives and recordings.
        folder: for what is simulated and found; empty.
        data: with the real recordings in `rgbd`.
    """

    def __init__(self, length: Length, folder: Path, data: Path) -> None:
        self._length, self._folder, self._data = length, folder, data

    def results(self, families: Sequence[str], console: Console) -> dict[str, Result]:
        """Of some of `FAMILIES`, by name. Raises WheelsightError."""
        makers = {
            "drives": self.drives,
            "recordings": self.recordings,
            "session": self.session,
            "goal": self.goal,
            "exploration": self.exploration,
        }
        found: dict[str, Result] = {}
        for family in families:
            for name, result in makers[family]():
                found[name] = result
                console.print(f"{name}: {', '.join(f'{key} {value}' for key, value in result.figures.items())}")
        return found

    def drives(self, names: Iterable[str] = ()) -> Iterator[tuple[str, Result]]:
        """The simulated drives: the recording; wheels, dense and joined with map and loops; and features."""
        for name in names or DRIVES:
            recording = self._simulated(name, DRIVES[name])
            files = file_rows(recording, "*")
            yield f"drives/{name}/recording", Result({"files": len(files)}, {"files": files})
            for track, result in run_results(recording, "wheels,dense", self._out(name), None, MAPPED).items():
                yield f"drives/{name}/{track}", result
            for track, result in run_results(recording, "features", self._out(f"{name}-features"), None, {}).items():
                yield f"drives/{name}/{track}", result

    def recordings(self) -> Iterator[tuple[str, Result]]:
        """The real ones: dense by itself and with map and loops, features, and joined where there are wheels."""
        for name in RECORDINGS:
            path, until_s = self._data / "rgbd" / name, self._length.recording_s
            ways: dict[str, tuple[str, dict[str, Any]]] = {"dense": ("dense", {}), "features": ("features", {})}
            ways["mapped"] = ("dense", MAPPED)
            if open_recording(path).wheel_count:
                ways["joined"] = ("wheels,dense", {})
            for way, (odometry, more) in ways.items():
                of_tracks = run_results(path, odometry, self._out(f"{name}-{way}"), until_s, more)
                for track, result in of_tracks.items():
                    yield f"recordings/{name}/{way if len(of_tracks) == 1 else track}", result

    def session(self) -> Iterator[tuple[str, Result]]:
        """The next day in the flat, in the map of the first."""
        recording = self._simulated("next-day", (*DRIVES["flat"], "--day", "1"))
        known = {"known_map.path": str(self._first_day()), "loops.source": "keyframes"}
        for track, result in run_results(recording, "wheels,dense", self._out("next-day"), None, known).items():
            yield f"session/{track}", result

    def goal(self) -> Iterator[tuple[str, Result]]:
        """A drive to a place of the map of the flat, with any heading."""
        out = self._out("goal")
        where = ("--map", str(self._first_day()), "--to", "1.8,0")
        command(
            "drive",
            "--sim",
            "flat",
            "--realism",
            "ideal",
            "--seed",
            "1",
            *where,
            "--out",
            str(out),
            leaves=out / "drive.json",
        )
        yield "goal", drive_result(out)

    def exploration(self) -> Iterator[tuple[str, Result]]:
        """Of an empty room."""
        plan, out = self._folder / "room.pgm", self._out("exploration")
        rows, columns = self._length.room
        free = np.full((rows, columns), 255, np.uint8)
        free[[0, 1, -2, -1]] = free[:, [0, 1, -2, -1]] = 0
        plan.write_bytes(b"P5 %d %d 255\n" % (columns, rows) + free.tobytes())
        where = ("--sim", str(plan), "--resolution", "0.05", "--start", "1,1.1,0", "--realism", "ideal", "--seed", "1")
        command("drive", *where, "--explore", "--out", str(out), leaves=out / "drive.json")
        yield "exploration", drive_result(out)

    def _simulated(self, name: str, words: Sequence[str]) -> Path:
        recording = self._folder / "simulated" / name
        how = ("--rate", "10", "--duration", f"{self._length.drive_s:g}", "--out", str(recording))
        command("simulate", *words, *how)
        return recording

    def _first_day(self) -> Path:
        """The run of the flat's drive, with its map."""
        if not self._out("flat").exists():
            for _ in self.drives(["flat"]):
                pass
        return self._out("flat")

    def _out(self, name: str) -> Path:
        return self._folder / "runs" / name


# Comparison ----------------------------------------------------------------------------------------------------------


def keep(results: dict[str, Result], folder: Path) -> None:
    """Write all tables, one file each."""
    for name, result in results.items():
        for table, rows in result.tables.items():
            path = folder / name / f"{table}.txt"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("\n".join(rows), encoding="utf-8")


def first_difference(before: Path, rows: Sequence[str], sha256: str) -> str:
    """Which row of a kept table differs first, and how; "" where no table of that hash was kept."""
    if not before.exists() or hash_of(before.read_bytes()) != sha256:
        return ""
    old = before.read_text(encoding="utf-8").split("\n")
    number = next((n for n, (a, b) in enumerate(zip(old, rows, strict=False)) if a != b), min(len(old), len(rows)))
    was, now = ((some[number] if number < len(some) else "nothing") for some in (old, rows))
    words = next(
        (f"word {n}: {a} is {b} now" for n, (a, b) in enumerate(zip(was.split(), now.split(), strict=False)) if a != b),
        f"{was} is {now} now",
    )
    return f"row {number}, {words[:160]}"


def differences(golden: dict[str, Any], results: dict[str, Result], kept: Path | None) -> dict[str, list[str]]:
    """By result, what is not as it was; results that are as they were have an empty list."""
    found: dict[str, list[str]] = {}
    for name in sorted({*golden, *results}):
        if name not in results or name not in golden:
            found[name] = ["is not made any more" if name in golden else "was not made then"]
            continue
        before, now, found[name] = golden[name], results[name].to_dict(), []
        for table in sorted({*before["sha256"], *now["sha256"]}):
            was, sha256 = before["sha256"].get(table), now["sha256"].get(table)
            if was is None or sha256 is None:
                found[name].append(f"{table}: {'is not made any more' if sha256 is None else 'was not made then'}")
            elif was != sha256:
                path = Path() if kept is None else kept / name / f"{table}.txt"
                where = "" if kept is None else first_difference(path, results[name].tables[table], was)
                found[name].append(f"{table}: {where or 'differs'}")
        for figure, value in before["figures"].items():
            if value != now["figures"].get(figure):
                found[name].append(f"{figure}: {value} is {now['figures'].get(figure)} now")
    return found


def table_of(found: dict[str, list[str]], golden: dict[str, Any]) -> Table:
    """A row a result."""
    table = Table("result", "tables", "figures then", "same", "what differs")
    for name, differing in found.items():
        before = golden.get(name, {"figures": {}, "sha256": {}})
        figures = ", ".join(
            f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
            for key, value in before["figures"].items()
        )
        table.add_row(name, str(len(before["sha256"])), figures, "no" if differing else "yes", "\n".join(differing))
    return table


def is_same(before: dict[str, Any], results: dict[str, Result], kept: Path | None, console: Console) -> bool:
    """Print what differs from the results before; whether nothing does."""
    found = differences(before, results, kept)
    console.print(table_of(found, before))
    count = sum(bool(differing) for differing in found.values())
    console.print(f"{len(found) - count} of {len(found)} results are the same, {count} differ")
    return count == 0


def main(words: Sequence[str] | None = None) -> int:
    """Write or compare; 1 where something differs."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.golden",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--write", action="store_true", help="keep the results of this tree in place of comparing them")
    parser.add_argument("--quick", action="store_true", help="a short part of everything: at most three minutes")
    parser.add_argument("--only", nargs="+", choices=FAMILIES, default=FAMILIES, help="these alone")
    parser.add_argument("--keep", type=Path, help="folder for the tables, so that a difference is named by its row")
    parser.add_argument("--golden", type=Path, default=GOLDEN, help="file of the hashes")
    parser.add_argument("--data", type=Path, default=None, help="folder with rgbd/RECORDING in it")
    asked = parser.parse_args(words)
    console, length = Console(width=180), QUICK if asked.quick else FULL
    data = asked.data or Path(os.environ.get("WHEELSIGHT_DATA") or Path(__file__).parents[2] / "shared" / "data")
    golden = json.loads(asked.golden.read_text(encoding="utf-8")) if asked.golden.exists() else {}
    if not asked.write and length.name not in golden:
        raise WheelsightError(f"{asked.golden}: has no {length.name} results (--write them before the change)")
    before = golden.get(length.name, {})
    with TemporaryDirectory() as folder:
        results = Maker(length, Path(folder), data).results(asked.only, console)
    if asked.keep is not None:
        keep(results, asked.keep / (length.name if asked.write else f"{length.name}-now"))
    if asked.write:
        others = {name: one for name, one in before.items() if name.split("/")[0] not in asked.only}
        golden[length.name] = others | {name: one.to_dict() for name, one in results.items()}
        golden["made_with"] = made_with()
        golden["commits"] = golden.get("commits", {}) | {length.name: commit()}
        asked.golden.write_text(json.dumps(golden, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        return 0
    for name, was in golden["made_with"].items():
        if (now := made_with().get(name)) != was:
            console.print(
                f"{name} was {was} and is {now}: --write the results of the older tree again on this computer"
            )
    before = {name: one for name, one in before.items() if name.split("/")[0] in asked.only}
    return 0 if is_same(before, results, asked.keep and asked.keep / length.name, console) else 1


if __name__ == "__main__":
    if any(os.environ.get(name) != value for name, value in STEADY.items()):
        again = [sys.executable, "-m", "benchmarks.golden", *sys.argv[1:]]
        os.execve(sys.executable, again, {**os.environ, **STEADY})
    sys.exit(main())

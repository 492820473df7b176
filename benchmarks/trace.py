"""Where a frame's time goes: wall and processor time of each stage, and a picture of a trace.

The picture shows ten frames of a real recording as `wheelsight run --trace` writes them: the stages of each thread, and
below them what each frame waited for. The tables are means of all frames but the first ten, which load kernels. A
stage's time is without its nested stages. No real recording at hand has both wheels and a camera, so that the joined
drive is simulated.
"""

from __future__ import annotations

import argparse
import io
import json
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from rich.console import Console

from benchmarks import machine
from benchmarks.measure import keep_to
from benchmarks.sequences import PROJECT, default_data_folder
from benchmarks.table import Sheet, write_page
from wheelsight import Localizer, RgbdFrame, load_config, open_recording, run
from wheelsight.config import Config
from wheelsight.core.files import write_bytes
from wheelsight.core.robots import EventSource
from wheelsight_export import trace_to
from wheelsight_sim import SimulationSettings, simulate

_RECORDING, _FRAMES, _SHOWN = "rgbd_dataset_freiburg1_desk", 300, 10
_WARMING = 10
_MAPPED = {"map": "surfels", "loops": {"source": "keyframes"}}
_SIMULATED = "simulated flat, joined, map and loops"
_WAYS: dict[str, dict[str, Any]] = {
    "features": {"odometry": "features"},
    "dense": {"odometry": "dense"},
    "dense, map and loops": {"odometry": "dense", **_MAPPED},
    _SIMULATED: {"odometry": "wheels,dense", **_MAPPED},
}
_PICTURE = """![Stages of each thread, and waits of each frame](../images/trace.png)

Top: each thread has a row for each depth of nesting; the first row of `main` is the frame. Bottom: the wall time of
each frame. A thread that was ready and had no processor shows how busy the machine was. The unexplained time is an
upper bound of the wait for the interpreter's lock: [Traces](../cli.md#traces).
"""
_NOWHERE, _WHOLE = "in no stage", "the whole frame"


@dataclass(frozen=True, slots=True)
class Stages:
    """Mean times of a frame, milliseconds.

    Attributes:
        way: how frames were followed.
        frames: number of frames.
        wall_ms, processor_ms: by stage, with `_NOWHERE` and `_WHOLE`.
    """

    way: str
    frames: int
    wall_ms: Mapping[str, float]
    processor_ms: Mapping[str, float]


def stages_of(way: str, source: EventSource, config: Config, frames: int) -> Stages:
    """Follow the first frames of a source, and return the means of all but the first."""
    wall: dict[str, float] = defaultdict(float)
    processor: dict[str, float] = defaultdict(float)
    count = 0
    with Localizer(source.calibration, config, waits=True) as localizer:
        for event in source.events():
            began_s, began_used_s = time.perf_counter(), time.thread_time()
            localizer.process(event)
            used_s, wall_s = time.thread_time() - began_used_s, time.perf_counter() - began_s
            if not isinstance(event, RgbdFrame):
                continue
            count += 1
            if count > _WARMING:
                found = (wall, wall_s, localizer.stage_seconds), (processor, used_s, localizer.stage_processor_seconds)
                for total, whole_s, seconds in found:
                    named = {**seconds, _NOWHERE: whole_s - sum(seconds.values()), _WHOLE: whole_s}
                    for stage, spent_s in named.items():
                        total[stage] += spent_s
            if count == frames:
                break
    used = count - _WARMING
    means = ({stage: 1e3 * spent_s / used for stage, spent_s in total.items()} for total in (wall, processor))
    return Stages(way, used, *means)


def stages_sheet(found: Stages) -> Sheet:
    """A row a stage, the longest first."""
    order = sorted(found.processor_ms, key=lambda stage: (stage in (_NOWHERE, _WHOLE), -found.processor_ms[stage]))
    order = [stage for stage in order if stage not in (_NOWHERE, _WHOLE)] + [_NOWHERE, _WHOLE]
    rows = [
        (
            stage,
            f"{found.wall_ms[stage]:.2f}",
            f"{found.processor_ms[stage]:.2f}",
            f"{100 * found.wall_ms[stage] / found.wall_ms[_WHOLE]:.1f} %",
            f"{100 * found.processor_ms[stage] / found.processor_ms[_WHOLE]:.1f} %",
        )
        for stage in order
    ]
    heads = "stage", "wall ms", "processor ms", "of wall", "of processor"
    return Sheet(f"Stages: {found.way}, mean of {found.frames} frames", heads, tuple(rows))


Traced = list[dict[str, Any]]
"""Events of a trace."""


def traced_run(source: EventSource, config: Config) -> Traced:
    """Run a source as `wheelsight run --trace` does, and return the events."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with trace_to(folder / "trace.json"):
            run(source, config, folder / "out")
        events: Traced = json.loads((folder / "trace.json").read_text(encoding="utf-8"))["traceEvents"]
    return events


def shown_frames(events: Traced, count: int) -> Traced:
    """The frames in a row beside which most threads work, of those the ones that lacked a processor least."""
    frames = [event for event in events if event.get("cat") == "frame"]
    best: tuple[tuple[int, float], Traced] = (0, 0.0), frames[:count]
    for first in range(_WARMING, len(frames) - count):
        some = frames[first : first + count]
        begin_us, end_us = some[0]["ts"], some[-1]["ts"] + some[-1]["dur"]
        beside = {event["tid"] for event in events if event["ph"] == "X" and begin_us < event["ts"] < end_us}
        lacked = sum(frame["args"].get("no_processor_us", 0) for frame in some) / (end_us - begin_us)
        best = max(best, ((len(beside), -lacked), some), key=lambda scored: scored[0])
    return best[1]


_COLOURS = {
    "track": "#cfd6df",
    "extract": "#4e79a7",
    "recognise": "#76b7b2",
    "prepare": "#a0cbe8",
    "predict": "#59a14f",
    "align": "#f28e2b",
    "verify": "#ffbe7d",
    "fuse": "#b07aa1",
    "keyframe": "#9c755f",
    "graph": "#d4a6c8",
    "decode": "#bab0ac",
    "make a keyframe": "#d7b5a6",
    "write": "#86bcb6",
}
_FRAME, _OTHER, _WAIT, _IDLE, _INK = "#e6e8ec", "#8a94a3", "#e15759", "#fbe9e8", "#262b33"
_LEAST_SHARE = 1 / 3000  # of the picture's time: shorter spans are not seen
_HIDDEN, _IDLE_WAITS = ("event", "next event", "show"), ("room ahead",)
_WAITS = {
    "processor time": "#4e79a7",
    "waits for locks": _WAIT,
    "no processor was free": "#f1ce63",
    "unexplained: at most this for the interpreter's lock": "#79706e",
}
_INCHES, _ROW_INCHES, _DOTS_PER_INCH = 13.0, 0.42, 110
_LEGEND_COLUMNS = 6


def draw_trace(path: Path, events: Traced, title: str, count: int = _SHOWN) -> None:
    """Write the picture (PNG) of some frames of a trace."""
    frames = shown_frames(events, count)
    begin_us, end_us = frames[0]["ts"], frames[-1]["ts"] + frames[-1]["dur"]
    spans = [e for e in events if e["ph"] == "X" and e["ts"] < end_us and e["ts"] + e["dur"] > begin_us]
    seen = [e for e in spans if e["name"] not in _HIDDEN and e["dur"] > _LEAST_SHARE * (end_us - begin_us)]
    rows = _rows(seen, events)
    figure = Figure(figsize=(_INCHES, _ROW_INCHES * len(rows) + 3.6), dpi=_DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(_ROW_INCHES * len(rows), 1.5))
    used = _draw_threads(above, rows, begin_us)
    _draw_waits(below, frames, begin_us)
    above.set_title(title, loc="left", color=_INK, fontsize=12)
    below.set_xlim(0, (end_us - begin_us) / 1e3)
    below.set_xlabel("ms")
    keys = [Patch(color=colour, label=name) for name, colour in _COLOURS.items() if name in used]
    keys += [Patch(color=_OTHER, label="other stages"), Patch(color=_WAIT, label="waits for another thread")]
    keys += [Patch(color=_IDLE, label="has no work")]
    figure.legend(handles=keys, loc="outside upper right", ncols=_LEGEND_COLUMNS, frameon=False, fontsize=9)
    image = io.BytesIO()
    figure.savefig(image, format="png")
    write_bytes(path, image.getvalue())


def _rows(spans: Traced, events: Traced) -> list[tuple[str, Traced]]:
    """The spans of each thread and depth of nesting, with the name of the thread at its first row."""
    names = {event["tid"]: event["args"]["name"] for event in events if event["name"] == "thread_name"}
    rows: list[tuple[str, Traced]] = []
    for number in sorted({span["tid"] for span in spans}, key=lambda one: (names[one] != "main", names[one])):
        depths: list[Traced] = []
        # An outer span begins first, or lasts longer.
        for span in sorted((s for s in spans if s["tid"] == number), key=lambda s: (s["ts"], -s["dur"])):
            ends = (depth[-1]["ts"] + depth[-1]["dur"] for depth in depths)
            depth = next((n for n, end_us in enumerate(ends) if end_us <= span["ts"] + 0.2), len(depths))
            if depth == len(depths):
                depths.append([])
            depths[depth].append(span)
        name = names[number].removeprefix("wheelsight-").removesuffix("_0")
        rows += [(name if depth == 0 else "", row) for depth, row in enumerate(depths)]
    return rows


def _draw_threads(axes: Axes, rows: Sequence[tuple[str, Traced]], begin_us: float) -> set[str]:
    """Draw bars of spans, and return their names."""
    for place, (name, row) in enumerate(rows):
        for span in row:
            colour = _FRAME if span["cat"] == "frame" else _COLOURS.get(span["name"], _OTHER)
            if span["cat"] == "lock":  # a thread that has nothing to do waits as well
                colour = _IDLE if span["name"] in _IDLE_WAITS else _WAIT
            at_ms, long_ms = (span["ts"] - begin_us) / 1e3, span["dur"] / 1e3
            axes.barh(place, long_ms, 0.86, at_ms, color=colour, edgecolor="white", linewidth=0.4)
            if span["cat"] == "frame":
                words = f"{long_ms:.0f} ms"
                axes.text(at_ms + long_ms / 2, place, words, ha="center", va="center", color=_INK, fontsize=8.5)
        if name:
            axes.axhline(place - 0.5, color="#c9ced6", linewidth=0.8)
    named = [(place, name) for place, (name, _) in enumerate(rows) if name]
    axes.set_yticks([place for place, _ in named], [name for _, name in named])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    _plain(axes)
    return {span["name"] for _, row in rows for span in row}


def _draw_waits(axes: Axes, frames: Traced, begin_us: float) -> None:
    """Draw what each frame's wall time consists of."""
    for frame in frames:
        args = frame["args"]
        parts = frame["tdur"], args.get("locks_us", 0), args.get("no_processor_us", 0), args["unexplained_us"]
        below_ms = 0.0
        for colour, part_us in zip(_WAITS.values(), parts, strict=True):
            at_ms, wide_ms = (frame["ts"] - begin_us) / 1e3, frame["dur"] / 1e3
            axes.bar(at_ms, part_us / 1e3, wide_ms, below_ms, align="edge", color=colour, edgecolor="white")
            below_ms += part_us / 1e3
    keys = [Patch(color=colour, label=name) for name, colour in _WAITS.items()]
    axes.legend(handles=keys, ncols=4, frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes.set_ylabel("ms a frame")
    _plain(axes)


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(length=0, colors=_INK)


def main() -> None:
    """Print the tables, and write page and picture where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trace", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--recording", default=_RECORDING, metavar="RECORDING")
    parser.add_argument("--frames", type=int, default=_FRAMES, help="of each table")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    parser.add_argument("--picture", type=Path, help="PNG to write")
    arguments = parser.parse_args()
    about, console, sheets = machine.description(), Console(width=140), list[Sheet]()
    about["Command"] = f"`python -m benchmarks.trace --frames {arguments.frames}`"
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=PROJECT, capture_output=True, check=False)
    about["Commit"] = commit.stdout.decode().strip() or "unknown"
    keep_to(2)
    recording = open_recording(arguments.data / "rgbd" / arguments.recording)
    flat = simulate(SimulationSettings("flat", size=(640, 480), rate_hz=30.0, duration_s=arguments.frames / 30, seed=1))
    for way, settings in _WAYS.items():
        source: EventSource = flat if way == _SIMULATED else recording
        name = way if way == _SIMULATED else f"{arguments.recording}, {way}"
        sheets.append(stages_sheet(stages_of(name, source, load_config(overrides=settings), arguments.frames)))
        console.print(sheets[-1].to_rich())
    if arguments.picture is not None:
        traced = load_config(overrides={"odometry": "dense", **_MAPPED})
        draw_trace(arguments.picture, traced_run(recording, traced), f"{arguments.recording}: dense, map and loops")
    if arguments.out is not None:
        write_page(arguments.out, "A frame's time", f"{__doc__}\n{_PICTURE}", about, sheets)


if __name__ == "__main__":
    main()

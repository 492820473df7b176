"""`wheelsight run`: estimates the path of a camera or robot. Opens the source, shows the progress and prints the
results.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.app.cli.console import takes
from wheelsight.app.cli.options import settings_from
from wheelsight.app.cli.run_options import RunOptions
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import exit_code

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.app.run import FrameRecord, InRealTime, LiveSource, RealTimeRecording, RunRecord
    from wheelsight.app.run.track import Watcher
    from wheelsight.config import Config
    from wheelsight.core.robots import EventSource
    from wheelsight.core.settings import RealTimeSettings
    from wheelsight.io.devices.live_camera import LiveCamera
    from wheelsight.io.devices.wheel_source import ReadingLink
    from wheelsight.io.recordings import Recording
    from wheelsight_ros2 import LinkSettings


@takes(RunOptions)
def run(options: RunOptions) -> None:
    """Find where the robot or its camera went: trajectory, status of each frame, metrics and a report go to DIR.

    Without --odometry wheels and camera are joined where the recording has both and it is known where the camera sits;
    else one of them is followed. One line says which, and how to choose otherwise.

    DIR gets trajectory.txt (TUM), status.csv, metrics.json, the resolved config.yaml and report.html.
    Several odometries have a folder each.

    --map surfels adds map/, in which --map-from finds the next drive: until the place is recognised, its poses are
    "initializing". wheelsight export makes points or a mesh of it.
    --loops adds trajectory_corrected.txt, the way as known at its end, and loops_judged.csv.

    Ctrl-C stops early and keeps what was found until then. With --live, a camera and wheels are followed as they are
    just now: "ready" is said once nothing is left to be compiled or loaded, and Ctrl-C ends it.

    [bold]Examples[/bold]

    wheelsight run sample --out first
    wheelsight run my_drive --map surfels --out results
    wheelsight run rgbd_dataset_freiburg1_desk --odometry features --out results
    wheelsight run my_recording --camera my_camera.yaml --config settings.yaml --out results --force
    wheelsight run my_recording --odometry wheels --calibration my_wheels.yaml --out results
    wheelsight run robot.bag --topic wheels=/odom --out results
    wheelsight run my_recording --odometry dense --out results
    wheelsight run my_recording --odometry wheels --places floor.places --out results
    wheelsight run my_recording --odometry wheels --loops matches --out results
    wheelsight run my_drive --realtime --out results
    wheelsight run my_drive --profile pi --out results
    wheelsight run --live --camera any --wheels /dev/ttyUSB0 --calibration robot.yaml --map surfels --out now
    wheelsight run monday --map surfels --loops keyframes --out monday_map
    wheelsight run my_drive --map surfels --rerun run.rrd --out results
    wheelsight run my_drive --trace trace.json --out results
    wheelsight run tuesday --map-from monday_map --out found_again
    wheelsight run my_drive --realtime --map surfels --foxglove 8766 --out results
    """
    from wheelsight.app.cli.options import link_settings
    from wheelsight.app.run import default_odometry

    check_source(options)
    links = link_settings(options)
    settings = settings_from(options.settings(), options.config)
    chosen = ""
    with traced(options.trace, options.force), source_of(options, settings) as source:
        if not settings.odometry:
            choice = default_odometry(source, settings)
            settings, chosen = settings.with_odometry(choice.odometry), choice.sentence
        records = track(source, settings, options.out, options.force, options.rerun, chosen, links)
    print_summary(records, options.out)


def track(
    source: EventSource,
    settings: Config,
    out: Path,
    force: bool,
    rerun: str | None = None,
    note: str = "",
    links: LinkSettings | None = None,
) -> Sequence[RunRecord]:
    """Run with progress on stderr. Ctrl-C ends it with the exit code of an interruption.

    `rerun` is a file or "spawn", or None. `note` is printed once the inputs are accepted.
    """
    from wheelsight.app import runs
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.console import print_note, print_warning
    from wheelsight.app.cli.options import can_draw, check_rerun, linked
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.app.run import LiveSource
    from wheelsight.app.run.kernels import parts_of
    from wheelsight_export import open_rerun

    count, unit = expected(source, settings)
    status, progress = RunStatus(), FrameProgress("tracking", count, unit=unit)
    answered: list[bool] = []

    def show(answers: Mapping[str, FrameRecord]) -> None:
        answered[:] = [True]
        show_progress(progress, source, settings, status.after(answers))

    def note_code(done: int, total: int) -> None:
        if done == 1:
            print_note(f"making {total:,} keyframes ready to be recognised")

    try:
        with ExitStack() as shown:
            watcher: Watcher | None = None
            if rerun is not None:
                check_rerun(rerun, force)
                log = open_rerun(rerun, source.calibration, settings.tracks, settings.viewer)
                watcher = shown.enter_context(log)
            # Stamps of a live run are the host's time; those of a recording are its own, and /clock gives them.
            is_live = isinstance(source, LiveSource)
            opened = linked(links, source.calibration, settings, time.time, print_warning, is_simulated=not is_live)
            bridge = shown.enter_context(opened)
            if bridge is not None:
                from wheelsight_ros2 import RunBridge

                watcher = RunBridge(bridge, watcher)

            def begin() -> None:
                if note:
                    print_note(note)
                can_draw()
                compile_missing(parts_of(settings))
                shown.enter_context(progress)

            return runs.run_each(
                source, settings, out, force=force, on_ready=begin, on_code=note_code, on_event=show, watcher=watcher
            )
    except KeyboardInterrupt as interruption:
        found = f"what was found until then is in {out}" if answered else "nothing was found until then"
        print_note(f"interrupted; {found}")
        raise typer.Exit(exit_code()) from interruption


def traced(trace: Path | None, force: bool) -> AbstractContextManager[None]:
    """The block that the trace shows, if one is wanted. Raises OutputError."""
    from wheelsight.app.cli.options import check_out
    from wheelsight_export import trace_to

    if trace is not None:
        check_out(trace, force, "--trace")
    return nullcontext() if trace is None else trace_to(trace)


def check_source(asked: RunOptions) -> None:
    """Check options of the source, live or recorded. Raises ConfigError for invalid combinations."""
    if not asked.live:
        needs = {"--wheels": asked.wheels, "--seconds": asked.seconds, "--record": asked.record}
        if given := [option for option, value in needs.items() if value is not None]:
            raise ConfigError(f"{given[0]} is of a live run", fix="add --live, or leave it out")
        if asked.recording is None:
            raise ConfigError("no recording is named", fix="wheelsight run RECORDING, or --live --camera NAME")
        return
    if asked.recording is not None:
        raise ConfigError("--live follows sensors, no recording", fix="leave one of them out")
    if asked.realtime or asked.wheels_from is not None:
        raise ConfigError("--realtime plays a recording", fix="with --live, --wheels PORT alone")
    if asked.camera is None and asked.wheels is None:
        raise ConfigError("there is nothing to listen to", fix="--camera NAME, --wheels PORT, or both")


def source_of(asked: RunOptions, settings: Config) -> AbstractContextManager[EventSource]:
    """The source of the run, open in the block. Raises InputError."""
    from wheelsight.app.cli.options import open_source

    if asked.live:
        return _opened(asked, settings)
    assert asked.recording is not None
    recording = open_source(asked.recording, settings)
    return played(recording, asked.realtime, asked.wheels_from, asked.baud, settings.realtime)


@contextmanager
def _opened(asked: RunOptions, settings: Config) -> Iterator[LiveSource]:
    """Sensors, kernels and recorder, ready for the first event."""
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.console import print_note, print_warning
    from wheelsight.app.cli.options import robot_camera
    from wheelsight.app.cli.record import note, print_end
    from wheelsight.app.cli.wheels import note_status
    from wheelsight.app.run import LiveSensors, LiveSource
    from wheelsight.app.run.kernels import parts_of
    from wheelsight.core.calibration import load_calibration
    from wheelsight.core.files import new_output_folder
    from wheelsight.core.runtime import until_stopped
    from wheelsight.io.devices import BAUDRATE, WheelLink
    from wheelsight.io.devices.recorder import LiveRecorder
    from wheelsight.io.recordings import RecordingWriter

    with ExitStack() as opened:
        opened.enter_context(new_output_folder(asked.out, asked.force))  # refused before a device is touched
        compile_missing(parts_of(settings))  # minutes, in which a camera had better not run
        topics = settings.recording.topics or settings.camera.topics
        of_camera = settings.camera.model_copy(update={"topics": topics})
        camera: LiveCamera | None = None
        link: ReadingLink | None = None
        if asked.wheels is not None and asked.wheels.startswith("ros2:"):
            from wheelsight_ros2.sensors import open_ros2_sensors

            ros2 = opened.enter_context(
                open_ros2_sensors(asked.camera, asked.wheels, of_camera, asked.calibration or ())
            )
            camera, link, calibration = ros2.camera, ros2.link, ros2.calibration
            for warning in ros2.warnings:
                print_warning(warning)
        elif asked.camera is not None:
            camera, calibration = robot_camera(asked.camera, of_camera, asked.calibration or ())
            opened.callback(camera.close)
        elif asked.calibration:
            calibration = load_calibration(*asked.calibration)
        else:
            raise ConfigError("nothing says how large the wheels are", fix="--calibration FILE")
        if asked.wheels is not None and link is None:
            link = opened.enter_context(WheelLink(asked.wheels, asked.baud or BAUDRATE, note_status(asked.wheels)))
        recorder = None
        if asked.record is not None:
            writer = RecordingWriter(asked.record, calibration, asked.force)
            recorder = opened.enter_context(LiveRecorder(writer, settings.recorder))
            opened.callback(print_end, writer, recorder, asked.record, calibration.color is not None)
        sensors = LiveSensors(calibration, camera, link, recorder)
        how_long = f"for {asked.seconds:g} s" if asked.seconds is not None else "until Ctrl-C"
        yield LiveSource(
            sensors, lambda: until_stopped(asked.seconds), lambda: print_note(f"ready; following {how_long}"), note
        )


@contextmanager
def played(
    recording: Recording, realtime: bool, wheels_from: str | None, baud: int | None, settings: RealTimeSettings
) -> Iterator[Recording | RealTimeRecording]:
    """The recording as it is, or in real time, with external wheels if requested.

    Raises:
        ConfigError: an option lacks another one.
        InputError: the wheels cannot be opened.
    """
    from wheelsight.app.run import in_real_time
    from wheelsight.io.devices import BAUDRATE

    if wheels_from is not None and not realtime:
        raise ConfigError("--wheels-from joins wheels that turn just now", fix="add --realtime")
    if baud is not None and wheels_from is None:
        raise ConfigError("--baud is the rate of a port", fix="add --wheels-from PORT")
    if not realtime:
        yield recording
        return
    with in_real_time(recording, wheels_from, baud or BAUDRATE, settings=settings) as live:
        yield live


def counts_frames(source: EventSource, settings: Config) -> bool:
    """Whether progress counts frames that pass by, with dropped ones."""
    from wheelsight.app.run import InRealTime

    return isinstance(source, InRealTime) and settings.tracks != ("wheels",)


def expected(source: EventSource, settings: Config) -> tuple[int | None, str]:
    """Number of events to answer, if known, and their unit; "" if their rate has no meaning."""
    from wheelsight.app.run.run_source import frame_count_of, wheel_count_of

    frames, readings = frame_count_of(source), wheel_count_of(source)
    if counts_frames(source, settings):
        return frames, ""
    if settings.tracks == ("wheels",):
        return readings, "readings"
    if "wheels" not in settings.tracks:
        return frames, "frames"
    return None if frames is None or readings is None else frames + readings, "events"


def show_progress(progress: FrameProgress, source: EventSource, settings: Config, status: str) -> None:
    """Show one more answered event; in real time, the latency, too."""
    from wheelsight.app.run import InRealTime
    from wheelsight.app.run.run_source import frame_count_of

    if isinstance(source, InRealTime):
        status = " · ".join(filter(None, [status, words(source)]))
        if counts_frames(source, settings):
            progress.reach(source.frames_so_far[0], frame_count_of(source), status, rate_of(source))
            return
    progress.advance(status)


def rate_of(recording: InRealTime) -> str:
    """The rate of answered frames, such as "29.8 frames/s"; "" before the first."""
    lately = recording.lately()
    return "" if lately is None else f"{lately[0]:.1f} frames/s"


def words(recording: InRealTime) -> str:
    """Latency and drops, such as "31 ms late, 12 dropped"."""
    parts = []
    if (lately := recording.lately()) is not None:
        parts.append(f"{1e3 * lately[1]:.0f} ms late")
    frames, dropped = recording.frames_so_far
    if frames:
        parts.append(f"{dropped} dropped")
    if recording.is_missing_wheels:
        parts.append("wheels silent")
    return ", ".join(parts)


_JOINED = "joined"


class RunStatus:
    """Each odometry's status and the size of the map, such as "tracking · 412k surfels"; joined sensors first."""

    def __init__(self) -> None:
        self._of_each: dict[str, str] = {}

    def after(self, answers: Mapping[str, FrameRecord]) -> str:
        """The status text after one more event, by each odometry's answer."""
        for odometry, answer in answers.items():
            text = str(answer.status)
            if answer.surfels is not None:
                text += f" · {count(answer.surfels)} surfels"
                dropped = count(answer.surfels_dropped)
                text += f", {dropped} given up for want of room" if answer.surfels_dropped else ""
            self._of_each[odometry] = text
        if len(self._of_each) == 1:
            return next(iter(self._of_each.values()))
        first = sorted(self._of_each, key=lambda odometry: odometry != _JOINED)
        return ", ".join(f"{odometry} {self._of_each[odometry]}" for odometry in first)


def count(n: int) -> str:
    """A count in three digits: 950, 412k, 1.23M."""
    if n < 1000:
        return str(n)
    return f"{n / 1e3:.0f}k" if n < 999_500 else f"{n / 1e6:.2f}M"


_ON_THE_PAGE_ONLY = ("ATE, max", "of the way", "turn a metre", "95 % within", "time covered")  # 80 signs wide


def print_summary(records: Sequence[RunRecord], out: Path) -> None:
    """Print the recognition in a known map; figures, a row for each odometry; warnings, the verdict, and files."""
    from rich.text import Text

    from wheelsight.app.cli.console import console, print_warning
    from wheelsight.app.run import Tone, verdict_of_run
    from wheelsight_report import why_no_page

    stdout, verdict = console(), verdict_of_run(records)
    for result in _results(records):
        stdout.print(result)
    for warning in dict.fromkeys(w for record in records for w in record.warnings):
        print_warning(warning)
    # The verdict in a line, and below it the findings, the worst first, with remedies
    styles = {Tone.GREEN: "green", Tone.AMBER: "yellow", Tone.RED: "bold red"}
    stdout.print(Text.assemble("verdict: ", (str(verdict.tone), styles[verdict.tone]), f", {verdict.phrase}"))
    for found in verdict.concerns:
        if found.about != "sensors":  # a warning, printed above
            stdout.print(Text.assemble((f"  {found.tone:<6}", styles[found.tone]), found.line))
    sound = [found for found in verdict.findings if found.tone is Tone.GREEN and found.about != "map"]
    if sound:
        shorts = "; ".join(found.short for found in sound)
        stdout.print(Text.assemble((f"  {Tone.GREEN:<6}", styles[Tone.GREEN]), f"{shorts}."))
    for fact in verdict.facts:
        stdout.print(Text(f"        {fact}"))
    for line in _maps(records, out):
        stdout.print(line)
    if why_no_page() is None:
        stdout.print(f"report: {out / 'report.html'}")


def _results(records: Sequence[RunRecord]) -> Iterator[Group | Table | str]:
    """Recognition in a known map, figures, and results of loop closing."""
    from wheelsight.app.cli.console import facts_table, rows_table
    from wheelsight.app.cli.evaluate import evaluation_table
    from wheelsight_report.comparison import error_rows

    for known in (record.known_map for record in records if record.known_map is not None):
        yield f"{known.sentence}."
    first = records[0]
    if len(records) > 1:
        yield _joint_table(records)
        for areas in (record.rectification for record in records if record.rectification is not None):
            if areas.errors is not None:
                yield rows_table("distance from the truth, nothing aligned", *error_rows(areas), style=None)
    else:
        yield facts_table(f"{first.recording}: T_{first.estimate.frame}_{first.estimate.body}", _facts(first))
        if first.evaluation is not None:
            yield evaluation_table(first.evaluation)
    for record in records:
        if record.correction is not None:
            yield f"{record.odometry}: {record.correction.sentence}"
            if record.correction.evaluation is not None:
                yield evaluation_table(record.correction.evaluation)


def _maps(records: Sequence[RunRecord], out: Path) -> Iterator[str]:
    """Path and size of each map."""
    for record in records:
        folder = out / record.odometry if len(records) > 1 else out
        for kept in (record.map, record.kept_map):
            if kept is not None:
                yield f"map: {folder / kept.file} ({kept.sentence})"


def _joint_table(records: Sequence[RunRecord]) -> Table:
    """One row for each odometry; below, reasons for missing evaluations."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from wheelsight_report.comparison import comparison_rows

    head, rows = comparison_rows(records)
    missing = [f"{r.odometry} not evaluated: {r.evaluation_problem}" for r in records if r.evaluation is None]
    table = Table(title=records[0].recording, box=SIMPLE_HEAD, caption="\n".join(missing) or None, caption_style="")
    table.title_justify = table.caption_justify = "left"
    shown = [index for index, name in enumerate(head) if not name.startswith(_ON_THE_PAGE_ONLY)]
    for index in shown:
        table.add_column(head[index], justify="right" if index else "left")
    for record, row in zip(records, rows, strict=True):
        table.add_row(*(row[index] for index in shown), style="bold" if record.is_joined else None)
    return table


def _facts(record: RunRecord) -> Iterator[tuple[str, str]]:
    from wheelsight.app.cli.console import percent
    from wheelsight.app.run.words import times
    from wheelsight_report import summarise

    summary = summarise(record)
    digits = ".1f" if summary.unit == "frame" else ".4f"
    yield f"{summary.unit}s", f"{summary.posed} of {summary.frames} with a pose ({percent(summary.pose_share)})"
    if record.drops is not None and record.drops.total:
        yield "dropped", record.drops.sentence
    for why, count in summary.skips:
        yield "skipped", f"{count} × {why}"
    for why, count in summary.failures:
        yield "no pose", f"{count} × {why}"
    if summary.lost_episodes:
        yield "lost", f"{times(summary.lost_episodes)}, for {summary.lost_s:.2f} s in all"
    yield "way", f"{summary.length_m:.2f} m in {summary.duration_s:.2f} s"
    yield (
        f"time a {summary.unit}",
        f"median {1e3 * summary.median_s:{digits}} ms, 95 % within {1e3 * summary.p95_s:{digits}} ms",
    )
    if record.evaluation is None:
        yield "not evaluated", record.evaluation_problem or ""

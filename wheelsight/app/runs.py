"""A run with its page: the function that most users call."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from wheelsight.app import run as pipeline
from wheelsight.app.run import FrameRecord, RunRecord
from wheelsight.app.run.track import Watcher
from wheelsight.config import Config
from wheelsight.core.errors import ConfigError
from wheelsight.core.files import StrPath
from wheelsight.core.robots import EventSource
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.slam.place_recognition import LoopDetector
from wheelsight.vision.visual_odometry import VisualOdometry
from wheelsight_report import why_no_page, write_page


def run(
    source: EventSource,
    config: Config,
    out: StrPath,
    *,
    force: bool = False,
    on_frame: Callable[[FrameRecord], None] | None = None,
    duration_s: float | None = None,
    visual_odometry: VisualOdometry | None = None,
    loop_detector: LoopDetector | None = None,
) -> RunRecord:
    """Follow events to their end and leave trajectory, status, metrics, configuration and report in the folder `out`.

    Wheels and a camera are joined, as `wheelsight run` joins them: then each odometry alone and the joined sensors have
    a folder of their own below `out`, and the record is that of the joined ones.

    The report needs plotly, which the extra `report` brings; without it all else is done. What was tracked until
    Ctrl-C, or until the source breaks off, is written before the exception goes on.

    Args:
        source: a recording, also one `in_real_time`, or what gives events from elsewhere, without an end.
        config: all settings; where it names no odometry, all sensors of the source are joined.
        out: folder for the results; made if need be.
        force: write into a folder that holds something already.
        on_frame: called after each frame that is answered, for a progress bar.
        duration_s: duration of the run from the first event, by stamps; None: until the source ends.
        visual_odometry, loop_detector: parts of your own, as of `Localizer`.

    Raises:
        ConfigError: the configuration names several odometries that are not joined.
        InputError: as `pipeline.run_each`.
    """
    parts = OwnParts(visual_odometry, loop_detector)
    config = pipeline.resolved(source, config, parts)
    if len(config.tracks) > 1 and config.tracks[-1] not in ("joined", "rectified"):
        raise ConfigError(f"run follows one track, not {' and '.join(config.tracks)}", fix="use run_each")
    main = config.tracks[-1]

    def on_event(answers: Mapping[str, FrameRecord]) -> None:
        if on_frame is not None and main in answers:
            on_frame(answers[main])

    records = run_each(source, config, out, force=force, on_event=on_event, duration_s=duration_s, parts=parts)
    return records[-1]


def run_each(
    source: EventSource,
    config: Config,
    out: StrPath,
    *,
    force: bool = False,
    on_ready: Callable[[], None] = lambda: None,
    on_code: Callable[[int, int], None] = lambda done, total: None,
    on_event: Callable[[Mapping[str, FrameRecord]], None] | None = None,
    duration_s: float | None = None,
    watcher: Watcher | None = None,
    parts: OwnParts = NO_PARTS,
) -> tuple[RunRecord, ...]:
    """`pipeline.run_each`, which says all about it, with one page of everything: `report.html` in `out`.

    Without plotly, which the extra `report` brings, all is done but the page.
    """
    draw = write_page if why_no_page() is None else None
    return pipeline.run_each(
        source,
        config,
        out,
        force=force,
        on_ready=on_ready,
        on_code=on_code,
        on_event=on_event,
        draw=draw,
        duration_s=duration_s,
        watcher=watcher,
        parts=parts,
    )

"""A run in a few verbs: check, follow, judge, write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from wheelsight.config import Config
from wheelsight.errors import ConfigError
from wheelsight.files import StrPath, make_output_folder
from wheelsight.localizer import Localizer
from wheelsight.pipeline.outputs import write_results
from wheelsight.pipeline.places import PlacesOfRun, places_of
from wheelsight.pipeline.realtime import RealTimeRecording
from wheelsight.pipeline.records import records_of
from wheelsight.pipeline.track import UNITS, follow
from wheelsight.recordings import Recording
from wheelsight.recordings.clocks import refuse_if_apart
from wheelsight.report import FrameRecord, RunRecord


def run(
    recording: Recording,
    config: Config,
    out: StrPath,
    *,
    force: bool = False,
    on_frame: Callable[[FrameRecord], None] | None = None,
) -> RunRecord:
    """Track a whole recording and leave trajectory, status, metrics, configuration and report in the folder `out`.

    Ctrl-C, or a recording that breaks off, loses nothing: what was tracked until then is written and marked
    as interrupted, and then the exception goes on its way.

    Args:
        recording: from `open_recording`; or from `in_real_time`, then frames may be dropped.
        config: all settings; of one odometry, without places.
        out: folder for the results; made if need be.
        force: write into a folder that holds something already.
        on_frame: called after each frame, for a progress bar.

    Raises:
        ConfigError: the configuration names several odometries or places, or the recording has no images, or no wheel
            readings, that the odometry asked for needs.
        CalibrationError: the calibration lacks its cameras, or its wheels.
        OutputError: `out` is not empty and `force` is off, or cannot be written; tried before the long work.
        RecordingError: the recording cannot be read on; or wheels and camera, which are to be joined, share no time.
    """
    out = Path(out)
    if len(config.tracks) > 1:
        raise ConfigError(f"run follows one track, not {' and '.join(config.tracks)}", fix="use run_each")

    def on_event(answers: Mapping[str, FrameRecord]) -> None:
        for frame in answers.values():
            if on_frame is not None:
                on_frame(frame)

    (record,) = run_each(recording, config, out, force=force, on_event=on_event)
    return record


def run_each(
    recording: Recording,
    config: Config,
    out: StrPath,
    *,
    force: bool = False,
    on_ready: Callable[[], None] = lambda: None,
    on_event: Callable[[Mapping[str, FrameRecord]], None] | None = None,
) -> tuple[RunRecord, ...]:
    """Run every odometry that `config` names over one pass of the recording, each alone, and report them together.

    One odometry leaves what `run` does. Of several, each has its trajectory, status and metrics in a folder of its
    name, and `out` holds metrics, configuration and one report of all. Wheels that places rectify are followed twice,
    alone and as "rectified".

    Ctrl-C before the first answer leaves nothing.

    Args:
        on_ready: called once all is checked and `out` is made, before the first event.
        on_event: called after each event that was answered, with each odometry's answer by its name.
        recording, config, out, force: as in `run`.

    Raises:
        As `run`, for any of the odometries; and AreaError or PlaceError, for places.
    """
    out = Path(out)
    places = _check(recording, config)
    folder = make_output_folder(out, force)
    on_ready()
    passage = follow(recording, config, on_event, None if places is None else places.places)
    if isinstance(passage.interruption, KeyboardInterrupt) and not any(track.frames for track in passage.tracks):
        raise passage.interruption
    records = records_of(passage, recording, config, places)
    write_results(records, passage, recording, config, folder)
    if passage.interruption is not None:
        raise passage.interruption
    return records


def _check(recording: Recording, config: Config) -> PlacesOfRun | None:
    """Refuse what cannot end well, before anything is written; places, if they are asked for."""
    wheels = recording.wheels if isinstance(recording, RealTimeRecording) else None
    if wheels is not None and (config.odometry == ("wheels",) or "wheels" not in config.odometry):
        raise ConfigError(f"wheels from {wheels.where} are played beside a camera", fix="--odometry wheels,dense")
    for odometry in config.odometry:
        if UNITS[odometry] == "reading" and wheels is None and not recording.wheel_count:
            raise ConfigError(f"{recording.path}: the recording has no wheel readings", fix="--odometry features")
        if UNITS[odometry] == "frame" and recording.wheel_count and not recording.frame_count:
            raise ConfigError(f"{recording.path}: the recording has no images", fix="--odometry wheels")
        Localizer(recording.calibration, config.alone(odometry))
    if wheels is None and {"joined", "rectified"} & set(config.tracks):
        refuse_if_apart(recording.played if isinstance(recording, RealTimeRecording) else recording)
    places = places_of(recording, config)
    if config.fusion.filter != "none":
        Localizer(recording.calibration, config, None if places is None else places.places)
    return places

"""A run in a few verbs: check, follow, judge, write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from wheelsight.config import Config
from wheelsight.errors import ConfigError
from wheelsight.files import StrPath, make_output_folder
from wheelsight.localizer import Localizer
from wheelsight.pipeline.outputs import Draw, write_results
from wheelsight.pipeline.places import PlacesOfRun, places_of
from wheelsight.pipeline.realtime import RealTimeRecording
from wheelsight.pipeline.records import records_of
from wheelsight.pipeline.run_record import FrameRecord, RunRecord
from wheelsight.pipeline.track import UNITS, follow
from wheelsight.recordings import Recording
from wheelsight.recordings.clocks import refuse_if_apart


def run_each(
    recording: Recording,
    config: Config,
    out: StrPath,
    *,
    force: bool = False,
    on_ready: Callable[[], None] = lambda: None,
    on_event: Callable[[Mapping[str, FrameRecord]], None] | None = None,
    draw: Draw | None = None,
) -> tuple[RunRecord, ...]:
    """Run every odometry that `config` names over one pass of the recording, each alone, and report them together.

    One odometry leaves trajectory, status, metrics and configuration in the folder `out`. Of several, each has its
    trajectory, status and metrics in a folder of its name, and `out` holds metrics and configuration of all. Wheels
    that places rectify are followed twice, alone and as "rectified".

    Ctrl-C, or a recording that breaks off, loses nothing: what was tracked until then is written and marked as
    interrupted, and then the exception goes on its way. Ctrl-C before the first answer leaves nothing.

    Args:
        recording: from `open_recording`; or from `in_real_time`, then frames may be dropped.
        config: all settings.
        out: folder for the results; made if need be.
        force: write into a folder that holds something already.
        on_ready: called once all is checked and `out` is made, before the first event.
        on_event: called after each event that was answered, with each odometry's answer by its name.
        draw: writes a page of the records to a path, such as `report.write_page`; None: no page.

    Raises:
        ConfigError: the recording has no images, or no wheel readings, that an odometry asked for needs.
        CalibrationError: the calibration lacks its cameras, or its wheels.
        AreaError, PlaceError: places cannot be read, or do not fit.
        OutputError: `out` is not empty and `force` is off, or cannot be written; tried before the long work.
        RecordingError: the recording cannot be read on; or wheels and camera, which are to be joined, share no time.
    """
    out = Path(out)
    places = _check(recording, config)
    folder = make_output_folder(out, force)
    on_ready()
    passage = follow(recording, config, on_event, None if places is None else places.places)
    if isinstance(passage.interruption, KeyboardInterrupt) and not any(track.frames for track in passage.tracks):
        raise passage.interruption
    records = records_of(passage, recording, config, places)
    write_results(records, passage, recording, config, folder, draw)
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
    if config.fusion != "none":
        Localizer(recording.calibration, config, None if places is None else places.places)
    return places

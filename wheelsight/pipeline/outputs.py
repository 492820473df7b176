"""The files that a run leaves."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from wheelsight.config import Config, TrackName, save_config
from wheelsight.files import make_output_folder, output_error, write_text
from wheelsight.mapping import save_map
from wheelsight.pipeline.covariances import COVARIANCES_FILE, write_covariances
from wheelsight.pipeline.kept_maps import kept_surfels
from wheelsight.pipeline.loops import CORRECTED_FILE, JUDGED_FILE, judged_csv
from wheelsight.pipeline.maps import MAP_FILE
from wheelsight.pipeline.metrics import joint_metrics, metrics_of
from wheelsight.pipeline.places import looks_csv
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.pipeline.track import Passage
from wheelsight.slam.sessions import MAP_FOLDER, discard_map
from wheelsight.sources import EventSource
from wheelsight.trajectory import write_tum

PAGE_FILE = "report.html"
STATUS_FILE, METRICS_FILE, TRAJECTORY_FILE = "status.csv", "metrics.json", "trajectory.txt"
ODOM_FILE = "odom.txt"
_OF_ONE = (
    TRAJECTORY_FILE,
    ODOM_FILE,
    COVARIANCES_FILE,
    STATUS_FILE,
    METRICS_FILE,
    "areas.csv",
    CORRECTED_FILE,
    JUDGED_FILE,
    MAP_FILE,
)


Draw = Callable[[Sequence[RunRecord], Path], None]


def write_results(
    records: Sequence[RunRecord],
    passage: Passage,
    source: EventSource,
    config: Config,
    folder: Path,
    draw: Draw | None = None,
) -> None:
    """Everything about a run: of one odometry into `folder`, of several each into a folder of its name and all joined.

    `draw` writes the page of it all. What an earlier run left there under these names goes. Raises OutputError.
    """
    if (folder / "config.yaml").exists():  # a run's folder, not just any
        _forget_others(records, folder)
    save_config(config, folder / "config.yaml")
    if len(records) == 1:
        _write_one(records[0], passage, source, folder)
    else:
        for record in records:
            _write_one(record, passage, source, make_output_folder(folder / record.odometry, force=True), records)
        _write_json(joint_metrics(records, passage, source), folder / METRICS_FILE)
    if draw is None:
        _forget(folder / PAGE_FILE)
    else:
        draw(records, folder / PAGE_FILE)


def _forget_others(records: Sequence[RunRecord], folder: Path) -> None:
    """Remove the results of odometries that this run does not have, lest they be taken for its own."""
    kept = {folder} if len(records) == 1 else {folder / record.odometry for record in records}
    for place in {folder, *(folder / name for name in get_args(TrackName))} - kept:
        try:
            for name in _OF_ONE:
                (place / name).unlink(missing_ok=True)
            discard_map(place / MAP_FOLDER)
            if place.is_dir() and place != folder and not any(place.iterdir()):
                place.rmdir()
        except OSError as error:
            raise output_error(error, place) from error


def _write_one(
    record: RunRecord, passage: Passage, source: EventSource, folder: Path, records: Sequence[RunRecord] = ()
) -> None:
    _forget(folder / COVARIANCES_FILE)  # first: no table is left of another run's poses
    write_tum(record.estimate, folder / TRAJECTORY_FILE)
    if record.odom is None:
        _forget(folder / ODOM_FILE)
    else:
        write_tum(record.odom, folder / ODOM_FILE)
    if record.estimate.covariances is not None:
        write_covariances(record.estimate, folder / COVARIANCES_FILE)
    write_text(folder / STATUS_FILE, _status_csv(record))
    if record.rectification is not None:
        write_text(folder / "areas.csv", looks_csv(record.rectification))
    _write_correction(record, folder)
    _write_map(record, passage, folder / MAP_FILE)
    _write_json(metrics_of(record, passage, source, records), folder / METRICS_FILE)


def _write_correction(record: RunRecord, folder: Path) -> None:
    """The way as known at its end, and what became of each match; what an earlier run left in their place goes."""
    if record.correction is None:
        _forget(folder / CORRECTED_FILE)
        _forget(folder / JUDGED_FILE)
    else:
        write_tum(record.correction.found.corrected, folder / CORRECTED_FILE)
        write_text(folder / JUDGED_FILE, judged_csv(record.correction))


def _write_map(record: RunRecord, passage: Passage, path: Path) -> None:
    """The map of a run that has one, unless its map folder holds it; what an earlier run left in its place goes."""
    (track,) = (track for track in passage.tracks if track.odometry == record.odometry)
    if record.kept_map is None:
        discard_map(path.with_name(MAP_FOLDER))
    if record.map is not None and track.localizer.map is not None and kept_surfels(track) is None:
        save_map(track.localizer.map, path)
    else:
        _forget(path)


def _forget(path: Path) -> None:
    """Remove what an earlier run left there, if anything."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise output_error(error, path) from error


def _write_json(figures: dict[str, Any], path: Path) -> None:
    write_text(path, json.dumps(figures, indent=2, allow_nan=False) + "\n")


def _status_csv(record: RunRecord) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        ["stamp_s", "status", "reason", "matches", "inliers", "time_ms", "flags", "note", "dropped", "left_out"]
    )
    dropped = [frame.overtaken + frame.is_unread for frame in record.frames]
    if dropped and record.drops is not None:
        dropped[-1] += record.drops.total - sum(dropped)  # those after it, and those that never became a frame
    left_out = [""] * len(record.frames)
    if left_out:  # of the recording as a whole: which row it was before is not known
        left_out[-1] = "; ".join(f"{count} of {of}: {why}" for why, (count, of) in record.left_out.items())
    for frame, lost, gone in zip(record.frames, dropped, left_out, strict=True):
        counts = (frame.matches, frame.inliers, f"{1e3 * frame.seconds:.3f}")
        # as in trajectory.txt, so that rows can be joined
        stamp = np.format_float_positional(frame.stamp_s, min_digits=6)
        rows.writerow([stamp, frame.status, frame.reason or "", *counts, ";".join(frame.flags), frame.note, lost, gone])
    return text.getvalue()

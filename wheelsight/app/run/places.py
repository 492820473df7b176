"""Areas of a run: its model, areas and start before the run, and the record of the rectified path after it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.app.run import words
from wheelsight.app.run.run_record import AreaObservation, MapErrors, RectificationRecord
from wheelsight.app.run.run_source import frame_count_of, path_of, where
from wheelsight.config import Config
from wheelsight.core.errors import CalibrationError, ConfigError, PlaceError
from wheelsight.core.geometry import se3
from wheelsight.core.messages import WheelReading
from wheelsight.core.robots import EventSource
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Places, load_places
from wheelsight.io.recordings import Recording, express_for
from wheelsight.places import PlaceModel

_MAX_GAP_S = 0.5  # no interpolation between true poses that are further apart
_AREAS = "areas.yaml"


@dataclass(frozen=True, slots=True, eq=False)
class PlacesOfRun:
    """The areas of a run: `Places`, a sentence on the source of its start, and whether the truth gives the start."""

    places: Places
    start: str
    is_start_true: bool


def places_of(source: EventSource, config: Config) -> PlacesOfRun | None:
    """Model, areas and start of a run whose configuration names a model; None for other runs.

    Raises:
        ConfigError: the recording has no images, no areas are found, or no start is known.
        AreaError, PlaceError: an invalid file, a model of other areas or of images of another size.
    """
    settings = config.places
    if settings.model is None:
        return None
    if frame_count_of(source) == 0:
        raise ConfigError(f"{where(source)}: the recording has no images that could show places", fix="no --places")
    # The file of areas: as given, or beside the recording
    if settings.areas is not None:
        areas = Path(settings.areas)
    else:
        folder = path_of(source)
        if folder is None or not (folder / _AREAS).exists():
            raise ConfigError(f"{where(source)}: the recording has no {_AREAS}", fix="give --areas FILE")
        areas = folder / _AREAS
    if settings.start is not None:
        places = load_places(settings, areas)
        sentence = "The start is the one that was given"
    else:
        # The true planar pose of the base, at the first reading or at the beginning of the truth
        unknown, fix = f"{where(source)}: where the robot starts is not known", "give --start X,Y,YAW_DEG"
        if not isinstance(source, Recording) or source.ground_truth is None or not len(source.ground_truth):
            raise ConfigError(f"{unknown}: no ground truth", fix=fix)
        try:
            truth = express_for("base", source.ground_truth, source.calibration)
        except CalibrationError as error:
            raise ConfigError(f"{unknown}: {error.problem}", fix=fix) from error
        delay_s = 0.0 if (wheels := source.calibration.any_wheels) is None else wheels.delay_s
        stamps_s = (e.stamp_s - delay_s for e in source.events(images=False) if isinstance(e, WheelReading))
        begin_s = max(next(stamps_s, -np.inf), float(truth.stamps_s[0]))
        T = truth.at([begin_s], _MAX_GAP_S)[0]
        if not np.isfinite(T).all():
            raise ConfigError(f"{unknown}: no ground truth at {begin_s:.3f} s", fix=fix)
        T_odom_base = se3.from_plane(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0]))
        places = load_places(settings, areas, T_odom_base, begin_s)
        sentence = "The start was taken from the ground truth, which a robot on its own does not have"
    _check_size(places.model, source)
    x_m, y_m = places.T_odom_base[:2, 3].round(2) + 0.0  # no minus before a zero
    yaw_deg = np.degrees(np.arctan2(places.T_odom_base[1, 0], places.T_odom_base[0, 0])).round(1) + 0.0
    start_text = f"{sentence}: x {x_m:.2f} m, y {y_m:.2f} m, yaw {yaw_deg:.1f}°."
    return PlacesOfRun(places, start_text, settings.start is None)


def rectification_of(
    run: PlacesOfRun,
    way: str,
    looks: tuple[AreaObservation, ...],
    wheels: Trajectory,
    rectified: Trajectory,
    truth: Trajectory | None,
) -> RectificationRecord:
    """The record of the wheels rectified by areas, for a finished run.

    Args:
        run: from `places_of`.
        way: "probabilistic" or "paper".
        looks: one for each frame.
        wheels: T_odom_base of the wheels alone.
        rectified: T_odom_base.
        truth: T_odom_base, or None.
    """
    # The wheels alone, from the start of the rectified path
    later = wheels.between(run.places.begin_s, np.inf)
    if not len(later):
        in_map = Trajectory(later.stamps_s, later.T_frame_body, None, "base", "map")
    else:
        moved = later.moved(run.places.T_odom_base @ se3.invert(later.T_frame_body[0]))
        in_map = Trajectory(moved.stamps_s, moved.T_frame_body, moved.covariances, "base", "map")
    stamps_s = np.array([look.stamp_s for look in looks], float)
    areas = run.places.areas
    record = RectificationRecord(way, areas, looks, in_map, run.start)
    if truth is None or not len(truth) or not len(stamps_s):
        return record
    from wheelsight_papers.dataset import labels_on_the_way

    true_areas = labels_on_the_way(areas, truth, stamps_s, _MAX_GAP_S)
    paths = [
        (path.at(stamps_s, _MAX_GAP_S)[:, :2, 3] if len(path) else np.full((len(stamps_s), 2), np.nan))
        for path in (truth, in_map, rectified)
    ]
    known = np.isfinite(np.concatenate(paths, axis=1)).all(axis=1)
    if not known.any():
        errors = None
    else:
        true_xy, *others = (xy[known] for xy in paths)
        errors = MapErrors(stamps_s[known], *(np.hypot(*(xy - true_xy).T) for xy in others))
    return RectificationRecord(way, areas, looks, in_map, run.start, true_areas, errors)


def looks_csv(record: RectificationRecord) -> str:
    """Rows of stamp_s, area (empty if unknown), probabilities by model and filter, trust, and note.

    `wheelsight.places.read_labels` reads its first two columns.
    """
    names = record.areas.names
    head = ["stamp_s", "area", *(f"p({n})" for n in names), *(f"belief({n})" for n in names), "trust", "note"]
    rows = []
    empty = ("",) * len(names)
    for look in record.looks:
        cells = [empty if p is None else [f"{x:.4f}" for x in p] for p in (look.probabilities, look.belief)]
        trust = f"{look.trust:.4f}" if np.isfinite(look.trust) else ""
        named = names[look.named] if look.named >= 0 else ""
        rows.append([words.stamp(look.stamp_s), named, *cells[0], *cells[1], trust, look.note])
    return words.csv_text(head, rows)


def _check_size(model: PlaceModel, source: EventSource) -> None:
    color, depth = source.calibration.color, source.calibration.depth or source.calibration.color
    if model.frame_size is None or color is None or depth is None:
        return
    given = color.height, color.width, depth.height, depth.width
    of_images, wanted = ("{1}x{0} with depth {3}x{2}".format(*size) for size in (given, model.frame_size))
    if of_images != wanted:
        problem = f"{where(source)}: images are {of_images}; the model was trained on {wanted}"
        raise PlaceError(problem, fix="use one camera at one resolution, or train a model for this one")

"""Zhang, ICP-based Navigation System for the HSR: Table 2 and the figures of the trajectory and its error.

Prints the statistics of a TUM sequence, beside the paper's where it is freiburg1_desk, and draws
`ground_truth.png` and, with an estimate, `absolute_error.png`. The estimate comes from a file or, where the
sequence is a recording with images, from wheelsight's feature odometry, which follows the paper's section 3; of the
paper's sequence dense odometry and the map are tracked, too, and stand beside what others have published.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wheelsight.core.errors import InputError, WheelsightError
from wheelsight.core.files import atomic_write, make_output_folder
from wheelsight.core.geometry import FloatArray
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.evaluation import AbsoluteError, Evaluation, SequenceStatistics, evaluate, sequence_statistics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EXAMPLES = """examples:
  python papers/zhang_hsr.py
      track $WHEELSIGHT_DATA/rgbd/rgbd_dataset_freiburg1_desk in each way, print Table 2 and the errors beside published
      ones, draw both figures into ./zhang_hsr
  python papers/zhang_hsr.py freiburg1_desk.txt
      Table 2 and the ground truth's figure of a ground-truth file
  python papers/zhang_hsr.py groundtruth.txt --estimate trajectory.txt --out figures
      the same, and the error of an estimate made elsewhere
"""

PAPER_SEQUENCE = "freiburg1_desk"
PAPER_TABLE_2 = ("23.40 s", "23.35 s", "9.263 m", "", "0.413 m/s", "23.327 °/s", "2.42 × 1.34 × 0.66 m")

# What others have published of the whole sequence, ATE RMSE in metres; all but ElasticFusion close loops.
PUBLISHED = {"ORB-SLAM2": 0.016, "ElasticFusion": 0.020, "DVO-SLAM": 0.021, "RTAB-Map": 0.029}
FEATURES = "features"  # which follow the paper's section 3
OURS: dict[str, dict[str, object]] = {
    FEATURES: {"odometry": "features"},
    "dense": {"odometry": "dense"},
    "dense with surfels": {"odometry": "dense", "map": "surfels"},
}

LEAP_S = 0.5
LEAST_SHAPE = 0.8  # width over height of the two views together
INK, BLUE, RED, PALE = "#222222", "#1f6fb4", "#c8372d", "#dddddd"


def main(arguments: list[str] | None = None) -> int:
    """Run the script; returns 0, or 2 after a one-line error."""
    options = _parser().parse_args(arguments)
    try:
        reproduce(options.sequence, options.estimate, options.out, options.force)
    except WheelsightError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def reproduce(sequence: Path, estimate_file: Path | None, out: Path, force: bool) -> None:
    """Print the table and write the figures of a TUM folder or ground-truth file into the folder `out`."""
    truth, name = read_sequence(sequence)
    folder = make_output_folder(out, force)
    print(table_2(sequence_statistics(truth), name))
    save(ground_truth_figure(truth, name), folder / "ground_truth.png")
    estimates = {"estimate": read_tum(estimate_file)} if estimate_file else track(sequence, name, folder / "run", force)
    if not estimates:
        return
    found = {way: evaluate(estimate, truth) for way, estimate in estimates.items()}
    shown = next(iter(found.values()))
    print(error_table(shown))
    if PAPER_SEQUENCE in name:
        print(published_table(found))
    save(absolute_error_figure(shown.ate, name), folder / "absolute_error.png")


def read_sequence(sequence: Path) -> tuple[Trajectory, str]:
    """The ground truth of a TUM folder or of a ground-truth file, and the sequence's name."""
    path = sequence / "groundtruth.txt" if sequence.is_dir() else sequence
    if sequence.is_dir() and not path.is_file():
        raise InputError("has no groundtruth.txt", path=sequence, fix="give a TUM folder or a ground-truth file")
    name = sequence.resolve().name if sequence.is_dir() else sequence.stem
    return read_tum(path), name.removesuffix("groundtruth").rstrip("-_") or name


def track(sequence: Path, name: str, out: Path, force: bool) -> dict[str, Trajectory]:
    """What feature odometry makes of it, and of the paper's sequence the others too; none without images."""
    if not (sequence / "rgb.txt").is_file():
        return {}
    from wheelsight import run
    from wheelsight.config import load_config
    from wheelsight.io.recordings import open_recording

    recording = open_recording(sequence)
    print(f"\ntracking {recording.frame_count} frames of {recording.name} ...")
    ways = OURS if PAPER_SEQUENCE in name else {FEATURES: OURS[FEATURES]}
    folders = {way: out if way == FEATURES else out / way.replace(" ", "_") for way in ways}
    records = {way: run(recording, load_config(overrides=of), folders[way], force=force) for way, of in ways.items()}
    return {way: record.estimate for way, record in records.items() if record.estimate is not None}


def published_table(found: dict[str, Evaluation]) -> str:
    """The absolute errors beside those that others have published of the paper's sequence."""
    lines = ["\nATE, RMSE, beside what others have published", f"  {'':32}{'RMSE':>10}{'poses':>8}"]
    lines += [f"  {way:32}{of.ate.translation.rmse:8.4f} m{of.pairs:8d}" for way, of in found.items()]
    lines += [f"  {f'{system}, published':32}{rmse_m:8.4f} m" for system, rmse_m in PUBLISHED.items()]
    return "\n".join(lines)


def table_2(s: SequenceStatistics, name: str) -> str:
    """Table 2 as text, with the paper's column where the sequence is the paper's."""
    labels = (
        "Duration",
        "Duration with ground truth",
        f"Length, in steps of {s.window_s:g} s",
        "Length, through all poses",
        "Avg. translational velocity",
        "Avg. angular velocity",
        "Trajectory dim.",
    )
    found = (
        f"{s.duration_s:.2f} s",
        f"{s.posed_duration_s:.2f} s",
        f"{s.windowed_length_m:.3f} m",
        f"{s.length_m:.3f} m",
        f"{s.mean_speed_m_per_s:.3f} m/s",
        f"{np.degrees(s.mean_angular_speed_rad_per_s):.3f} °/s",
        " × ".join(f"{extent:.2f}" for extent in s.extent_m) + " m",
    )
    paper = PAPER_TABLE_2 if PAPER_SEQUENCE in name else ("",) * len(labels)
    heads = ("wheelsight", "Zhang" if PAPER_SEQUENCE in name else "")
    lines = [f"Table 2: {name}", f"  {'':28}{heads[0]:>22}{heads[1]:>22}"]
    lines += [f"  {label:28}{a:>22}{b:>22}" for label, a, b in zip(labels, found, paper, strict=True)]
    return "\n".join(line.rstrip() for line in lines)


def error_table(found: Evaluation) -> str:
    """The benchmark's errors as text."""
    errors = {"ATE": found.ate, "RPE per frame": found.rpe_per_frame, "RPE per second": found.rpe_per_second}
    lines = [f"\nErrors of {found.pairs} poses", f"  {'':16}{'RMSE':>10}{'median':>10}{'max':>10}"]
    for label, error in errors.items():
        if error is None:
            continue
        metres, degrees = error.translation, error.rotation.in_degrees()
        lines.append(f"  {label:16}{metres.rmse:8.4f} m{metres.median:8.4f} m{metres.max:8.4f} m")
        lines.append(f"  {'':16}{degrees.rmse:8.3f} °{degrees.median:8.3f} °{degrees.max:8.3f} °")
    return "\n".join(lines)


def ground_truth_figure(truth: Trajectory, name: str) -> Figure:
    """The true trajectory from above and from the side, coloured by time (Zhang, Fig. 4 of the experiments)."""
    low, high = _room_around(truth.positions_m)
    wide, deep, tall = high - low
    figure = _figure(7.2, float(np.clip(5.6 * (deep + tall) / wide + 1.6, 4.8, 9.6)))
    above, side = figure.subplots(2, 1, sharex=True, height_ratios=(deep, tall))
    elapsed_s = truth.stamps_s - truth.stamps_s[0]
    for axes, vertical in ((above, 1), (side, 2)):
        x, y = truth.positions_m[:, 0], truth.positions_m[:, vertical]
        dots = axes.scatter(x, y, c=elapsed_s, s=4, cmap="viridis", linewidths=0)
        for k, marker, label in ((0, "o", "start"), (-1, "s", "end")):
            axes.plot(x[k], y[k], marker, color="white", markeredgecolor=INK, markersize=7, label=label, linestyle="")
        _label(axes, "xyz"[vertical])
        axes.set(xlim=(low[0], high[0]), ylim=(low[vertical], high[vertical]), aspect="equal")
    extent = " × ".join(f"{metres:.2f}" for metres in np.ptp(truth.positions_m, axis=0))
    above.set_title(f"Ground-truth trajectory of {name}\n{extent} m, {truth.duration_s:.1f} s", loc="left")
    above.legend(loc="best", frameon=False)
    side.set_xlabel("x (m)")
    figure.colorbar(dots, ax=[above, side], label="time (s)", shrink=0.8, pad=0.02)
    return figure


def absolute_error_figure(error: AbsoluteError, name: str) -> Figure:
    """Truth, estimate and their difference from above, and the error over time (Zhang, Fig. 5 of the experiments)."""
    from matplotlib.collections import LineCollection

    figure = _figure(7.2, 8.2)
    above, over_time = figure.subplots(2, 1, height_ratios=(3.2, 1))
    for label, trajectory, color in (("ground truth", error.truth, INK), ("estimate", error.aligned, BLUE)):
        x, y, _ = broken_at_gaps(trajectory.stamps_s, trajectory.positions_m).T
        above.plot(x, y, color=color, linewidth=1.3, label=label)
    ends = np.stack([error.truth.positions_m, error.aligned.at(error.stamps_s)[:, :3, 3]], axis=1)[..., :2]
    above.add_collection(LineCollection(list(ends), colors=RED, linewidths=0.7, zorder=1.5, label="difference"))
    _label(above, "y")
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel("x (m)")
    s = error.translation
    above.set_title(f"Absolute trajectory error on {name}\nRMSE {s.rmse:.3f} m, max {s.max:.3f} m", loc="left")
    above.legend(loc="best", frameon=False)
    elapsed_s = error.stamps_s - error.stamps_s[0]
    over_time.plot(*broken_at_gaps(elapsed_s, np.stack([elapsed_s, error.errors_m], 1)).T, color=RED, linewidth=1)
    over_time.axhline(s.rmse, color=INK, linewidth=0.8, linestyle="--", label="RMSE")
    over_time.set(xlabel="time (s)", ylabel="error (m)", ylim=(0, None))
    over_time.margins(x=0)
    over_time.legend(loc="upper right", frameon=False)
    over_time.spines[["top", "right"]].set_visible(False)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, atomically, and say so."""
    with atomic_write(path, "wb") as stream:
        figure.savefig(stream, format="png", dpi=160)
    print(f"wrote {path}")


def broken_at_gaps(stamps_s: FloatArray, values: FloatArray) -> FloatArray:
    """Values (N, K) with a row of NaN wherever stamps (N,) leap, so that no line is drawn where nothing is known."""
    leaps = np.flatnonzero(np.diff(stamps_s) > LEAP_S) + 1
    return np.insert(values, leaps, np.nan, axis=0)


def _figure(width_in: float, height_in: float) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("matplotlib is missing", fix="pip install matplotlib") from error
    return Figure(figsize=(width_in, height_in), layout="constrained")


def _label(axes: Axes, vertical: str) -> None:
    axes.set_ylabel(f"{vertical} (m)")
    axes.grid(color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _room_around(positions_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest x, y, z to draw: all positions, some air, and no direction too thin to be read."""
    middle, extent = (positions_m.max(axis=0) + positions_m.min(axis=0)) / 2, np.ptp(positions_m, axis=0)
    half = 0.55 * np.maximum(extent, max(0.2 * extent.max(), 0.01))
    half[0] = max(half[0], LEAST_SHAPE * (half[1] + half[2]))  # beside a tall path the title has no room
    return middle - half, middle + half


def _data_folder() -> Path:
    """Where real recordings are kept: WHEELSIGHT_DATA, else ../shared/data beside the project."""
    beside = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    return Path(os.environ.get("WHEELSIGHT_DATA") or beside)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "sequence",
        type=Path,
        nargs="?",
        default=_data_folder() / "rgbd" / f"rgbd_dataset_{PAPER_SEQUENCE}",
        help="folder of a TUM recording, or a ground-truth file (the paper's, in $WHEELSIGHT_DATA)",
    )
    parser.add_argument("--estimate", type=Path, help="trajectory in TUM text; else the recording is tracked")
    parser.add_argument("--out", type=Path, default=Path("zhang_hsr"), help="folder for the figures (%(default)s)")
    parser.add_argument("--force", action="store_true", help="write into a folder that holds something already")
    return parser


if __name__ == "__main__":
    sys.exit(main())

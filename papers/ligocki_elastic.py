"""Ligocki, Methods for SLAM for Depth Cameras: Fig. 1's kind of picture, the model of a place made by a depth camera.

The paper shows the model of a laboratory, made by ElasticFusion and a Kinect v2, and gives no numbers. Here a real
recording and a simulated drive of two laps through a flat are mapped with surfels; each leaves a picture of its model
from outside, the camera's way and its last frame in it, and a line of numbers. The paper says that closing loops "often
fails"; here the flat is mapped with and without, and both models stand side by side.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from _ligocki_view import Viewpoint, frustum_of, outside, picture_of

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import EvaluationError, InputError, WheelsightError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.files import atomic_write, make_output_folder, write_text
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.core.messages import RgbdFrame, SkippedFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.evaluation import evaluate
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.mapping import SurfelMap
from wheelsight.mapping.plan import upward
from wheelsight_sim import SimulationSettings, simulate, write_simulation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EXAMPLES = """examples:
  python papers/ligocki_elastic.py
      the red kitchen of $WHEELSIGHT_DATA (or ../shared/data) and a simulated flat, into ./ligocki_elastic
  python papers/ligocki_elastic.py my_recording --azimuth 30
      a recording of yours, seen from elsewhere
"""

PAPER = (
    "Ligocki 2017: a model of a laboratory (Fig. 1), ElasticFusion and a Kinect v2; no error, rate or size is given."
)
REAL = Path("rgbd") / "red_kitchen"
# The whole round through four rooms. Half the Kinect's rate: rendering it takes longer than mapping it.
FLAT = SimulationSettings(world="flat", camera="kinect-v1", size=None, rate_hz=15.0, seed=0, laps=2, realism="real")
HEAD = ("recording", "frames tracked", "surfels", "stable", "ATE RMSE", "frames/s", "map")
_QUALITY = {".jpg": {"quality": 85}}
INK, BLUE, HALO = "#222222", "#0b62d6", "#ffffff"
_FRUSTUM_SHARE = 0.06  # of the distance it is seen from


@dataclass(eq=False)
class Model:
    """A recording and the map made of it.

    Attributes:
        recording: what was seen.
        map: what was made of it.
        has_loops: whether loops were closed on the way.
        stamps_s, T_map_body: of each frame with a pose, the latter (4, 4) as known at the end.
        seconds: of work on each frame.
        frames: how many there were.
        last: colour (h, w, 3) of the last frame with a pose.
    """

    recording: Recording
    map: SurfelMap
    has_loops: bool
    stamps_s: list[float] = field(default_factory=list)
    estimates: list[Estimate] = field(default_factory=list)
    T_map_body: list[FloatArray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    frames: int = 0
    last: ByteArray = field(default_factory=lambda: np.zeros((1, 1, 3), np.uint8))

    @property
    def T_map_camera(self) -> FloatArray:
        """(n, 4, 4)."""
        poses, T_base_camera = np.array(self.T_map_body), self.recording.calibration.T_base_camera
        return poses if T_base_camera is None else poses @ T_base_camera

    @property
    def name(self) -> str:
        """The recording's, and whether loops were closed."""
        return f"{self.recording.name}, loops closed" if self.has_loops else self.recording.name

    @property
    def up(self) -> FloatArray:
        """(3,) of length 1, in the world: known of a robot, else judged by floors and tables."""
        if self.recording.calibration.T_base_camera is not None:
            return np.array([0.0, 0.0, 1.0])
        return upward(lambda: self.map.parts("stable"), self.T_map_camera[0, :3, :3])


@dataclass(frozen=True, eq=False)
class Look:
    """A model seen by `view`: the picture (h, w, 3) and its depth (h, w)."""

    model: Model
    view: Viewpoint
    picture: ByteArray
    depth_m: Float32Array


def main(arguments: list[str] | None = None, flat: SimulationSettings = FLAT) -> int:
    """Run the script; returns 0, or 2 after a one-line error. `flat` is what is simulated."""
    options = _parser().parse_args(arguments)
    try:
        folder = make_output_folder(options.out, options.force)
        looks, rows = [], []
        for recording in _recordings(options.recordings, flat, folder):
            before, after = (mapped(recording, has_loops=has_loops) for has_loops in (False, True))
            rows += [row_of(before), row_of(after)]  # before pictures need more memory than frames do
            looks.append(look_at(after, options.azimuth, options.down))
            save(beside_camera(looks[-1]), folder / f"{recording.name}.png")
            save(
                in_a_row([Look(before, looks[-1].view, *picture_of(before.map, looks[-1].view)), looks[-1]]),
                folder / f"{recording.name}-loops.jpg",
            )
        save(in_a_row(looks), folder / "models.jpg")
        text = table(rows)
        print(f"\n{text}\n\n{PAPER}")
        write_text(folder / "table.md", f"{text}\n")
    except WheelsightError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _recordings(folders: list[Path], flat: SimulationSettings, out: Path) -> Iterator[Recording]:
    """Those named; of none, the real one and the simulated one, which is kept in the folder `out`."""
    data = Path(os.environ.get("WHEELSIGHT_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    for folder in folders or [data / REAL]:
        yield open_recording(folder)
    if not folders:
        yield open_recording(_simulated(flat, out / flat.world))


def _simulated(flat: SimulationSettings, folder: Path) -> Path:
    """The folder, with the drive in it: rendered first, so that mapping has the processor to itself."""
    recording = simulate(flat)
    with _progress() as progress:
        bar = progress.add_task(f"simulating {flat.world}", total=recording.frame_count)
        write_simulation(recording, folder, force=True, on_frame=lambda frame: progress.advance(bar))
    return folder


def mapped(recording: Recording, *, has_loops: bool) -> Model:
    """Track a recording against the surfel map it makes, with wheelsight's defaults.

    Raises:
        InputError: no surfel was seen often enough to be sure of.
    """
    overrides = {"odometry": "dense", "map": "surfels", "loops.source": "keyframes" if has_loops else "none"}
    localizer = Localizer(recording.calibration, load_config(overrides=overrides), waits=True)
    assert localizer.map is not None
    assert localizer.keyframes is not None
    model = Model(recording, localizer.map, has_loops)
    with _progress() as progress:
        for event in progress.track(
            recording.events(), recording.frame_count + recording.wheel_count, description=recording.name
        ):
            _take(model, localizer, event)
    if localizer.loops is not None:
        localizer.loops.finish()
    localizer.close()
    remembered = [estimate.pose_in(localizer.keyframes) for estimate in model.estimates]
    model.T_map_body = [T for T in remembered if T is not None]
    if not model.map.status().stable:
        raise InputError("leaves no map", path=recording.path, fix="give a recording with depth, of a second or more")
    return model


def _take(model: Model, localizer: Localizer, event: Any) -> None:
    started = time.perf_counter()
    estimate = localizer.process(event)
    if not isinstance(event, RgbdFrame | SkippedFrame):
        return
    model.frames += 1
    if estimate is None or estimate.status is not Status.TRACKING or estimate.T_odom_body is None:
        return
    model.seconds.append(time.perf_counter() - started)
    model.stamps_s.append(event.stamp_s)
    model.estimates.append(estimate)
    if isinstance(event, RgbdFrame):
        model.last = event.color


def row_of(model: Model) -> tuple[str, ...]:
    """What the table says of a model, in the order of its head."""
    status = model.map.status()
    return (
        model.name,
        f"{len(model.stamps_s)} of {model.frames}",
        f"{status.surfels:,}",
        f"{status.stable:,}",
        _error(model),
        f"{1 / np.median(model.seconds):.0f}",
        f"{status.memory_bytes / 1e6:.0f} MB",
    )


def _error(model: Model) -> str:
    truth = model.recording.ground_truth
    if truth is None:
        return "no truth"
    try:
        estimate = Trajectory(np.array(model.stamps_s), np.array(model.T_map_body), body=model.recording.body)
        return f"{evaluate(estimate, truth).ate.translation.rmse:.4f} m"
    except EvaluationError:
        return "no truth at these times"


def table(rows: list[tuple[str, ...]]) -> str:
    """As Markdown."""
    lines = [HEAD, tuple("---" for _ in HEAD), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def look_at(model: Model, azimuth_deg: float | None, down_deg: float) -> Look:
    """A model from outside."""
    view = outside(model.map, model.up, model.T_map_camera[0, :3, 2], azimuth_deg, down_deg)
    return Look(model, view, *picture_of(model.map, view))


def beside_camera(look: Look) -> Figure:
    """The model from outside; beside it the camera's last frame, and the model seen from there."""
    last = _last_view(look.model.recording.calibration, look.model.T_map_camera[-1])
    from_there, _ = picture_of(look.model.map, last)
    figure = _figure(11, 6)
    _draw(figure.add_axes((0, 0, 8 / 11, 1)), look)
    pictures = {"the camera's last frame": look.model.last, "the model from there": from_there}
    for (title, image), bottom in zip(pictures.items(), (0.52, 0.04), strict=True):
        axes = figure.add_axes((0.737, bottom, 0.255, 0.42))
        axes.imshow(image)
        axes.set_title(title, loc="left", fontsize=10, color=INK)
        axes.set_axis_off()
    return figure


def in_a_row(looks: Sequence[Look]) -> Figure:
    """All models from outside, side by side."""
    figure = _figure(6.25 * len(looks), 6.25 * 3 / 4)
    for number, look in enumerate(looks):
        _draw(figure.add_axes(((number + 0.004) / len(looks), 0, 0.992 / len(looks), 1)), look)
    return figure


def _draw(axes: Axes, look: Look) -> None:
    """The picture with the camera's way, pale where something stands before it, and the camera at the end."""
    view, T_map_camera = look.view, look.model.T_map_camera
    path = T_map_camera[:, :3, 3]
    px, _ = view.project(path)
    shown = np.where(view.hides(look.depth_m, path)[:, None], np.nan, px)
    axes.imshow(look.picture)
    axes.plot(*px.T, color=BLUE, linewidth=1.2, alpha=0.4)
    axes.plot(*shown.T, color=HALO, linewidth=3.6, solid_capstyle="round")
    axes.plot(*shown.T, color=BLUE, linewidth=2, solid_capstyle="round")
    last = _last_view(look.model.recording.calibration, T_map_camera[-1])
    far_m = _FRUSTUM_SHARE * float(np.linalg.norm(view.T_map_camera[:3, 3] - path[-1]))
    for edge in frustum_of(view, T_map_camera[-1], _corner_slopes(last), far_m):
        axes.plot(*edge.T, color=HALO, linewidth=2.8, solid_capstyle="round")
        axes.plot(*edge.T, color=BLUE, linewidth=1.5, solid_capstyle="round")
    axes.text(0.01, 0.02, look.model.name, transform=axes.transAxes, fontsize=11, color=INK)
    axes.set(xlim=(-0.5, view.size[0] - 0.5), ylim=(view.size[1] - 0.5, -0.5))
    axes.set_axis_off()


def _last_view(calibration: Calibration, T_map_camera: FloatArray) -> Viewpoint:
    """The depth camera, free of distortion."""
    _, camera = calibration.cameras
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    return Viewpoint(T_map_camera, intrinsics, (camera.width, camera.height))


def _corner_slopes(view: Viewpoint) -> list[FloatArray]:
    (width, height), (fx, fy, cx, cy) = view.size, view.intrinsics
    return [np.array([(u - cx) / fx, (v - cy) / fy]) for u, v in ((0, 0), (width, 0), (width, height), (0, height))]


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the name ends in, atomically, and say so."""
    with atomic_write(path, "wb") as stream:
        figure.savefig(stream, format=path.suffix[1:], dpi=160, pil_kwargs=_QUALITY.get(path.suffix, {}))
    print(f"wrote {path}")


def _figure(width_in: float, height_in: float) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("matplotlib is missing", fix="pip install matplotlib") from error
    return Figure(figsize=(width_in, height_in), facecolor="white")


def _progress() -> Any:
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    return Progress(console=console, disable=not console.is_terminal, transient=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", type=Path, nargs="*", help="folders of recordings (red kitchen, simulated flat)")
    parser.add_argument("--azimuth", type=float, help="degrees to the left of the first view, to look from")
    parser.add_argument("--down", type=float, default=40.0, help="degrees to look down (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("ligocki_elastic"), help="folder for results (%(default)s)")
    parser.add_argument("--force", action="store_true", help="write into a folder that holds something already")
    return parser


if __name__ == "__main__":
    sys.exit(main())

"""Ligocki, Methods for SLAM for Depth Cameras: Fig. 1's kind of picture, the model of a place made by a depth camera.

The paper shows the model of a laboratory, made by ElasticFusion and a Kinect v2, and gives no numbers. Here a real
recording and a simulated drive through a flat are mapped with surfels; each leaves a picture of its model from outside,
the camera's way and its last frame in it, and a line of numbers.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from _ligocki_view import Viewpoint, frustum_of, outside, picture_of

from wheelsight.calibration import Calibration
from wheelsight.config import load_config
from wheelsight.errors import EvaluationError, InputError, WheelsightError
from wheelsight.estimates import Status
from wheelsight.evaluation import evaluate
from wheelsight.events import RgbdFrame, SkippedFrame
from wheelsight.files import atomic_write, make_output_folder, write_text
from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.localizer import Localizer
from wheelsight.mapping import SurfelMap
from wheelsight.mapping.upright import upward
from wheelsight.recordings import Recording, open_recording
from wheelsight.simulation import SimulationSettings, simulate
from wheelsight.trajectory import Trajectory

if TYPE_CHECKING:
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
FLAT = SimulationSettings(world="flat", camera="kinect-v1", size=None, rate_hz=15.0, seed=0)
HEAD = ("recording", "frames tracked", "surfels", "stable", "ATE RMSE", "frames/s", "map")
INK, BLUE, HALO = "#222222", "#0b62d6", "#ffffff"
_FRUSTUM_M = 0.45


@dataclass(eq=False)
class Model:
    """A recording and the map made of it.

    Attributes:
        recording: what was seen.
        map: what was made of it.
        stamps_s, T_world_body: of each frame with a pose, the latter (4, 4).
        seconds: of work on each frame.
        frames: how many there were.
        last: colour (h, w, 3) of the last frame with a pose.
    """

    recording: Recording
    map: SurfelMap
    stamps_s: list[float] = field(default_factory=list)
    T_world_body: list[FloatArray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    frames: int = 0
    last: ByteArray = field(default_factory=lambda: np.zeros((1, 1, 3), np.uint8))

    @property
    def T_world_camera(self) -> FloatArray:
        """(n, 4, 4)."""
        poses, T_base_camera = np.array(self.T_world_body), self.recording.calibration.T_base_camera
        return poses if T_base_camera is None else poses @ T_base_camera

    @property
    def up(self) -> FloatArray:
        """(3,) of length 1, in the world: known of a robot, else judged by floors and tables."""
        if self.recording.calibration.T_base_camera is not None:
            return np.array([0.0, 0.0, 1.0])
        return upward(self.map.surfels("stable"), self.T_world_camera[0, :3, :3])


def main(arguments: list[str] | None = None, flat: SimulationSettings = FLAT) -> int:
    """Run the script; returns 0, or 2 after a one-line error. `flat` is what is simulated."""
    options = _parser().parse_args(arguments)
    try:
        folder = make_output_folder(options.out, options.force)
        rows = []
        for recording in _recordings(options.recordings, flat):
            model = mapped(recording)
            rows.append(row_of(model))
            save(figure_of(model, options.azimuth, options.down), folder / f"{recording.name}.png")
        text = table(rows)
        print(f"\n{text}\n\n{PAPER}")
        write_text(folder / "table.md", f"{text}\n")
    except WheelsightError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _recordings(folders: list[Path], flat: SimulationSettings) -> Iterator[Recording]:
    """Those named; of none, the real one and the simulated one."""
    data = Path(os.environ.get("WHEELSIGHT_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
    for folder in folders or [data / REAL]:
        yield open_recording(folder)
    if not folders:
        yield simulate(flat)


def mapped(recording: Recording) -> Model:
    """Track a recording against the surfel map it makes, with wheelsight's defaults.

    Raises:
        InputError: no surfel was seen often enough to be sure of.
    """
    localizer = Localizer(recording.calibration, load_config(overrides={"odometry": "dense", "map": "surfels"}))
    assert localizer.map is not None
    model = Model(recording, localizer.map)
    with _progress() as progress:
        for event in progress.track(
            recording.events(), recording.frame_count + recording.wheel_count, description=recording.name
        ):
            _take(model, localizer, event)
    if not model.map.status().stable:
        raise InputError("leaves no map", path=recording.path, fix="give a recording with depth, of a second or more")
    return model


def _take(model: Model, localizer: Localizer, event: Any) -> None:
    started = time.perf_counter()
    estimate = localizer.process(event)
    if not isinstance(event, RgbdFrame | SkippedFrame):
        return
    model.frames += 1
    if estimate is None or estimate.status is not Status.TRACKING or estimate.T_world_body is None:
        return
    model.seconds.append(time.perf_counter() - started)
    model.stamps_s.append(event.stamp_s)
    model.T_world_body.append(estimate.T_world_body)
    if isinstance(event, RgbdFrame):
        model.last = event.color


def row_of(model: Model) -> tuple[str, ...]:
    """What the table says of a model, in the order of its head."""
    status = model.map.status()
    return (
        model.recording.name,
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
        estimate = Trajectory(np.array(model.stamps_s), np.array(model.T_world_body), body=model.recording.body)
        return f"{evaluate(estimate, truth).ate.translation.rmse:.4f} m"
    except EvaluationError:
        return "no truth at these times"


def table(rows: list[tuple[str, ...]]) -> str:
    """As Markdown."""
    lines = [HEAD, tuple("---" for _ in HEAD), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def figure_of(model: Model, azimuth_deg: float | None, down_deg: float) -> Figure:
    """The model from outside with the camera's way in it; beside it the last frame, and the model seen from there."""
    T_world_camera = model.T_world_camera
    view = outside(model.map, model.up, T_world_camera[0, :3, 2], azimuth_deg, down_deg)
    picture, depth_m = picture_of(model.map, view)
    last = _last_view(model.recording.calibration, T_world_camera[-1])
    seen, _ = picture_of(model.map, last)
    figure = _figure()
    axes = figure.add_axes((0, 0, 0.7273, 1))
    axes.imshow(picture, interpolation="none")
    path = T_world_camera[:, :3, 3]
    px, _ = view.project(path)
    shown = np.where(view.hides(depth_m, path)[:, None], np.nan, px)
    axes.plot(*px.T, color=BLUE, linewidth=1.2, alpha=0.35)
    axes.plot(*shown.T, color=HALO, linewidth=4, solid_capstyle="round")
    axes.plot(*shown.T, color=BLUE, linewidth=2, solid_capstyle="round")
    for edge in frustum_of(view, T_world_camera[-1], _corner_slopes(last), _FRUSTUM_M):
        axes.plot(*edge.T, color=BLUE, linewidth=1.4, solid_capstyle="round")
    axes.set(xlim=(-0.5, view.size[0] - 0.5), ylim=(view.size[1] - 0.5, -0.5))
    axes.set_axis_off()
    for bottom, image, title in ((0.5, model.last, "the camera's last frame"), (0, seen, "the model from there")):
        side = figure.add_axes((0.735, bottom + 0.025, 0.26, 0.4))
        side.imshow(image)
        side.set_title(title, loc="left", fontsize=10, color=INK)
        side.set_axis_off()
    return figure


def _last_view(calibration: Calibration, T_world_camera: FloatArray) -> Viewpoint:
    """The depth camera, free of distortion."""
    _, camera = calibration.cameras
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    return Viewpoint(T_world_camera, intrinsics, (camera.width, camera.height))


def _corner_slopes(view: Viewpoint) -> list[FloatArray]:
    (width, height), (fx, fy, cx, cy) = view.size, view.intrinsics
    return [np.array([(u - cx) / fx, (v - cy) / fy]) for u, v in ((0, 0), (width, 0), (width, height), (0, height))]


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, atomically, and say so."""
    with atomic_write(path, "wb") as stream:
        figure.savefig(stream, format="png", dpi=160)
    print(f"wrote {path}")


def _figure() -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("matplotlib is missing", fix="pip install 'wheelsight[papers]'") from error
    return Figure(figsize=(11, 6), facecolor="white")


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

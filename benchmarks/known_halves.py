"""`python -m benchmarks.known_halves`: whether the robot finds itself in a map of the first half of a real recording.

The first half of a recording with truth is mapped; in the second half odometry starts again at many moments, with
that map and without its pose in it. "Found" is the first frame that is answered `tracking`; errors are of all such
frames up to 4 s after it, of the pose beside the map's nearest keyframe, by the truth. χ² is by the covariance that the
answer states of its pose in the map (`Estimate.covariance_map`): 6 in the mean, where covariance and truth are right.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.sequences import default_data_folder
from benchmarks.session_starts import WRONG_M, beside_nearest, found_by
from benchmarks.table import Sheet
from wheelsight.app.run.maps import open_known
from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.slam.maps import MapFolder, find_map

NAME = "rgbd_dataset_freiburg1_desk"
SEEN_S, LEFT_S = 4.0, 6.0
_HEADER = ("begun at s", "found after s", "first m", "error m", "stated m", "error °", "stated °", "mean χ²")


@dataclass(frozen=True, eq=False)
class Half:
    """An `EventSource`: what a recording has from one stamp up to another, seconds."""

    whole: Recording
    begin_s: float
    end_s: float

    @property
    def name(self) -> str:
        """Of the whole."""
        return self.whole.name

    @property
    def calibration(self) -> Calibration:
        """Of the whole."""
        return self.whole.calibration

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the whole."""
        return self.whole.warnings

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """In order of time."""
        return (event for event in self.whole.events(images=images) if self.begin_s <= event.stamp_s < self.end_s)


class KnownHalf:
    """The map of a first half, and where the truth has its keyframes."""

    def __init__(self, first: Half, truth: Trajectory, folder: Path) -> None:
        config = load_config(overrides={"odometry": "dense", "map": "surfels", "loops.source": "keyframes"})
        run_each(first, config, folder)
        self.path, self.calibration, self.truth = find_map(folder), first.calibration, truth
        left = MapFolder.open(self.path)
        stamps_s = np.array([left.store[number].stamp_s for number in left.store])
        self.T_map_keyframe = left.store.T_map_keyframe
        left.close()
        self.T_true_keyframe = truth.at(np.clip(stamps_s, *truth.stamps_s[[0, -1]]))

    def answers(self, frames: list[RgbdFrame]) -> list[Estimate]:
        """What frames are answered from the first that is found in the map, for `SEEN_S`."""
        config = load_config(overrides={"odometry": "dense", "known_map.path": str(self.path)})
        opened = open_known(self.calibration, config)
        assert opened is not None
        subject = Localizer(self.calibration, config, known=opened[0], waits=True)
        seen = found_by(subject, frames, SEEN_S)
        subject.close()
        opened[1].close()
        return [answer for answer in seen if answer.covariance_map is not None]

    def off(self, answer: Estimate) -> tuple[float, float, float, float, float]:
        """Metres off and stated, degrees off and stated, and χ² of both, beside the nearest keyframe."""
        T_true, T_map_found, C = self.truth.at([answer.stamp_s])[0], answer.T_map_body, answer.covariance_map
        assert T_map_found is not None
        assert C is not None
        T_map_true = beside_nearest(T_true, self.T_true_keyframe, self.T_map_keyframe)
        error: FloatArray = se3.log(T_map_found @ se3.invert(T_map_true))
        off_m = float(np.linalg.norm(T_map_found[:3, 3] - T_map_true[:3, 3]))
        stated_m, stated_rad = (np.sqrt(np.trace(one)) for one in (se3.position_covariance(T_map_found, C), C[3:, 3:]))
        off_deg, stated_deg = np.degrees([np.linalg.norm(error[3:]), stated_rad])
        return off_m, float(stated_m), float(off_deg), float(stated_deg), float(error @ np.linalg.solve(C, error))


def halves_sheet(name: str, found: list[tuple[float, list[Estimate]]], first_s: float, known: KnownHalf) -> Sheet:
    """A row a begin, counted from the recording's first frame, and one of all."""
    rows, of_all = [], []
    for begin_s, seen in found:
        if not seen:
            rows.append((f"{begin_s:.1f}", *["—"] * (len(_HEADER) - 1)))
            continue
        off = np.array([known.off(answer) for answer in seen])
        of_all.append(off)
        rows.append((f"{begin_s:.1f}", f"{seen[0].stamp_s - first_s - begin_s:.2f}", f"{off[0, 0]:.3f}", *_cells(off)))
    if of_all:
        firsts = np.array([off[0, 0] for off in of_all])
        wrong = f"{len(of_all)} of {len(found)}, {int((firsts > WRONG_M).sum())} wrong"
        rows.append(("all", wrong, f"{np.median(firsts):.3f}", *_cells(np.concatenate(of_all))))
    return Sheet(f"The second half of {name} in the map of the first", _HEADER, tuple(rows))


def _cells(off: FloatArray) -> tuple[str, ...]:
    m, stated_m, deg, stated_deg, _ = np.median(off, axis=0)
    return f"{m:.3f}", f"{stated_m:.3f}", f"{deg:.2f}", f"{stated_deg:.2f}", f"{off[:, 4].mean():.1f}"


def measure(recording: Recording, truth: Trajectory, starts: int, folder: Path) -> Sheet:
    """Map the first half, and begin the second at so many moments."""
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    first_s, middle_s, end_s = (frames[k].stamp_s for k in (0, len(frames) // 2, -1))
    known = KnownHalf(Half(recording, first_s, middle_s), truth, folder)
    found = []
    for begin_s in np.linspace(middle_s, end_s - LEFT_S, starts):
        rest = [frame for frame in frames if frame.stamp_s >= begin_s]
        found.append((rest[0].stamp_s - first_s, known.answers(rest)))
    return halves_sheet(recording.name, found, first_s, known)


def main() -> None:
    """Print a table, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.known_halves", description=__doc__)
    parser.add_argument("--recording", type=Path, default=default_data_folder() / "rgbd" / NAME, help="with truth")
    parser.add_argument("--starts", type=int, default=6, help="moments of the second half")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    recording, about = open_recording(arguments.recording), machine.description()
    if recording.ground_truth is None:
        parser.error(f"{arguments.recording} has no truth")
    with TemporaryDirectory() as folder:
        sheet = measure(recording, recording.ground_truth, arguments.starts, Path(folder))
    Console(width=120).print(sheet.to_rich())
    if arguments.out is not None:
        lines = [f"- {name}: {reported}" for name, reported in about.items()]
        page = [f"# In the map of a first half\n\n{__doc__}", "\n".join(lines) + "\n", sheet.to_markdown()]
        arguments.out.write_text("\n".join(page), encoding="utf-8")


if __name__ == "__main__":
    main()

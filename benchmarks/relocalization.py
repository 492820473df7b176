"""`python -m benchmarks.relocalization`: where single views of a real recording were seen from, in a map of its others.

The map has every 8th frame, where the truth has it. Every 4th frame is a query, the map's own left out; keyframes
within 90 frames of it are withheld, so that it comes back to a place rather than stays there. A query knows how fast
the camera moves, by dense odometry from frame to frame, and nothing else. An answer that leaves directions unknown
counts as none.

"By two" are answers that a second keyframe confirms. "Truth by surfaces" is the share of answered queries in which
planes alone, aligned from the true pose, end within 5 cm and 5° of it: where they do not, the truth and the depth
disagree. χ² is the median by the stated covariance: 5.3 for an honest one and a perfect truth.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.place_finder import PlaceFinder, Search
from benchmarks.sequences import Sequence as Recorded
from benchmarks.sequences import default_data_folder, find_sequences
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import open_recording
from wheelsight.places.recognition import Recognizer, SeenView, ViewMaker
from wheelsight.places.verification import PlaceVerifier
from wheelsight.vision.dense import DenseOdometry, DenseSettings, GridFrame
from wheelsight.vision.dense.alignment import Aligner, Level, ReferenceMaker

NAMES = ("red_kitchen", "rgbd_dataset_freiburg1_desk")
KEYFRAME_EVERY, QUERY_EVERY, WITHHELD = 8, 4, 90
FINE, ROUGH, WRONG_M = (0.05, 5.0), (0.15, 10.0), 0.5
FINE_PERCENT, ROUGH_PERCENT, QUERY_MS, CANDIDATES_MS, KEYFRAMES = 85.0, 95.0, 150.0, 1.0, 10_000
# A keyframe at most so far off shows much the same; others may show the back of it.
_NEAR = (0.5, 30.0)
_PUBLISHED = (("Active Search (SIFT)", 45), ("HLoc (SuperPoint, SuperGlue; GPU)", 62), ("DSAC* RGB-D (GPU)", 92))
_SURFACES_ALONE = {"color_weight": 0.0}


@dataclass(frozen=True, eq=False)
class Answer:
    """What became of a query.

    Attributes:
        has_near: whether the map has a keyframe that is near, by the truth.
        off: metres and degrees from the truth, or None where there is no answer.
        chi2: of that, by the stated covariance; 6 in the mean for an honest one and a perfect truth.
        surfaces_off: where surfaces alone come to that are begun at the truth, metres and degrees.
        is_confirmed: by a second keyframe.
        candidates_ms, query_ms: for the candidates; for all, the view made of the frame included.
    """

    has_near: bool
    off: tuple[float, float] | None
    chi2: float
    surfaces_off: tuple[float, float] | None
    is_confirmed: bool
    candidates_ms: float
    query_ms: float

    def within(self, limits: tuple[float, float], *, by_surfaces: bool = False) -> bool:
        """Metres and degrees."""
        off = self.surfaces_off if by_surfaces else self.off
        return off is not None and off[0] < limits[0] and off[1] < limits[1]


class Place:
    """A recording as a map and queries."""

    def __init__(self, sequence: Recorded) -> None:
        recording = open_recording(sequence.path)
        assert sequence.truth is not None
        self.name, self.calibration = sequence.name, recording.calibration
        self.views = ViewMaker(self.calibration)
        self.frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
        self.T_map_camera = sequence.truth.at(np.array([frame.stamp_s for frame in self.frames]), 0.1)
        self.is_known = np.isfinite(self.T_map_camera).all(axis=(1, 2))
        self.twists = list(_twists(self.frames, self.calibration))
        self.recognizer = Recognizer()
        self.keyframes: dict[KeyframeId, Keyframe] = {}
        for number in np.flatnonzero(self.is_known).tolist():
            if number % KEYFRAME_EVERY == 0:
                self._keep(KeyframeId(number))
        self.verifier = PlaceVerifier(self.calibration, views=self.views)
        self.finder = PlaceFinder(self.recognizer, self.verifier)

    def _keep(self, number: KeyframeId) -> None:
        view = self.view(number)
        finest = view.grid.levels[0]
        images = (view.grid.stamp_s, finest.intrinsics, finest.depth_m, finest.grey)
        self.keyframes[number] = Keyframe.of_images(*images, view.features)
        self.recognizer.add(number, self.keyframes[number])

    def view(self, number: int) -> SeenView:
        """A frame as a view."""
        return self.views.of_frame(self.frames[number], self.twists[number])

    def queries(self) -> Iterator[int]:
        """Numbers of the frames that are asked."""
        numbers = np.flatnonzero(self.is_known).tolist()
        yield from (number for number in numbers if number % QUERY_EVERY == QUERY_EVERY // 2)

    def ask(self, number: int) -> Answer:
        """Where a frame was seen from."""
        withheld = [keyframe for keyframe in self.keyframes if abs(keyframe - number) <= WITHHELD]
        begin = time.perf_counter()
        view = self.view(number)
        made_s = time.perf_counter() - begin
        begin = time.perf_counter()
        self.recognizer.candidates(view, forbidden=withheld)
        candidates_s = time.perf_counter() - begin
        begin = time.perf_counter()
        search = self.finder.find(view, self.keyframes, self.T_map_camera, withheld)
        query_ms = 1e3 * (made_s + time.perf_counter() - begin)
        offered = [keyframe for keyframe in self.keyframes if keyframe not in withheld]
        near = any(_is_within(self._between(keyframe, number), _NEAR) for keyframe in offered)
        return self._judged(search, view, number, (near, 1e3 * candidates_s, query_ms))

    def _between(self, first: int, second: int) -> FloatArray:
        return np.asarray(se3.invert(self.T_map_camera[first]) @ self.T_map_camera[second])

    def _judged(self, search: Search, view: SeenView, number: int, known: tuple[bool, float, float]) -> Answer:
        near, candidates_ms, query_ms = known
        found = search.found
        if found is None or not found.shows_all:
            return Answer(near, None, np.nan, None, False, candidates_ms, query_ms)
        T_true = self._between(found.keyframe, number)
        off = se3.log(found.T_keyframe_camera @ se3.invert(T_true))
        chi2 = float(off @ np.linalg.solve(found.covariance, off))
        by_surfaces = _off(se3.invert(T_true) @ self._by_surfaces(view, found.keyframe, T_true))
        found_off = _off(se3.invert(T_true) @ found.T_keyframe_camera)
        return Answer(near, found_off, chi2, by_surfaces, search.is_confirmed, candidates_ms, query_ms)

    def _by_surfaces(self, view: SeenView, keyframe: KeyframeId, T_true: FloatArray) -> FloatArray:
        """T_keyframe_camera (4, 4) by planes alone, begun at the truth."""
        views, settings = self.views, self.views.settings.model_copy(update=_SURFACES_ALONE)
        maker = ReferenceMaker(self.calibration.depth_noise)
        aligner = Aligner(self.calibration, settings, views.gridder, maker)
        reference = maker.of_frame(views.of_keyframe(self.keyframes[keyframe]).grid, np.eye(4))
        return aligner.align(view.grid, reference, T_true).T_reference_frame


def accepted_elsewhere(place: Place, other: Place) -> tuple[int, int]:
    """How many views of another place are taken for one of a map, and how many were asked."""
    asked = list(other.queries())
    answers = (place.finder.find(other.view(number), place.keyframes, place.T_map_camera) for number in asked)
    return sum(search.found is not None for search in answers), len(asked)


def candidates_ms(keyframes: int = KEYFRAMES, queries: int = 200) -> float:
    """Median time to find candidates among so many made-up keyframes, whose words are shared by neighbours."""
    rng = np.random.default_rng(0)
    words = rng.integers(0, 2**64, (20 * keyframes, 4), np.uint64)
    recognizer = Recognizer()
    for number in range(keyframes):
        recognizer.add(KeyframeId(number), _made_view(rng, words, number))
    seconds = []
    for number in rng.integers(0, keyframes, queries).tolist():
        view = _made_view(rng, words, number)
        begin = time.perf_counter()
        recognizer.candidates(view)
        seconds.append(time.perf_counter() - begin)
    return 1e3 * statistics.median(seconds)


def _made_view(rng: np.random.Generator, words: np.ndarray, number: int) -> SeenView:
    """Noise, with 1000 descriptors that are 20 bits off words which views nearby show too."""
    descriptors = words[(number * 20 + rng.integers(0, 1500, 1000)) % len(words)]
    for _ in range(20):
        bit = np.uint64(1) << rng.integers(0, 64, 1000).astype(np.uint64)
        descriptors[np.arange(1000), rng.integers(0, 4, 1000)] ^= bit
    depth_m, grey = (rng.uniform(1, most, (240, 320)).astype(np.float32) for most in (6, 255))
    grid = GridFrame(0.0, (Level(np.array([262.0, 262.0, 159.5, 119.5]), depth_m, grey),), np.zeros(6))
    return SeenView(grid, KeyframeFeatures(np.zeros((1000, 2)), np.ones((1000, 3)), descriptors))


def _twists(frames: Sequence[RgbdFrame], calibration: Calibration) -> Iterator[FloatArray]:
    odometry = DenseOdometry(calibration, DenseSettings(reference="previous"))
    for frame in frames:
        grid = odometry.process(frame).frame
        yield np.zeros(6) if grid is None else grid.twist


def _off(T: FloatArray) -> tuple[float, float]:
    return float(np.linalg.norm(T[:3, 3])), float(np.degrees(so3.angle(T[:3, :3])))


def _is_within(T: FloatArray, limits: tuple[float, float]) -> bool:
    off_m, off_deg = _off(T)
    return off_m < limits[0] and off_deg < limits[1]


def _percent(answers: Sequence[Answer], limits: tuple[float, float], *, by_surfaces: bool = False) -> float:
    return 100 * sum(answer.within(limits, by_surfaces=by_surfaces) for answer in answers) / max(len(answers), 1)


def _wrong(answers: Sequence[Answer]) -> int:
    return sum(answer.off is not None and answer.off[0] > WRONG_M for answer in answers)


def place_sheet(name: str, answers: Sequence[Answer]) -> Sheet:
    """All queries, those whose place the map shows from near, and those that were answered."""
    rows = []
    near = [answer for answer in answers if answer.has_near]
    found = [answer for answer in answers if answer.off is not None]
    for what, some in (("all queries", answers), ("a keyframe within 0.5 m and 30°", near), ("answered", found)):
        answered = [answer for answer in some if answer.off is not None]
        rows.append(
            (
                what,
                str(len(some)),
                str(len(answered)),
                str(sum(answer.is_confirmed for answer in answered)),
                f"{_percent(some, FINE):.1f} %",
                f"{_percent(some, ROUGH):.1f} %",
                str(_wrong(some)),
                f"{_percent(answered, FINE, by_surfaces=True):.1f} %",
                f"{statistics.median([answer.chi2 for answer in answered] or [np.nan]):.1f}",
            )
        )
    header = ("queries", "asked", "answered", "by two", "5 cm, 5°", "15 cm, 10°", "> 0.5 m off")
    return Sheet(f"Relocalization: {name}", (*header, "truth by surfaces", "χ²"), tuple(rows))


def published_sheet() -> Sheet:
    """What others have published of the whole scene."""
    rows = tuple((system, f"{percent} %") for system, percent in _PUBLISHED)
    return Sheet(
        "Published of red_kitchen: all its sequences, with a map of all training frames", ("", "5 cm, 5°"), rows
    )


def judge_place(name: str, answers: Sequence[Answer]) -> list[Target]:
    """What must be reached on each recording."""
    query_ms = statistics.median(answer.query_ms for answer in answers)
    return [
        Target(f"{name}: within 5 cm and 5°", FINE_PERCENT, _percent(answers, FINE), "%", is_least=True),
        Target(f"{name}: within 15 cm and 10°", ROUGH_PERCENT, _percent(answers, ROUGH), "%", is_least=True),
        Target(f"{name}: accepted more than 0.5 m off", 0, _wrong(answers), "queries", 0),
        Target(f"{name}: a query, median", QUERY_MS, query_ms, "ms"),
        Target(f"{name}: a query, 95 %", QUERY_MS, float(np.percentile([a.query_ms for a in answers], 95)), "ms"),
        Target(
            f"{name}: its candidates, median",
            CANDIDATES_MS,
            statistics.median(a.candidates_ms for a in answers),
            "ms",
            2,
        ),
    ]


def main() -> None:
    """Print what was measured on both recordings, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.relocalization", description=__doc__)
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder with rgbd/RECORDING in it")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    known = {sequence.name: sequence for sequence in find_sequences(arguments.data)}
    console, places, sheets, targets = Console(width=150), [], [], []
    about = machine.description()
    for name in NAMES:
        if name not in known:
            parser.error(f"{arguments.data} has no recording {name}")
        place = Place(known[name])
        answers = [place.ask(number) for number in place.queries()]
        places.append(place)
        sheets.append(place_sheet(name, answers))
        targets += judge_place(name, answers)
    for place, other in (places, places[::-1]):
        wrong, asked = accepted_elsewhere(place, other)
        targets.append(Target(f"{place.name}: accepted of {asked} views of another place", 0, wrong, "views", 0))
    of_many = candidates_ms()
    targets.append(Target(f"candidates of {KEYFRAMES:,} keyframes, median", CANDIDATES_MS, of_many, "ms", 2))
    sheets += [published_sheet(), targets_sheet(targets)]
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        lines = [f"- {name}: {reported}" for name, reported in about.items()]
        pages = [f"# Relocalization\n\n{__doc__}", "\n".join(lines) + "\n", *(sheet.to_markdown() for sheet in sheets)]
        arguments.out.write_text("\n".join(pages), encoding="utf-8")


if __name__ == "__main__":
    main()

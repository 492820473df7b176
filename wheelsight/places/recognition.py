"""`Recognizer` finds keyframes that may show the same place as a view, by ferns and visual words."""

from __future__ import annotations

import io
import json
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.files import StrPath, write_bytes
from wheelsight.core.geometry import Float32Array, FloatArray, IntArray
from wheelsight.core.geometry.arrays import UInt64Array
from wheelsight.core.inputs import ArrayFile, Kind, parse_json, read_bytes
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings import RecognitionSettings
from wheelsight.core.settings.base import split_removed
from wheelsight.places.recognition_kernels import BLOCK, best, likeness_kernel
from wheelsight.places.vocabulary import DESCRIPTORS, RULES, Descriptors, Vocabulary, packed, unpacked
from wheelsight.vision.dense.alignment import Gridder, GridFrame, Level, coarser
from wheelsight.vision.dense.settings import DenseSettings
from wheelsight.vision.dense.tracking import KeypointTracker

FORMAT = "wheelsight-recognition-2"
# The first format contains all descriptors, and unused blocks.
_FIRST_FORMAT = "wheelsight-recognition-1"
_FILE = Kind("codes of keyframes", most_mb=4096, fix="give a file that `Recognizer.save` wrote")
_REBUILD = "rebuild the map"
# Settings take 1.5 kB; sizes and checksums are smaller.
_LONGEST_TEXT, _SMALL_BYTES = 1 << 16, 64
# Added to ranks before the two orders, by ferns and by words, are joined by the sum of 1 / rank: Cormack et al. 2009.
_FUSED_RANK = 60.0
_RANKED = 64  # keyframes of each order that are joined; chosen
# Limit of a file without a known number of keyframes: 80 000 keyframes.
_MOST_BYTES = 1 << 30


def _nothing(keyframe: KeyframeId) -> UInt64Array:
    return NO_FEATURES.descriptors


class Candidate(NamedTuple):
    """A keyframe that may show the place, with a score: 1 if it is first by both ferns and words."""

    keyframe: KeyframeId
    score: float


class Recognizer:
    """Finds keyframes that look like a view.

    Ferns describe the rough layout of light and depth, words describe single features anywhere in the image; they
    complement each other. Candidates are unverified: see `PlaceVerifier`.

    Args:
        settings: settings, or None for the defaults. The same keyframes in the same order give the same results.
    """

    def __init__(self, settings: RecognitionSettings | None = None) -> None:
        self._settings = settings or RecognitionSettings()
        self._ferns = Ferns.drawn(self._settings.seed)
        self._words = Vocabulary()
        self._codes = np.zeros((16, _FERNS // 16), np.uint64)
        self._keyframes: list[KeyframeId] = []
        self._rows: dict[KeyframeId, int] = {}

    def __len__(self) -> int:
        return len(self._keyframes)

    @property
    def settings(self) -> RecognitionSettings:
        """Settings of the stored codes."""
        return self._settings

    @property
    def keyframes(self) -> tuple[KeyframeId, ...]:
        """Known keyframes, in the order in which they were added."""
        return tuple(self._keyframes)

    def add(self, number: KeyframeId, view: Keyframe | SeenView) -> None:
        """Add a keyframe. Raises ArgumentError for a known one."""
        if number in self._rows:
            raise ArgumentError(f"keyframe {number} is known already", fix="add each keyframe once")
        row = len(self._keyframes)
        if row == len(self._codes):
            self._codes = np.concatenate([self._codes, np.zeros_like(self._codes)])
        code, descriptors = self._described(view)
        self._codes[row] = code
        self._words.add(descriptors, row)
        self._keyframes.append(number)
        self._rows[number] = row

    def candidates(
        self, view: Keyframe | SeenView, k: int | None = None, forbidden: Collection[KeyframeId] = ()
    ) -> list[Candidate]:
        """Return at most `k` keyframes most similar to a view, best first; None for the number in the settings.

        `forbidden` keyframes are left out, such as recent ones, which are not loops.
        """
        rows, wanted = len(self._keyframes), self._settings.candidates if k is None else k
        if not rows:
            return []
        code, descriptors = self._described(view)
        likeness = np.empty(rows, np.float32)
        likeness_kernel(self._codes, code, likeness)
        votes = self._words.vote(descriptors, rows)
        out = [self._rows[number] for number in forbidden if number in self._rows]
        likeness[out], votes[out] = -1, -1
        # Fused by the sum of 1 / rank in both orders (Cormack et al. 2009).
        scores: dict[int, float] = {}
        rank = _FUSED_RANK
        for values in (likeness, votes):
            order = np.empty(_RANKED, np.int64)
            found = best(values, order)
            for place, row in enumerate(order[:found].tolist()):
                scores[row] = scores.get(row, 0.0) + 0.5 * (rank + 1) / (rank + 1 + place)
        fused = sorted(scores.items(), key=lambda item: (-item[1], item[0]))
        return [Candidate(self._keyframes[row], score) for row, score in fused[:wanted]]

    def _described(self, view: Keyframe | SeenView) -> tuple[UInt64Array, UInt64Array]:
        """Return the code of ferns, and descriptors (N, 4)."""
        if isinstance(view, Keyframe):
            images, features = (view.depth_m, view.grey), view.features or NO_FEATURES
        else:
            images, features = (view.grid.levels[0].depth_m, view.grid.levels[0].grey), view.features
        return self._ferns.code(*images), features.descriptors

    def save(self, path: StrPath, on_disk: Descriptors = _nothing) -> None:
        """Write all contents, atomically, as plain arrays without pickles. Raises OutputError.

        Descriptors that `on_disk` returns for a keyframe are not written, and `load` then needs the same function.
        """
        texts = {"format": FORMAT, "settings": json.dumps(self._settings.model_dump(mode="json"))}
        encoded = {name: np.frombuffer(text.encode(), np.uint8) for name, text in texts.items()}
        ferns = {"pixel": self._ferns.pixel, "grey": self._ferns.grey, "depth_m": self._ferns.depth_m}
        kept = {"keyframes": np.array(self._keyframes, np.int64), "codes": self._codes[: len(self)]}
        buffer = io.BytesIO()
        packed_words = packed(self._words.arrays(), self._keyframes, on_disk)
        words = {f"words_{name}": array for name, array in packed_words.items()}
        arrays: dict[str, Any] = {**encoded, **ferns, **kept, **words}
        np.savez_compressed(buffer, **arrays)
        write_bytes(path, buffer.getvalue())

    @classmethod
    def load(
        cls,
        path: StrPath,
        on_disk: Descriptors = _nothing,
        *,
        settings: RecognitionSettings | None = None,
        most_keyframes: int | None = None,
    ) -> Self:
        """Read a file written by `save`.

        Args:
            on_disk: the function given to `save`.
            settings: required settings; None: any.
            most_keyframes: largest number of keyframes, as many as its map has; None: as many as fit in 1 GB.

        Raises MapError if the file or the descriptors `on_disk` do not match, it has other settings, or its arrays are
        larger than its keyframes need. Such a file is not unpacked.
        """
        path = Path(path)
        data = read_bytes(path, _FILE, MapError)
        try:
            return cls._from_arrays(*_arrays_of(ArrayFile(data), settings, most_keyframes), on_disk)
        except MapError as error:
            raise MapError(error.problem, path=path, fix=error.fix) from error
        except (KeyError, ValueError, TypeError) as error:
            why = f"it {error}" if type(error) is ValueError else type(error).__name__
            raise MapError(f"is damaged: {why}", path=path, fix=_REBUILD) from error

    @classmethod
    def _from_arrays(
        cls, settings: RecognitionSettings, arrays: dict[str, NDArray[Any]], is_old: bool, on_disk: Descriptors
    ) -> Self:
        """Return a recognizer of a file's arrays. Raises MapError if they are inconsistent."""
        made = cls(settings)
        keyframes, codes = arrays["keyframes"], arrays["codes"]
        shapes = {"pixel": (_FERNS,), "grey": (_FERNS, 2), "depth_m": (_FERNS, 2)}
        is_whole = codes.shape == (len(keyframes), _FERNS // 16) and codes.dtype == np.uint64
        if not is_whole or any(arrays[name].shape != shape for name, shape in shapes.items()):
            raise MapError("its codes are of another shape than its settings say", fix=_REBUILD)
        if not ((arrays["pixel"] >= 0) & (arrays["pixel"] < _SIZE_PX[0] * _SIZE_PX[1])).all():
            raise MapError("its ferns compare pixels outside the image", fix=_REBUILD)
        made._ferns = Ferns(*(arrays[name] for name in shapes))
        words = {name.removeprefix("words_"): array for name, array in arrays.items() if name.startswith("words_")}
        made._keyframes = [KeyframeId(int(number)) for number in keyframes]
        made._rows = {number: row for row, number in enumerate(made._keyframes)}
        if len(made._rows) < len(keyframes):
            raise MapError("it knows a keyframe twice", fix=_REBUILD)
        if not is_old:
            words = unpacked(words, made._keyframes, on_disk)
        made._words = Vocabulary.from_arrays(words, len(keyframes))
        made._codes = np.concatenate([codes, np.zeros((16, codes.shape[1]), np.uint64)])
        return made


def _arrays_of(
    file: ArrayFile, expected: RecognitionSettings | None, most_keyframes: int | None
) -> tuple[RecognitionSettings, dict[str, NDArray[Any]], bool]:
    """Return the settings of a file, its arrays, each no larger than its keyframes need, and whether it is old.

    Raises MapError if it is of another format, of other settings, or larger than its keyframes need, and ValueError,
    KeyError if it is damaged.
    """
    written = file.read("format", _LONGEST_TEXT).tobytes().decode(errors="replace")
    if written not in (FORMAT, _FIRST_FORMAT):
        raise MapError(f"is of format {written!r}, not {FORMAT!r}", fix=_REBUILD)
    stated = dict(parse_json(file.read("settings", _LONGEST_TEXT).tobytes()))
    known, removed = split_removed(stated, "recognition")
    settings = RecognitionSettings.model_validate(known)
    if any(one.differs for one in removed) or (expected is not None and settings != expected):
        raise MapError("is of other settings", fix=_REBUILD)
    (keyframes,) = file.headers["keyframes"].shape
    if most_keyframes is not None and keyframes > most_keyframes:
        raise MapError(f"knows {keyframes:,} keyframes, and its map has {most_keyframes:,}", fix=_REBUILD)
    if most_keyframes is None and sum(header.nbytes for header in file.headers.values()) > _MOST_BYTES:
        raise MapError(f"states more than {_MOST_BYTES >> 20:,} MB of codes", fix=_REBUILD)
    postings = keyframes * DESCRIPTORS
    # Each node is created with its own descriptor, and each inner one has at least two children.
    nodes = min(RULES.most_nodes, 2 * postings + 1)
    most = {"codes": keyframes * _FERNS // 2, "words_centre": 32 * nodes, "words_own": 32 * postings}
    most |= dict.fromkeys(("pixel", "grey", "depth_m"), 16 * _FERNS)
    most |= {"keyframes": 8 * keyframes, "words_place": 2 * postings, "words_row": 4 * postings}
    if written == _FIRST_FORMAT:  # it has blocks, used and free
        blocks = 2 * (postings // BLOCK + nodes + RULES.branching)
        most |= {"words_row": 4 * BLOCK * blocks, "words_descriptor": 32 * BLOCK * blocks}
        most |= {"words_following": 4 * blocks}
    most |= {"format": _LONGEST_TEXT, "settings": _LONGEST_TEXT}
    rest = max(4 * nodes, _SMALL_BYTES)
    arrays = {name: file.read(name, most.get(name, rest)) for name in file.headers}
    return settings, arrays, written == _FIRST_FORMAT


# Halving cannot bring two widths closer than this ratio.
_ALIKE = np.sqrt(2)
NO_FEATURES = KeyframeFeatures(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 4), np.uint64))


@dataclass(frozen=True, slots=True, eq=False)
class SeenView:
    """A frame or a keyframe, prepared for place recognition.

    Attributes:
        grid: depth and grey of the ideal camera, at all scales.
        features: keypoints with points in the camera frame; may be empty.
    """

    grid: GridFrame
    features: KeyframeFeatures


class ViewMaker:
    """Makes views of frames, and of keyframes of the same camera.

    Args:
        calibration: calibration of the cameras. Raises CalibrationError as `FeatureExtractor` does.
    """

    def __init__(self, calibration: Calibration, settings: DenseSettings | None = None) -> None:
        self.settings = settings or DenseSettings()
        self.gridder = Gridder(calibration, self.settings)
        self._keypoints = KeypointTracker(calibration, has_landmarks=False)

    def of_frame(self, frame: RgbdFrame, twist: FloatArray | None = None) -> SeenView:
        """Return the view of a frame, by a camera that moves at `twist` (6,) in its own frame, or is at rest."""
        twist = np.zeros(6) if twist is None else twist
        raw = self._keypoints.extract(frame)
        features = self._keypoints.kept(self._keypoints.straightened(raw, twist))
        return SeenView(self.gridder.on_grid(frame, twist), features)

    def of_keyframe(self, keyframe: Keyframe) -> SeenView:
        """Return the view of a keyframe, halved to the grid's width: feature odometry stores full images."""
        finest = Level(keyframe.intrinsics, keyframe.depth_m, known_grey(keyframe))
        levels = coarser(finest)
        while levels[0].depth_m.shape[1] > self.settings.finest_width_px:
            levels = coarser(levels[1])
        return SeenView(GridFrame(keyframe.stamp_s, levels, np.zeros(6)), keyframe.features or NO_FEATURES)

    def of_one_size(self, first: SeenView, second: SeenView) -> tuple[SeenView, SeenView]:
        """Return both views with similar widths, as alignment level by level needs; the wider one is halved.

        Keyframes of a known map may be from a run with other settings, such as those of a profile.
        """
        while _width(first) > _ALIKE * _width(second):
            first = self._halved(first)
        while _width(second) > _ALIKE * _width(first):
            second = self._halved(second)
        return first, second

    def _halved(self, view: SeenView) -> SeenView:
        levels = coarser(view.grid.levels[1])
        return replace(view, grid=replace(view.grid, levels=levels))


def _width(view: SeenView) -> int:
    return int(view.grid.levels[0].depth_m.shape[1])


def known_grey(keyframe: Keyframe) -> np.ndarray:
    """Return grey (h, w) float32 of a keyframe, -1 if unknown, which is stored as 0."""
    grey = keyframe.grey
    grey[grey == 0] = -1
    return grey


_FERNS = 512  # of 4 bits each; Glocker et al. 2015 use 500, and 16 fill a word
_SIZE_PX = (40, 30)  # of the small image: of 640×480 the paper uses a sixteenth
_BLUR_PX = 1.0  # standard deviation of the blur over the small image; the paper has 2.5 over 5 px
# Thresholds of grey lie within this many standard deviations of an image's grey about its mean: light and exposure
# change both. Chosen.
_GREY_SIGMAS = 1.2
# Range of thresholds of depth, as far as depth cameras see indoors; the paper has 0.4 to 4 m. Chosen.
_NEAREST_M, _FARTHEST_M = 0.5, 6.0
_SHIFTS = np.arange(0, 64, 4, dtype=np.uint64)
# Large images are first subsampled to this multiple of the small image.
_FINER = 2
_BITS = np.array([1, 2, 4, 8], np.uint64)


@dataclass(frozen=True, slots=True, eq=False)
class Ferns:
    """F ferns (Glocker et al. 2015): each makes two comparisons of grey and two of depth at a pixel of a small image.

    The paper uses red, green, blue and depth with fixed thresholds. Keyframes store grey only. It is compared relative
    to the mean and deviation of its image, since light and exposure change from day to day.

    Attributes:
        pixel: (F,) index into the small image.
        grey: (F, 2) thresholds, in standard deviations of the image's grey from its mean.
        depth_m: (F, 2) thresholds, metres.
    """

    pixel: IntArray
    grey: FloatArray
    depth_m: FloatArray

    @classmethod
    def drawn(cls, seed: int) -> Ferns:
        """Return random ferns by a seed."""
        rng = np.random.default_rng(seed)
        pixel = rng.integers(0, _SIZE_PX[0] * _SIZE_PX[1], _FERNS)
        grey = rng.uniform(-_GREY_SIGMAS, _GREY_SIGMAS, (_FERNS, 2))
        depth_m = np.exp(rng.uniform(np.log(_NEAREST_M), np.log(_FARTHEST_M), (_FERNS, 2)))
        return cls(pixel, grey, depth_m)

    def code(self, depth_m: Float32Array, grey: Float32Array) -> UInt64Array:
        """Return the code (F / 16,) of depth (h, w) in metres and grey (h, w), at most 0 if unknown. Unknown gives zero
        bits.
        """
        near, bright = self._tiny(depth_m).ravel(), self._tiny(grey).ravel()
        known = bright > 0
        if known.any():
            spread = max(float(bright[known].std()), 1.0)
            bright = np.where(known, (bright - bright[known].mean()) / spread, -np.inf)
        else:
            bright = np.full_like(bright, -np.inf)
        is_brighter = bright[self.pixel, None] > self.grey
        is_farther = near[self.pixel, None] > self.depth_m
        four = np.concatenate([is_brighter, is_farther], axis=1) @ _BITS
        shifted = four.reshape(-1, len(_SHIFTS)).astype(np.uint64) << _SHIFTS
        return np.asarray(np.bitwise_or.reduce(shifted, axis=1), np.uint64)

    def _tiny(self, image: Float32Array) -> Float32Array:
        """Return means (h, w) of the known pixels of an image; 0 if there are none."""
        stride = max(1, image.shape[1] // (_FINER * _SIZE_PX[0]))
        some = image[::stride, ::stride]
        is_known = some > 0
        both = np.dstack([np.where(is_known, some, np.float32(0)), is_known.astype(np.float32)])
        both = cv2.resize(both, _SIZE_PX, interpolation=cv2.INTER_AREA)
        total, share = cv2.split(cv2.GaussianBlur(both, (0, 0), _BLUR_PX))
        return np.where(share > 0.2, total / np.maximum(share, 0.2), np.float32(0))

"""Recognizer: which keyframes may show the place that a view shows, by ferns and by words together."""

from __future__ import annotations

import io
import json
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from wheelsight.errors import ArgumentError, MapError
from wheelsight.files import StrPath, write_bytes
from wheelsight.geometry import Float32Array
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.inputs import ArrayFile, Kind, parse_json, read_bytes
from wheelsight.keyframes import Keyframe, KeyframeId
from wheelsight.places import _likeness_kernels, kept_words
from wheelsight.places._word_kernels import BLOCK
from wheelsight.places.ferns import Ferns
from wheelsight.places.kept_words import Descriptors
from wheelsight.places.views import NO_FEATURES, SeenView
from wheelsight.places.vocabulary import Vocabulary
from wheelsight.settings import RecognitionSettings

FORMAT = "wheelsight-recognition-2"
# It has all descriptors itself, and the room between them.
_FIRST_FORMAT = "wheelsight-recognition-1"
_FILE = Kind("codes of keyframes", most_mb=4096, fix="give a file that `Recognizer.save` wrote")
_REBUILD = "build the map anew"
# Settings take 1.5 kB; sizes and checksums less than the other.
_LONGEST_TEXT, _SMALL_BYTES = 1 << 16, 64
# Of a file by itself, whose map says nothing: 80 000 keyframes.
_MOST_BYTES = 1 << 30


def _nothing(keyframe: KeyframeId) -> UInt64Array:
    return NO_FEATURES.descriptors


class Candidate(NamedTuple):
    """A keyframe that may show the place, and its score: 1 for what ferns and words both put first."""

    keyframe: KeyframeId
    score: float


class Recognizer:
    """Knows keyframes by what they look like, and finds those that a view is like.

    Ferns tell the rough layout of light and depth, words tell single things wherever they stand in the image; each
    finds what the other misses. It answers what may be the same, never what is: see `PlaceVerifier`.

    Args:
        settings: or the defaults. The same keyframes in the same order give the same answers.
    """

    def __init__(self, settings: RecognitionSettings | None = None) -> None:
        self._settings = settings or RecognitionSettings()
        self._ferns = Ferns.drawn(self._settings.ferns, self._settings.seed)
        self._words = Vocabulary(self._settings.words)
        self._codes = np.zeros((16, self._settings.ferns.ferns // 16), np.uint64)
        self._keyframes: list[KeyframeId] = []
        self._rows: dict[KeyframeId, int] = {}

    def __len__(self) -> int:
        return len(self._keyframes)

    @property
    def settings(self) -> RecognitionSettings:
        """By which its codes were made."""
        return self._settings

    @property
    def keyframes(self) -> tuple[KeyframeId, ...]:
        """Those that it knows, in the order in which they were added."""
        return tuple(self._keyframes)

    def add(self, number: KeyframeId, view: Keyframe | SeenView) -> None:
        """Know a keyframe from now on. Raises ArgumentError for one that it knows."""
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
        """At most `k` keyframes, or as many as settings say, that a view is most like, the likeliest first.

        `forbidden` are left out: such as those just passed, which are no loop.
        """
        rows, wanted = len(self._keyframes), self._settings.candidates if k is None else k
        if not rows:
            return []
        code, descriptors = self._described(view)
        likeness = np.empty(rows, np.float32)
        _likeness_kernels.likeness(self._codes, code, likeness)
        votes = self._words.vote(descriptors, rows)
        out = [self._rows[number] for number in forbidden if number in self._rows]
        likeness[out], votes[out] = -1, -1
        return [Candidate(self._keyframes[row], score) for row, score in self._fused(likeness, votes)[:wanted]]

    def save(self, path: StrPath, on_disk: Descriptors = _nothing) -> None:
        """Write all that it knows, atomically: plain arrays, no pickles. Raises OutputError.

        Descriptors that `on_disk` has of a keyframe are left to it, and `load` then needs it, too.
        """
        told = {name: np.frombuffer(text.encode(), np.uint8) for name, text in self._texts().items()}
        ferns = {"pixel": self._ferns.pixel, "grey": self._ferns.grey, "depth_m": self._ferns.depth_m}
        kept = {"keyframes": np.array(self._keyframes, np.int64), "codes": self._codes[: len(self)]}
        buffer = io.BytesIO()
        told_words = kept_words.packed(self._words.arrays(), self._keyframes, on_disk)
        words = {f"words_{name}": array for name, array in told_words.items()}
        arrays: dict[str, Any] = {**told, **ferns, **kept, **words}
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
        """Read what `save` wrote.

        Args:
            path: of the file.
            on_disk: what `save` was given.
            settings: that it must be of; None: of any.
            most_keyframes: that it may know, as many as its map has; None: as 1 GB holds.

        Raises:
            MapError: naming the file: it or what is `on_disk` is another, it is of other settings, or it states arrays
                that are larger than its keyframes need. Of such a file nothing is unpacked.
        """
        path = Path(path)
        data = read_bytes(path, _FILE, MapError)
        try:
            return cls._of(_Stated(ArrayFile(data), settings, most_keyframes), on_disk)
        except MapError as error:
            raise MapError(error.problem, path=path, fix=error.fix) from error
        except (KeyError, ValueError, TypeError) as error:
            why = f"it {error}" if type(error) is ValueError else type(error).__name__
            raise MapError(f"is damaged: {why}", path=path, fix=_REBUILD) from error

    @classmethod
    def _of(cls, stated: _Stated, on_disk: Descriptors) -> Self:
        made, arrays = cls(stated.settings), stated.arrays()
        keyframes, codes, settings = arrays["keyframes"], arrays["codes"], made._settings.ferns
        shapes = {"pixel": (settings.ferns,), "grey": (settings.ferns, 2), "depth_m": (settings.ferns, 2)}
        is_whole = codes.shape == (len(keyframes), settings.ferns // 16) and codes.dtype == np.uint64
        if not is_whole or any(arrays[name].shape != shape for name, shape in shapes.items()):
            raise MapError("its codes are of another shape than its settings say", fix=_REBUILD)
        if not ((arrays["pixel"] >= 0) & (arrays["pixel"] < settings.width_px * settings.height_px)).all():
            raise MapError("its ferns look beside the image", fix=_REBUILD)
        size = (settings.width_px, settings.height_px)
        made._ferns = Ferns(size, settings.blur_px, *(arrays[name] for name in shapes))
        words = {name.removeprefix("words_"): array for name, array in arrays.items() if name.startswith("words_")}
        made._keyframes = [KeyframeId(int(number)) for number in keyframes]
        made._rows = {number: row for row, number in enumerate(made._keyframes)}
        if len(made._rows) < len(keyframes):
            raise MapError("it knows a keyframe twice", fix=_REBUILD)
        if stated.format != _FIRST_FORMAT:
            words = kept_words.unpacked(words, made._keyframes, on_disk)
        made._words = Vocabulary.from_arrays(words, made._settings.words, len(keyframes))
        made._codes = np.concatenate([codes, np.zeros((16, codes.shape[1]), np.uint64)])
        return made

    def _texts(self) -> dict[str, str]:
        return {"format": FORMAT, "settings": json.dumps(self._settings.model_dump(mode="json"))}

    def _described(self, view: Keyframe | SeenView) -> tuple[UInt64Array, UInt64Array]:
        """The code of ferns, and descriptors (N, 4)."""
        if isinstance(view, Keyframe):
            images, features = (view.depth_m, view.grey), view.features or NO_FEATURES
        else:
            images, features = (view.grid.levels[0].depth_m, view.grid.levels[0].grey), view.features
        return self._ferns.code(*images), features.descriptors

    def _fused(self, likeness: Float32Array, votes: Float32Array) -> list[tuple[int, float]]:
        """Rows and scores, the best first: by the sum of 1 / rank in both orders (Cormack et al. 2009)."""
        scores: dict[int, float] = {}
        rank = self._settings.fused_rank
        for told in (likeness, votes):
            order = np.empty(self._settings.ranked, np.int64)
            found = _likeness_kernels.best(told, order)
            for place, row in enumerate(order[:found].tolist()):
                scores[row] = scores.get(row, 0.0) + 0.5 * (rank + 1) / (rank + 1 + place)
        return sorted(scores.items(), key=lambda item: (-item[1], item[0]))


class _Stated:
    """What the headers of a file say, before more than its settings are unpacked.

    Raises:
        MapError: it is of another format, of other settings, or larger than its keyframes need.
        ValueError, KeyError: it is damaged.
    """

    def __init__(self, file: ArrayFile, expected: RecognitionSettings | None, most_keyframes: int | None) -> None:
        self._file = file
        self.format = file.read("format", _LONGEST_TEXT).tobytes().decode(errors="replace")
        if self.format not in (FORMAT, _FIRST_FORMAT):
            raise MapError(f"is of format {self.format!r}, not {FORMAT!r}", fix=_REBUILD)
        told = parse_json(file.read("settings", _LONGEST_TEXT).tobytes())
        self.settings = RecognitionSettings.model_validate(told)
        if expected is not None and self.settings != expected:
            raise MapError("is of other settings", fix=_REBUILD)
        (self._keyframes,) = file.headers["keyframes"].shape
        if most_keyframes is not None and self._keyframes > most_keyframes:
            problem = f"knows {self._keyframes:,} keyframes, and its map has {most_keyframes:,}"
            raise MapError(problem, fix=_REBUILD)
        if most_keyframes is None and sum(header.nbytes for header in file.headers.values()) > _MOST_BYTES:
            raise MapError(f"states more than {_MOST_BYTES >> 20:,} MB of codes", fix=_REBUILD)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All, each no larger than so many keyframes need."""
        words, ferns = self.settings.words, self.settings.ferns.ferns
        postings = self._keyframes * words.descriptors
        # A node is made with a descriptor of its own, and each inner one has two children at least.
        nodes = min(words.most_nodes, 2 * postings + 1)
        # Of the first format blocks are stated, those in use and those to be used again.
        blocks = 2 * (postings // BLOCK + nodes + words.branching)
        most = {"codes": self._keyframes * ferns // 2, "words_centre": 32 * nodes, "words_own": 32 * postings}
        most |= dict.fromkeys(("pixel", "grey", "depth_m"), 16 * ferns)
        most |= {"keyframes": 8 * self._keyframes, "words_place": 2 * postings}
        if self.format == _FIRST_FORMAT:
            most |= {"words_row": 4 * BLOCK * blocks, "words_descriptor": 32 * BLOCK * blocks}
            most |= {"words_following": 4 * blocks}
        else:
            most |= {"words_row": 4 * postings}
        known = {"format": _LONGEST_TEXT, "settings": _LONGEST_TEXT, **most}
        rest = max(4 * nodes, _SMALL_BYTES)
        return {name: self._file.read(name, known.get(name, rest)) for name in self._file.headers}

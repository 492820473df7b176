"""`KeyframeStore` holds the keyframes and their poses; everything else refers to a keyframe by its `KeyframeId`.
`ReferenceModel` is the interface by which odometry asks a map for a `PredictedView`.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NewType, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.geometry import Float32Array, FloatArray, IntArray, se3
from wheelsight.core.threads import OneCaller, one_at_a_time

# Keyframes have an identity and no pose: one table, the store, holds where they are.
#
# All that remembers a place remembers a keyframe and where it is relative to it. Who holds positions in the map
# follows the store: it asks how keyframes have moved since it asked last, and moves what hangs on them.


KeyframeId = NewType("KeyframeId", int)
"""Names a keyframe: its number in the store, for good."""

# Depth in files of the field: 16 bits, a fifth of a millimetre each; up to 13 m.
_DEPTH_UNITS_PER_M = 5000.0


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeFeatures:
    """Keypoints of a keyframe, by which it is recognised and verified.

    Attributes:
        px: (N, 2) where they were detected, pixels of the colour camera.
        points: (N, 3) in the keyframe's frame, metres; 0 where there is no depth.
        descriptors: (N, 4) uint64, the 256 bits of ORB.
    """

    px: FloatArray
    points: FloatArray
    descriptors: NDArray[np.uint64]


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A camera frame that is kept: what was seen, not where.

    Attributes:
        stamp_s: of the frame, seconds.
        intrinsics: (4,) fx, fy, cx, cy of the ideal camera that its images are of.
        depth_png, grey_png: its images, compressed; see `depth_m` and `grey`.
        features: keypoints, or None.
        code: (D,) for recognition, or None.
    """

    stamp_s: float
    intrinsics: FloatArray
    depth_png: bytes
    grey_png: bytes
    features: KeyframeFeatures | None = None
    code: FloatArray | None = None

    @classmethod
    def of_images(
        cls,
        stamp_s: float,
        intrinsics: FloatArray,
        depth_m: Float32Array,
        grey: Float32Array,
        features: KeyframeFeatures | None = None,
    ) -> Keyframe:
        """From depth (h, w) in metres, 0 where unknown, and grey (h, w) from 0 to 255, below 0 where unknown."""
        units = np.clip(np.rint(depth_m * _DEPTH_UNITS_PER_M), 0, np.iinfo(np.uint16).max).astype(np.uint16)
        return cls(stamp_s, intrinsics, _png(units), _png(np.clip(np.rint(grey), 0, 255).astype(np.uint8)), features)

    @property
    def depth_m(self) -> Float32Array:
        """(h, w) metres, in steps of 0.2 mm; 0 where unknown."""
        return _image(self.depth_png).astype(np.float32) / np.float32(_DEPTH_UNITS_PER_M)

    @property
    def grey(self) -> Float32Array:
        """(h, w) from 0 to 255; 0 where unknown."""
        return _image(self.grey_png).astype(np.float32)


class KeyframeStore(OneCaller):
    """All keyframes, and the only table of where they are.

    To compress a keyframe's images takes as long as to track a frame: a thread of the store does it beside the next.
    One keyframe at a time is in the making. An error in it is raised where the next one is added, where the store is
    closed, and wherever that keyframe is asked for.

    Who has written keyframes to disk may let them rest there, see `hold` and `rest`; else all stay in memory.

    Attributes:
        revision: grows each time keyframes are moved; adding one moves none.
        is_written: whether somebody writes all its keyframes to a map, where they rest.
    """

    def __init__(self) -> None:
        self._keyframes: list[Keyframe | Future[Keyframe] | None] = []  # None where it rests on disk
        self._T_map_keyframe = np.zeros((16, 4, 4))
        self._followers: list[Follower] = []
        self._thread: ThreadPoolExecutor | None = None
        self._making: Future[Keyframe] | None = None
        self._most: int | None = None
        self._readers: dict[int, Callable[[], Keyframe]] = {}
        self._tied: dict[int, int] = {}
        self._unreleased: deque[int] = deque()
        self._read: OrderedDict[int, Keyframe] = OrderedDict()
        self._lock = threading.Lock()
        self.revision, self.is_written = 0, False

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[KeyframeId]:
        return (KeyframeId(number) for number in range(len(self)))

    def __getitem__(self, number: KeyframeId) -> Keyframe:
        """Raises ArgumentError for a keyframe that it does not hold, and MapError where it cannot be read."""
        self._check([number])
        keyframe = self._keyframes[number]
        if isinstance(keyframe, Future):
            keyframe = self._keyframes[number] = keyframe.result()
        return self._from_disk(number) if keyframe is None else keyframe

    def recalled(self, number: KeyframeId, at: KeyframeId) -> Keyframe:
        """A keyframe as it is remembered once another one is the newest: as it rests, if by then it may.

        That goes by both numbers, and not by how far another thread is: the same drive recalls the same each time.
        Raises as asking for it does.
        """
        self._check([number])
        if self._most is not None and at - number >= self._most and number in self._readers:
            return self._from_disk(number)
        return self[number]

    def hold(self, keyframes: int) -> None:
        """Let keyframes rest that so many newer ones follow; of those that rest so many are held that were read last.

        One is given up after twice as many, so that threads that lag behind recall what they would have in time.
        """
        self._most = keyframes

    def rest(self, number: KeyframeId, read: Callable[[], Keyframe]) -> None:
        """A keyframe that is made may rest: `read` gives it again, somewhat coarser, from any thread."""
        with self._lock:
            self._readers[number] = read
            self._unreleased.append(number)
        self._release()

    @property
    def T_map_keyframe(self) -> FloatArray:
        """Poses (N, 4, 4) of all keyframes, by number; not to be written to."""
        view = self._T_map_keyframe[: len(self)]
        view.setflags(write=False)
        return view

    def pose(self, number: KeyframeId) -> FloatArray:
        """T_map_keyframe (4, 4), a copy. Raises ArgumentError for a keyframe that it does not hold."""
        self._check([number])
        return np.array(self._T_map_keyframe[number])

    @one_at_a_time
    def add(self, keyframe: Keyframe | Callable[[], Keyframe], T_map_keyframe: ArrayLike) -> KeyframeId:
        """Keep a keyframe, or one that is yet to be made, at a pose (4, 4) by what is known now.

        What it is made of may not be written to any more. Raises what went wrong with the one before.
        """
        kept, number = self._made(keyframe), len(self)
        if number == len(self._T_map_keyframe):
            self._T_map_keyframe = np.concatenate([self._T_map_keyframe, np.zeros_like(self._T_map_keyframe)])
        self._T_map_keyframe[number] = np.asarray(T_map_keyframe, float)
        self._keyframes.append(kept)
        self._release()
        return KeyframeId(number)

    @one_at_a_time
    def replace(self, number: KeyframeId, keyframe: Keyframe | Callable[[], Keyframe]) -> None:
        """Keep better images of the same frame in a keyframe's place.

        Raises as `add` does, and ArgumentError where it holds none.
        """
        self._check([number])
        self._keyframes[number] = self._made(keyframe)

    def close(self) -> None:
        """Wait until all are made, and end the thread; all stay, and who adds more starts another thread.

        Raises what went wrong with the last one.
        """
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.shutdown()
        self._finish()

    @one_at_a_time
    def move(self, numbers: Sequence[KeyframeId], T_map_keyframe: ArrayLike) -> None:
        """Put keyframes to new poses (K, 4, 4); all that follows them is told. Raises ArgumentError."""
        self._check(numbers)
        rows, T = np.asarray(numbers, np.int64), np.asarray(T_map_keyframe, float).reshape(-1, 4, 4)
        if len(T) != len(rows) or len(np.unique(rows)) != len(rows):
            raise ArgumentError(f"{len(rows)} keyframes and {len(T)} poses", fix="give each keyframe once, with a pose")
        if not np.isfinite(T).all():
            raise ArgumentError("T_map_keyframe has numbers that are not finite", fix="give rigid motions")
        if not len(rows):
            return
        T = se3.mended(T)
        T_new_old = T @ se3.invert(self._T_map_keyframe[rows])
        self._T_map_keyframe[rows] = T
        self.revision += 1
        for follower in self._followers:
            follower.hear(rows, T_new_old, len(self))

    def tie(self, first: KeyframeId, second: KeyframeId) -> None:
        """A loop that is kept ties two keyframes."""
        for number in (first, second):
            self._tied[number] = max(self._tied.get(number, 0), abs(second - first))

    def tied_over(self, number: KeyframeId) -> int:
        """Over how many keyframes loops tie one, at most; 0 where none does."""
        return self._tied.get(number, 0)

    def follow(self) -> Follower:
        """For someone who holds positions in the map that hang on keyframes."""
        follower = Follower()
        self._followers.append(follower)
        return follower

    def _release(self) -> None:
        """Give up the images of those that have rested long enough."""
        with self._lock:
            while self._most is not None and self._unreleased:
                if len(self) - 1 - self._unreleased[0] < 2 * self._most:
                    return
                self._keyframes[self._unreleased.popleft()] = None

    def _from_disk(self, number: KeyframeId) -> Keyframe:
        """One that rests; those asked for last are still at hand."""
        with self._lock:
            held = self._read.get(number)
            if held is not None:
                self._read.move_to_end(number)
                return held
        read = self._readers[number]()
        with self._lock:
            self._read[number] = read
            while self._most is not None and len(self._read) > self._most:
                self._read.popitem(last=False)
        return read

    def _made(self, keyframe: Keyframe | Callable[[], Keyframe]) -> Keyframe | Future[Keyframe]:
        if isinstance(keyframe, Keyframe):
            return keyframe
        self._finish()
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "wheelsight-keyframes")
        self._making = self._thread.submit(keyframe)
        return self._making

    def _finish(self) -> None:
        """Wait for the one in the making, and raise what went wrong with it, once."""
        making, self._making = self._making, None
        if making is not None:
            making.result()

    def _check(self, numbers: Sequence[KeyframeId]) -> None:
        for number in numbers:
            if not 0 <= number < len(self):
                raise ArgumentError(f"there is no keyframe {number}", fix=f"numbers go from 0 to {len(self) - 1}")


class Follower:
    """How keyframes have moved since it was asked last."""

    def __init__(self) -> None:
        self._T_new_old: FloatArray | None = None

    def hear(self, rows: IntArray, T_new_old: FloatArray, count: int) -> None:
        """Keyframes (K,) of `count` have moved by (K, 4, 4), from the left, in the map."""
        known = np.zeros((0, 4, 4)) if self._T_new_old is None else self._T_new_old
        if len(known) < count:
            known = np.concatenate([known, np.tile(np.eye(4), (count - len(known), 1, 1))])
        known[rows] = se3.mended(T_new_old @ known[rows])
        self._T_new_old = known

    def moves(self) -> FloatArray | None:
        """T_new_old (N, 4, 4) by keyframe, of those held by then, since it was asked last; None if none has moved."""
        moved, self._T_new_old = self._T_new_old, None
        return moved


def _png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    # Noise has hardly any strings that come again: by Huffman codes alone it is as small, in half of the time.
    written, code = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY])
    assert written
    return code.tobytes()


def _image(code: bytes) -> NDArray[Any]:
    image = cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_UNCHANGED) if code else None
    if image is None:
        raise MapError("an image of a keyframe cannot be decoded", fix="build the map anew")
    return np.asarray(image)


# What odometry and a map tell each other without knowing each other: a view from a pose, and a surface to add.


@dataclass(frozen=True, slots=True, eq=False)
class PredictedView:
    """What a model looks like from a pose, on the ideal grid at the finest level.

    Attributes:
        depth_m: (h, w) float32, 0 where the model has nothing.
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown.
        grey: (h, w) float32, -1 where unknown.
    """

    depth_m: Float32Array
    normal: Float32Array
    grey: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What a tracked frame adds to a map, on the ideal grid at the finest level.

    Attributes:
        depth_m: (h, w) float32, 0 where unknown.
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown: such pixels add nothing.
        grey: (h, w) float32 from 0 to 255, -1 where unknown.
        color: (h, w, 3) float32 red, green, blue from 0 to 255, -1 where unknown; or None.
    """

    depth_m: Float32Array
    normal: Float32Array
    grey: Float32Array
    color: Float32Array | None = None


class ReferenceModel(Protocol):
    """Predicts what the camera sees from a pose: a surfel map, for instance."""

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        """The view (h, w) = `shape` of a camera with `intrinsics` (4,) fx, fy, cx, cy at a pose (4, 4)."""

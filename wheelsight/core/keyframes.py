"""`KeyframeStore` holds the keyframes and their poses; everything else refers to a keyframe by its `KeyframeId`.
`ReferenceModel` is the interface of a map that predicts a `PredictedView` for odometry.
"""

from __future__ import annotations

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
from wheelsight.core.threads import LOCK, OneCaller, in_span, new_lock, one_at_a_time

# A keyframe has an identity and no pose: the store is the only table of poses. A remembered place is a keyframe and a
# pose relative to it. An object that holds positions in the map follows the store: it asks for the motion of keyframes
# since its last call, and moves the positions that refer to them.

KeyframeId = NewType("KeyframeId", int)
"""The permanent number of a keyframe in the store."""

# Depth in files of the TUM format: 16 bits, a fifth of a millimetre each; up to 13 m.
_DEPTH_UNITS_PER_M = 5000.0


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeFeatures:
    """Keypoints of a keyframe, for recognition and verification.

    Attributes:
        px: (N, 2) detected pixels of the colour camera.
        points: (N, 3) in the keyframe's frame, metres; 0 without depth.
        descriptors: (N, 4) uint64, the 256 bits of ORB.
    """

    px: FloatArray
    points: FloatArray
    descriptors: NDArray[np.uint64]


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """The images and features of a camera frame, without its pose.

    Attributes:
        stamp_s: time of the frame, seconds.
        intrinsics: (4,) fx, fy, cx, cy of the ideal camera of its images.
        depth_png, grey_png: compressed images; see `depth_m` and `grey`.
        features: keypoints, or None.
        code: (D,) descriptor for recognition, or None.
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
    """All keyframes, and the only table of their poses.

    Compression of a keyframe's images takes as long as tracking a frame, so a thread of the store does it, one keyframe
    at a time. `add`, `close` and access to that keyframe raise its error.

    Keyframes on disk may be released from memory, see `limit_memory` and `keep_on_disk`; else all stay in memory.

    Attributes:
        revision: number of calls that moved keyframes; adding one moves none.
        is_written: whether a map on disk receives all keyframes.
    """

    def __init__(self) -> None:
        self._keyframes: list[Keyframe | Future[Keyframe] | None] = []  # None for one on disk
        self._T_map_keyframe = np.zeros((16, 4, 4))
        self._followers: list[Follower] = []
        self._thread: ThreadPoolExecutor | None = None
        self._making: Future[Keyframe] | None = None
        self._most: int | None = None
        self._readers: dict[int, Callable[[], Keyframe]] = {}
        self._loop_spans: dict[int, int] = {}
        self._unreleased: deque[int] = deque()
        self._read: OrderedDict[int, Keyframe] = OrderedDict()
        self._lock = new_lock("keyframes on disk")
        self.revision, self.is_written = 0, False

    def __len__(self) -> int:
        return len(self._keyframes)

    def __iter__(self) -> Iterator[KeyframeId]:
        return (KeyframeId(number) for number in range(len(self)))

    def __getitem__(self, number: KeyframeId) -> Keyframe:
        """Raises ArgumentError for an unknown keyframe, and MapError if it cannot be read."""
        self._check([number])
        keyframe = self._keyframes[number]
        if isinstance(keyframe, Future):
            keyframe = self._keyframes[number] = in_span("wait for a keyframe", keyframe.result, LOCK)
        return self._from_disk(number) if keyframe is None else keyframe

    def as_of(self, number: KeyframeId, at: KeyframeId) -> Keyframe:
        """Return a keyframe as it is in the store when keyframe `at` is the newest: from disk if it is old enough.

        Only the numbers decide, not the progress of another thread, so the result is reproducible. Raises as
        `__getitem__` does.
        """
        self._check([number])
        if self._most is not None and at - number >= self._most and number in self._readers:
            return self._from_disk(number)
        return self[number]

    def limit_memory(self, keyframes: int) -> None:
        """Read keyframes from disk once `keyframes` newer ones follow, with a cache of as many recently used ones.

        Memory is released after twice as many, so that threads that lag behind read the same images.
        """
        self._most = keyframes

    def keep_on_disk(self, number: KeyframeId, read: Callable[[], Keyframe]) -> None:
        """Register the reader of a keyframe on disk: `read` returns it, somewhat coarser, from any thread."""
        with self._lock:
            self._readers[number] = read
            self._unreleased.append(number)
        self._release()

    @property
    def T_map_keyframe(self) -> FloatArray:
        """Poses (N, 4, 4) of all keyframes, by number; read only."""
        view = self._T_map_keyframe[: len(self._keyframes)]
        view.setflags(write=False)
        return view

    def pose(self, number: KeyframeId) -> FloatArray:
        """T_map_keyframe (4, 4), a copy. Raises ArgumentError for an unknown keyframe."""
        self._check([number])
        return np.array(self._T_map_keyframe[number])

    @one_at_a_time
    def add(self, keyframe: Keyframe | Callable[[], Keyframe], T_map_keyframe: ArrayLike) -> KeyframeId:
        """Add a keyframe, or a function that makes it in the background, at a pose (4, 4), and return its number.

        The inputs of the function must not change later. Raises the error of the previous keyframe's function.
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
        """Replace a keyframe by better images of the same frame.

        Raises as `add` does, and ArgumentError for an unknown keyframe.
        """
        self._check([number])
        self._keyframes[number] = self._made(keyframe)

    def close(self) -> None:
        """Wait until all keyframes are made, and end the thread; a later `add` starts another one.

        Raises the error of the last keyframe's function.
        """
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.shutdown()
        self._finish()

    @one_at_a_time
    def move(self, numbers: Sequence[KeyframeId], T_map_keyframe: ArrayLike) -> None:
        """Set new poses (K, 4, 4) of keyframes, and notify all followers. Raises ArgumentError."""
        self._check(numbers)
        rows, T = np.asarray(numbers, np.int64), np.asarray(T_map_keyframe, float).reshape(-1, 4, 4)
        if len(T) != len(rows) or len(np.unique(rows)) != len(rows):
            raise ArgumentError(f"{len(rows)} keyframes and {len(T)} poses", fix="give each keyframe once, with a pose")
        if not np.isfinite(T).all():
            raise ArgumentError("T_map_keyframe has numbers that are not finite", fix="give rigid motions")
        if not len(rows):
            return
        T = se3.renormalized(T)
        T_new_old = T @ se3.invert(self._T_map_keyframe[rows])
        self._T_map_keyframe[rows] = T
        self.revision += 1
        for follower in self._followers:
            follower.add(rows, T_new_old, len(self))

    def add_loop(self, first: KeyframeId, second: KeyframeId) -> None:
        """Record a loop closure between two keyframes."""
        for number in (first, second):
            self._loop_spans[number] = max(self._loop_spans.get(number, 0), abs(second - first))

    def loop_span(self, number: KeyframeId) -> int:
        """Return the largest number of keyframes that a loop closure of this one spans; 0 without loop closure."""
        return self._loop_spans.get(number, 0)

    def follow(self) -> Follower:
        """Return a new follower, for an object that holds positions relative to keyframes."""
        follower = Follower()
        self._followers.append(follower)
        return follower

    def _release(self) -> None:
        """Release the images of keyframes on disk that are old enough."""
        with self._lock:
            while self._most is not None and self._unreleased:
                if len(self) - 1 - self._unreleased[0] < 2 * self._most:
                    return
                self._keyframes[self._unreleased.popleft()] = None

    def _from_disk(self, number: KeyframeId) -> Keyframe:
        """A keyframe on disk, through a cache of recently used ones."""
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
        self._making = self._thread.submit(in_span, "make a keyframe", keyframe)
        return self._making

    def _finish(self) -> None:
        """Wait for the keyframe in the background, and raise its error once."""
        making, self._making = self._making, None
        if making is not None:
            in_span("wait for a keyframe", making.result, LOCK)

    def _check(self, numbers: Sequence[KeyframeId]) -> None:
        for number in numbers:
            if not 0 <= number < len(self._keyframes):
                raise ArgumentError(f"there is no keyframe {number}", fix=f"numbers go from 0 to {len(self) - 1}")


class Follower:
    """Accumulates the motion of keyframes between two calls of `moves`."""

    def __init__(self) -> None:
        self._T_new_old: FloatArray | None = None

    def add(self, rows: IntArray, T_new_old: FloatArray, count: int) -> None:
        """Add the motion (K, 4, 4), from the left in the map, of keyframes (K,) out of `count`."""
        known = np.zeros((0, 4, 4)) if self._T_new_old is None else self._T_new_old
        if len(known) < count:
            known = np.concatenate([known, np.tile(np.eye(4), (count - len(known), 1, 1))])
        known[rows] = se3.renormalized(T_new_old @ known[rows])
        self._T_new_old = known

    def moves(self) -> FloatArray | None:
        """T_new_old (N, 4, 4) by keyframe number since the last call; None if none has moved."""
        moved, self._T_new_old = self._T_new_old, None
        return moved


def _png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    # Noise has few repeated strings: Huffman codes alone compress it as well in half of the time.
    written, code = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY])
    assert written
    return code.tobytes()


def _image(code: bytes) -> NDArray[Any]:
    image = cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_UNCHANGED) if code else None
    if image is None:
        raise MapError("an image of a keyframe cannot be decoded", fix="build the map again")
    return np.asarray(image)


@dataclass(frozen=True, slots=True, eq=False)
class PredictedView:
    """The view of a model from a pose, on the ideal grid at the finest level.

    Attributes:
        depth_m: (h, w) float32, 0 where the model is empty.
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown.
        grey: (h, w) float32, -1 where unknown.
    """

    depth_m: Float32Array
    normal: Float32Array
    grey: Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class FrameSurface:
    """The surface that a tracked frame adds to a map, on the ideal grid at the finest level.

    Attributes:
        depth_m: (h, w) float32, 0 where unknown.
        normal: (h, w, 3) float32 in the camera frame, towards the camera; 0 where unknown; such pixels are ignored.
        grey: (h, w) float32 from 0 to 255, -1 where unknown.
        color: (h, w, 3) float32 red, green, blue from 0 to 255, -1 where unknown; or None.
    """

    depth_m: Float32Array
    normal: Float32Array
    grey: Float32Array
    color: Float32Array | None = None


class ReferenceModel(Protocol):
    """Predicts the view from a pose, as a surfel map does."""

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        """Return the view (h, w) = `shape` of a camera with `intrinsics` (4,) fx, fy, cx, cy at a pose (4, 4)."""

"""RestingKeyframes: keyframes of a drive that writes no map rest in a temporary file, as they are."""

from __future__ import annotations

import os
import tempfile
import weakref
from functools import partial
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from wheelsight.errors import MapError
from wheelsight.files import StrPath
from wheelsight.keyframes import Keyframe, KeyframeFeatures, KeyframeId, KeyframeStore
from wheelsight.settings import LocalizerSettings

_LOST = "the disk is full or gone: free some, or drive on without this keyframe"


class RestingKeyframes:
    """Bounds the memory of a store whose keyframes nobody writes to a map; what comes back is the same to the last bit.

    A keyframe goes once so many newer ones follow. Where the file cannot be written, all stay in memory from then on.

    Args:
        store: of the odometry.
        memory_keyframes: see `KeyframeStore.hold`.
        folder: in which the file is made once it is needed; None for the system's.
    """

    def __init__(self, store: KeyframeStore, memory_keyframes: int, folder: StrPath | None = None) -> None:
        self._store, self._most, self._folder = store, memory_keyframes, folder
        self._next = len(store)  # those before are of a map, which has them
        self._file: BinaryIO | None = None
        self._end, self._has_disk = 0, True

    def look(self) -> None:
        """Take what a frame has added to the store."""
        while self._has_disk and not self._store.is_written and self._next < len(self._store) - self._most:
            number, self._next = KeyframeId(self._next), self._next + 1
            try:
                keyframe = self._store[number]
            except Exception:  # whatever went wrong in making it: the store tells who asks for it
                continue
            try:
                self._put(number, keyframe)
            except OSError:
                self._has_disk = False

    def _put(self, number: KeyframeId, keyframe: Keyframe) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - as long as the store may read
            weakref.finalize(self._store, self._file.close)
            self._store.hold(self._most)
        arrays = _arrays_of(keyframe)
        self._file.seek(self._end)
        for array in arrays:
            self._file.write(array.tobytes())
        self._file.flush()
        like = [(array.dtype, array.shape) for array in arrays]
        self._store.rest(number, partial(_read, self._file, self._end, like))
        self._end = self._file.tell()


def resting_keyframes(store: KeyframeStore | None, settings: LocalizerSettings) -> RestingKeyframes | None:
    """What bounds a store's memory by the settings; None without a store, or where all are to stay."""
    if store is None or settings.memory_keyframes is None:
        return None
    return RestingKeyframes(store, settings.memory_keyframes, settings.resting_folder)


def _arrays_of(keyframe: Keyframe) -> list[NDArray[np.generic]]:
    """Numbers of all that it has; of features and code nothing where there are none."""
    images = [np.frombuffer(png, np.uint8) for png in (keyframe.depth_png, keyframe.grey_png)]
    features, code = keyframe.features, keyframe.code
    arrays: list[NDArray[np.generic]] = [np.array([keyframe.stamp_s]), keyframe.intrinsics, *images]
    arrays += [np.zeros(0) if code is None else code]
    return arrays if features is None else [*arrays, features.px, features.points, features.descriptors]


def _read(file: BinaryIO, begin: int, like: list[tuple[np.dtype[np.generic], tuple[int, ...]]]) -> Keyframe:
    """What `_arrays_of` told. Raises MapError."""
    sizes = [dtype.itemsize * int(np.prod(shape)) for dtype, shape in like]
    try:
        data = os.pread(file.fileno(), sum(sizes), begin)  # from any thread, while another one writes
    except OSError as error:
        raise MapError(f"a keyframe cannot be read again: {error}", fix=_LOST) from error
    if len(data) != sum(sizes):
        raise MapError("a keyframe that rests on disk is cut off", fix=_LOST)
    ends = np.cumsum(sizes)
    parts = [
        np.frombuffer(data[end - size : end], dtype).reshape(shape)
        for end, size, (dtype, shape) in zip(ends, sizes, like, strict=True)
    ]
    (stamp_s,), intrinsics, depth, grey, code, *of_features = parts
    features = KeyframeFeatures(*of_features) if of_features else None
    return Keyframe(float(stamp_s), intrinsics, depth.tobytes(), grey.tobytes(), features, code if len(code) else None)

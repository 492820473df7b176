"""Words as a file has them: no room between postings, and no descriptor that a keyframe on disk has, too.

A descriptor is 32 bytes of bits that look random, so that no compression makes it smaller. Most of those that words
hold are of keypoints that stand in their keyframe's own record; of these the file has the place there.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wheelsight.errors import MapError
from wheelsight.geometry import IntArray
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.keyframes import KeyframeId
from wheelsight.places._word_kernels import BLOCK

Descriptors = Callable[[KeyframeId], UInt64Array]
"""The descriptors (N, 4) that the record of a keyframe on disk holds; none where there is no such record."""

Arrays = dict[str, NDArray[Any]]
_OF_NODES = ("centre", "first", "children", "level", "postings", "limit")
_OWN = np.iinfo(np.uint16).max
_REBUILD = "build the map anew"


def packed(arrays: Mapping[str, NDArray[Any]], keyframes: Sequence[KeyframeId], on_disk: Descriptors) -> Arrays:
    """What a file has of `Vocabulary.arrays`: nodes, and of each posting, word by word, `row` and `place` (P,).

    `place` is that of its descriptor among those of its keyframe on disk, or the largest number for those that stand in
    `own` (Q, 4). `check` is a checksum of all rows and descriptors.
    """
    slots = _slots(arrays["postings"], _chain(arrays))
    row, descriptor = arrays["row"].reshape(-1)[slots], arrays["descriptor"].reshape(-1, 4)[slots]
    place = np.full(len(row), _OWN, np.uint16)
    for number, of_keyframe in _by_rows(row, keyframes):
        places = {one.tobytes(): at for at, one in enumerate(on_disk(number)[:_OWN])}
        place[of_keyframe] = [places.get(one.tobytes(), _OWN) for one in descriptor[of_keyframe]]
    told = {name: arrays[name] for name in _OF_NODES}
    return told | {"row": row, "place": place, "own": descriptor[place == _OWN], "check": _check(row, descriptor)}


def unpacked(kept: Mapping[str, NDArray[Any]], keyframes: Sequence[KeyframeId], on_disk: Descriptors) -> Arrays:
    """What `packed` was given, but for numbers of blocks. Raises MapError where the file or the disk has another."""
    counts, row, place, own = (kept[name] for name in ("postings", "row", "place", "own"))
    is_table = counts.ndim == row.ndim == 1 and row.shape == place.shape and own.shape == (np.sum(place == _OWN), 4)
    is_of_words = counts.dtype == row.dtype == np.int32 and place.dtype == np.uint16 and own.dtype == np.uint64
    if not is_table or not is_of_words or (counts < 0).any() or counts.sum(dtype=np.int64) != len(row):
        raise MapError("its words contradict themselves", fix=_REBUILD)
    descriptor = np.empty((len(row), 4), np.uint64)
    descriptor[place == _OWN] = own
    for number, of_keyframe in _by_rows(row, keyframes):
        known = of_keyframe[place[of_keyframe] < _OWN]
        found = on_disk(number) if len(known) else own
        if len(known) and place[known].max() >= len(found):
            raise MapError(f"keyframe {number} lacks keypoints that its words are of", fix=_REBUILD)
        descriptor[known] = found[place[known]]
    if _check(row, descriptor) != kept["check"]:
        raise MapError("its words are of other keypoints", fix=_REBUILD)
    return {name: kept[name] for name in _OF_NODES} | _in_blocks(counts, row, descriptor)


def _by_rows(row: NDArray[np.int32], keyframes: Sequence[KeyframeId]) -> Iterator[tuple[KeyframeId, IntArray]]:
    """Each keyframe that has postings, and which (K,) these are. Raises MapError for a row that is none."""
    if len(row) and not 0 <= row.min() <= row.max() < len(keyframes):
        raise MapError("its words are of keyframes that it does not know", fix=_REBUILD)
    order = np.argsort(row, kind="stable")
    ends = np.searchsorted(row[order], np.arange(len(keyframes) + 1))
    for number, begin, end in zip(keyframes, ends[:-1], ends[1:], strict=True):
        if begin < end:
            yield number, order[begin:end]


def _chain(arrays: Mapping[str, NDArray[Any]]) -> IntArray:
    """All blocks in use, word by word, as they follow each other."""
    counts = arrays["postings"]
    blocks = -(-counts // BLOCK)
    into, left, at = (np.cumsum(blocks) - blocks)[counts > 0], blocks[counts > 0], arrays["head"][counts > 0]
    chain = np.empty(blocks.sum(), np.int64)
    while len(at):
        chain[into] = at
        goes_on = left > 1
        into, left, at = into[goes_on] + 1, left[goes_on] - 1, arrays["following"][at[goes_on]]
    return chain


def _slots(counts: NDArray[np.int32], chain: IntArray) -> IntArray:
    """(P,) where each posting is, of all slots of all blocks, word by word."""
    blocks, counts = -(-counts // BLOCK), counts.astype(np.int64)
    nth = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    first = np.repeat(np.cumsum(blocks) - blocks, counts)
    return np.asarray(chain[first + nth // BLOCK] * BLOCK + nth % BLOCK)


def _in_blocks(counts: NDArray[np.int32], row: NDArray[np.int32], descriptor: UInt64Array) -> Arrays:
    """What `Vocabulary.from_arrays` takes of postings: each word's blocks one after the other, none of them free."""
    blocks = (-(-counts // BLOCK)).astype(np.int32)
    end, count, has_any = np.cumsum(blocks, dtype=np.int32), int(blocks.sum()), counts > 0
    following = np.arange(1, count + 1, dtype=np.int32)
    following[end[has_any] - 1] = -1
    slots = _slots(counts, np.arange(count))
    rows, descriptors = np.zeros(count * BLOCK, np.int32), np.zeros((count * BLOCK, 4), np.uint64)
    rows[slots], descriptors[slots] = row, descriptor
    return {
        "sizes": np.array([len(counts), count, -1, len(row)]),
        "head": np.where(has_any, end - blocks, np.int32(-1)),
        "tail": np.where(has_any, end - 1, np.int32(-1)),
        "used": np.where(has_any, counts - BLOCK * (blocks - 1), np.int32(0)),
        "following": following,
        "row": rows.reshape(-1, BLOCK),
        "descriptor": descriptors.reshape(-1, BLOCK, 4),
    }


def _check(row: NDArray[np.int32], descriptor: UInt64Array) -> NDArray[np.uint32]:
    crc = zlib.crc32(row.astype("<i4").tobytes())
    return np.array(zlib.crc32(descriptor.astype("<u8").tobytes(), crc), np.uint32)

"""`Vocabulary` is an incremental tree of binary words with an inverted index of keyframes.

The tree is that of Nistér & Stewénius 2006, with the binary words of Gálvez-López & Tardós 2012. Nothing is trained
beforehand: a full word is split into clusters of its own descriptors. So there are as many words as the place needs,
without a vocabulary file.

In files, postings are packed without gaps, and without descriptors that keyframes have. A descriptor is 32 bytes of
seemingly random bits, which do not compress. Most descriptors of words belong to keypoints in a keyframe's own record,
and the file has their position there.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from wheelsight.core.errors import MapError
from wheelsight.core.geometry import Float32Array, IntArray
from wheelsight.core.geometry.arrays import UInt64Array
from wheelsight.core.keyframes import KeyframeId
from wheelsight.places.recognition_kernels import BLOCK, BLOCKS, FREE, NODES, TreeRules, WordTree, insert, vote

_OF_NODES = ("centre", "first", "children", "level", "postings", "limit", "head", "tail", "used")
_OF_BLOCKS = ("following", "row", "descriptor")
_FIRST_ROOM = 256
# How the tree grows: a word of 64 descriptors is split in eight, whose centres three rounds improve; up to eight levels
# and 32 000 nodes. Chosen.
RULES = TreeRules(branching=8, split_at=64, steps=3, depth=8, most_nodes=32_000)
DESCRIPTORS = 300
"""Descriptors of a keyframe that become words, 36 bytes each. Chosen."""
# Keyframes that are counted for the words of one view, those of rare words first: it bounds the time to 0.2 ms.
_MOST_POSTINGS = 10_000


class Vocabulary:
    """Words, and the keyframes, by row, that have them."""

    def __init__(self) -> None:
        self._tree = _empty(_FIRST_ROOM)
        self._tree.limit[0], self._tree.sizes[NODES] = RULES.split_at, 1

    def __len__(self) -> int:
        """Return the number of words."""
        nodes = int(self._tree.sizes[NODES])
        return int(np.count_nonzero(self._tree.children[:nodes] == 0))

    def add(self, descriptors: UInt64Array, row: int) -> None:
        """Add the descriptors (N, 4) of a keyframe, whose row is larger than all earlier ones."""
        chosen = descriptors[_evenly(len(descriptors), DESCRIPTORS)]
        # Every descriptor may split a word, which frees its blocks and needs another one in each new word.
        nodes = int(self._tree.sizes[NODES]) + len(chosen) * RULES.branching
        blocks = int(self._tree.sizes[BLOCKS]) + len(chosen) * (1 + RULES.branching)
        room = dict.fromkeys(_OF_NODES, nodes) | dict.fromkeys(_OF_BLOCKS, blocks)
        grown = {}
        for name, needed in room.items():
            array = getattr(self._tree, name)
            if len(array) < needed:
                # Unwritten pages of zeros take no memory yet.
                grown[name] = np.zeros((max(needed, 2 * len(array)), *array.shape[1:]), array.dtype)
                grown[name][: len(array)] = array
        self._tree = self._tree._replace(**grown)
        insert(self._tree, np.ascontiguousarray(chosen), row, RULES)

    def vote(self, descriptors: UInt64Array, rows: int) -> Float32Array:
        """Return the share (rows,) of the words of descriptors (N, 4), weighted by idf, that each keyframe has."""
        votes = np.empty(rows, np.float32)
        chosen = descriptors[_evenly(len(descriptors), DESCRIPTORS)]
        vote(self._tree, np.ascontiguousarray(chosen), _MOST_POSTINGS, votes)
        return votes

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all contents by name."""
        sizes = self._tree.sizes
        used = dict.fromkeys(_OF_NODES, sizes[NODES]) | dict.fromkeys(_OF_BLOCKS, sizes[BLOCKS])
        return {"sizes": sizes} | {name: getattr(self._tree, name)[:end] for name, end in used.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], rows: int) -> Self:
        """Return a vocabulary from `arrays`, with `rows` keyframes. Raises MapError for inconsistent arrays."""
        kept = _checked(WordTree(**{name: np.array(arrays[name]) for name in WordTree._fields}), rows)
        made = cls()
        made._tree = kept
        return made


def _evenly(count: int, wanted: int) -> NDArray[np.int64]:
    """Return at most `wanted` indices, evenly spaced over `count`."""
    return np.arange(count) if count <= wanted else np.linspace(0, count - 1, wanted).astype(np.int64)


def _empty(room: int) -> WordTree:
    numbers = [np.full(room, -1, np.int32) for _ in range(3)]
    counts = [np.zeros(room, np.int32) for _ in range(5)]
    first, head, tail = numbers
    children, level, words, limit, used = counts
    blocks = np.zeros((room, BLOCK), np.int32), np.zeros((room, BLOCK, 4), np.uint64)
    following, sizes = np.full(room, -1, np.int32), np.array([0, 0, -1, 0])
    centre = np.zeros((room, 4), np.uint64)
    return WordTree(sizes, centre, first, children, level, words, limit, head, tail, used, following, *blocks)


def _checked(tree: WordTree, rows: int) -> WordTree:
    """Return the tree if its indices are within it, as kernels need, and its depth and width follow `RULES`.

    Raises MapError otherwise.
    """
    expected = _empty(1)
    nodes, blocks = len(tree.centre), len(tree.row)
    for name in WordTree._fields:
        array, like = getattr(tree, name), getattr(expected, name)
        length = {**dict.fromkeys(_OF_NODES, nodes), **dict.fromkeys(_OF_BLOCKS, blocks)}.get(name, 4)
        if array.dtype != like.dtype or array.shape != (length, *like.shape[1:]):
            raise MapError(f"{name} of its words is {array.dtype}{array.shape}", fix=_REBUILD)
    inner = np.flatnonzero(tree.children)
    first, last = tree.first[inner], tree.first[inner] + tree.children[inner]

    def of_children() -> NDArray[np.int64]:
        lengths = (last - first).astype(np.int64)
        return np.asarray(np.arange(lengths.sum()) + np.repeat(first - np.cumsum(lengths) + lengths, lengths), np.int64)

    within = (
        (tree.sizes[:FREE] == (nodes, blocks)).all()
        and nodes > 0
        and (tree.children >= 0).all()
        and (tree.children <= RULES.branching).all()
        and ((first > inner) & (last <= nodes)).all()
        and _is_within(tree.level, 0, RULES.depth + 1)
        and (np.repeat(tree.level[inner] + 1, tree.children[inner]) == tree.level[of_children()]).all()
        and all(_is_within(array, -1, blocks) for array in (tree.head, tree.tail, tree.following, tree.sizes[2:3]))
        and _is_within(tree.row, 0, max(rows, 1))
        and _is_within(tree.used, 0, BLOCK + 1)
        and _is_within(tree.postings, 0, blocks * BLOCK + 1)
    )
    if not within:
        raise MapError("its words contradict themselves", fix=_REBUILD)
    return tree


def _is_within(array: NDArray[Any], least: int, end: int) -> bool:
    return bool(((array >= least) & (array < end)).all())


Descriptors = Callable[[KeyframeId], UInt64Array]
"""Returns the descriptors (N, 4) in a keyframe's record on disk; empty without a record."""

Arrays = dict[str, NDArray[Any]]
_STORED = ("centre", "first", "children", "level", "postings", "limit")
_OWN = np.iinfo(np.uint16).max
_REBUILD = "rebuild the map"


def packed(arrays: Mapping[str, NDArray[Any]], keyframes: Sequence[KeyframeId], on_disk: Descriptors) -> Arrays:
    """Return the arrays of a file: nodes, and for each posting, word by word, `row` and `place` (P,).

    `place` is the index of the descriptor among those of its keyframe on disk, or the largest number for those in `own`
    (Q, 4). `check` is a checksum of all rows and descriptors.
    """
    # All used blocks, word by word, in their order.
    counts = arrays["postings"]
    blocks = -(-counts // BLOCK)
    into, left, at = (np.cumsum(blocks) - blocks)[counts > 0], blocks[counts > 0], arrays["head"][counts > 0]
    chain = np.empty(blocks.sum(), np.int64)
    while len(at):
        chain[into] = at
        goes_on = left > 1
        into, left, at = into[goes_on] + 1, left[goes_on] - 1, arrays["following"][at[goes_on]]
    slots = _slots(counts, chain)
    row, descriptor = arrays["row"].reshape(-1)[slots], arrays["descriptor"].reshape(-1, 4)[slots]
    place = np.full(len(row), _OWN, np.uint16)
    for number, of_keyframe in _by_rows(row, keyframes):
        places = {one.tobytes(): at for at, one in enumerate(on_disk(number)[:_OWN])}
        place[of_keyframe] = [places.get(one.tobytes(), _OWN) for one in descriptor[of_keyframe]]
    nodes = {name: arrays[name] for name in _STORED}
    return nodes | {"row": row, "place": place, "own": descriptor[place == _OWN], "check": _check(row, descriptor)}


def unpacked(kept: Mapping[str, NDArray[Any]], keyframes: Sequence[KeyframeId], on_disk: Descriptors) -> Arrays:
    """Return the arrays given to `packed`, except the block numbers. Raises MapError if file and disk do not match."""
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
    # Blocks are contiguous, and none is free.
    blocks = (-(-counts // BLOCK)).astype(np.int32)
    end, count, has_any = np.cumsum(blocks, dtype=np.int32), int(blocks.sum()), counts > 0
    following = np.arange(1, count + 1, dtype=np.int32)
    following[end[has_any] - 1] = -1
    slots = _slots(counts, np.arange(count))
    rows, descriptors = np.zeros(count * BLOCK, np.int32), np.zeros((count * BLOCK, 4), np.uint64)
    rows[slots], descriptors[slots] = row, descriptor
    return {name: kept[name] for name in _STORED} | {
        "sizes": np.array([len(counts), count, -1, len(row)]),
        "head": np.where(has_any, end - blocks, np.int32(-1)),
        "tail": np.where(has_any, end - 1, np.int32(-1)),
        "used": np.where(has_any, counts - BLOCK * (blocks - 1), np.int32(0)),
        "following": following,
        "row": rows.reshape(-1, BLOCK),
        "descriptor": descriptors.reshape(-1, BLOCK, 4),
    }


def _by_rows(row: NDArray[np.int32], keyframes: Sequence[KeyframeId]) -> Iterator[tuple[KeyframeId, IntArray]]:
    """Yield each keyframe that has postings, with their indices (K,). Raises MapError for an invalid row."""
    if len(row) and not 0 <= row.min() <= row.max() < len(keyframes):
        raise MapError("its words are of keyframes that it does not know", fix=_REBUILD)
    order = np.argsort(row, kind="stable")
    ends = np.searchsorted(row[order], np.arange(len(keyframes) + 1))
    for number, begin, end in zip(keyframes, ends[:-1], ends[1:], strict=True):
        if begin < end:
            yield number, order[begin:end]


def _slots(counts: NDArray[np.int32], chain: IntArray) -> IntArray:
    """Return the slot (P,) of each posting among all slots of all blocks, word by word."""
    blocks, counts = -(-counts // BLOCK), counts.astype(np.int64)
    nth = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    first = np.repeat(np.cumsum(blocks) - blocks, counts)
    return np.asarray(chain[first + nth // BLOCK] * BLOCK + nth % BLOCK)


def _check(row: NDArray[np.int32], descriptor: UInt64Array) -> NDArray[np.uint32]:
    crc = zlib.crc32(row.astype("<i4").tobytes())
    return np.array(zlib.crc32(descriptor.astype("<u8").tobytes(), crc), np.uint32)

"""`Vocabulary` is an incremental tree of binary words with an inverted index of keyframes. It is packed for files
without descriptors that keyframes hold.
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
from wheelsight.core.settings import WordSettings
from wheelsight.places.recognition_kernels import BLOCK, BLOCKS, FREE, NODES, Rules, Tree, insert, vote

# Vocabulary: binary words of ORB descriptors that grow with the keyframes, and which keyframes have which.
#
# A tree of words as Nistér & Stewénius 2006 have it, of binary words as Gálvez-López & Tardós 2012 have them; but
# nothing is trained beforehand: a word that has become full is split among centres found among its own descriptors.
# So there are as many words as the place needs, and no file of them must come along.


_OF_NODES = ("centre", "first", "children", "level", "postings", "limit", "head", "tail", "used")
_OF_BLOCKS = ("following", "row", "descriptor")
_FIRST_ROOM = 256


class Vocabulary:
    """Which of the keyframes' rows have which words.

    Args:
        settings: how it grows.
    """

    def __init__(self, settings: WordSettings) -> None:
        self._settings = settings
        self._rules = Rules(settings.branching, settings.split_at, settings.steps, settings.depth, settings.most_nodes)
        self._tree = _empty(_FIRST_ROOM)
        self._tree.limit[0], self._tree.sizes[NODES] = settings.split_at, 1

    def __len__(self) -> int:
        """Words."""
        nodes = int(self._tree.sizes[NODES])
        return int(np.count_nonzero(self._tree.children[:nodes] == 0))

    def add(self, descriptors: UInt64Array, row: int) -> None:
        """The keyframe of a row, larger than those before, shows (N, 4)."""
        chosen = descriptors[_evenly(len(descriptors), self._settings.descriptors)]
        # Every descriptor may split a word, which gives its blocks back and needs one more in each new word.
        nodes = int(self._tree.sizes[NODES]) + len(chosen) * self._settings.branching
        blocks = int(self._tree.sizes[BLOCKS]) + len(chosen) * (1 + self._settings.branching)
        self._tree = _grown(self._tree, nodes, blocks)
        insert(self._tree, np.ascontiguousarray(chosen), row, self._rules)

    def vote(self, descriptors: UInt64Array, rows: int) -> Float32Array:
        """Share (rows,) of the words of (N, 4), weighted by their idf, that each keyframe has too."""
        votes = np.empty(rows, np.float32)
        chosen = descriptors[_evenly(len(descriptors), self._settings.descriptors)]
        vote(self._tree, np.ascontiguousarray(chosen), self._settings.most_postings, votes)
        return votes

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that it knows, by name."""
        sizes = self._tree.sizes
        used = dict.fromkeys(_OF_NODES, sizes[NODES]) | dict.fromkeys(_OF_BLOCKS, sizes[BLOCKS])
        return {"sizes": sizes} | {name: getattr(self._tree, name)[:end] for name, end in used.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], settings: WordSettings, rows: int) -> Self:
        """As `arrays` has told it, of so many keyframes. Raises MapError for what contradicts itself."""
        kept = _checked(Tree(**{name: np.array(arrays[name]) for name in Tree._fields}), rows, settings)
        made = cls(settings)
        made._tree = kept
        return made


def _evenly(count: int, wanted: int) -> NDArray[np.int64]:
    """At most `wanted` indices, spread over `count`."""
    return np.arange(count) if count <= wanted else np.linspace(0, count - 1, wanted).astype(np.int64)


def _empty(room: int) -> Tree:
    numbers = [np.full(room, -1, np.int32) for _ in range(3)]
    counts = [np.zeros(room, np.int32) for _ in range(5)]
    first, head, tail = numbers
    children, level, words, limit, used = counts
    blocks = np.zeros((room, BLOCK), np.int32), np.zeros((room, BLOCK, 4), np.uint64)
    following, sizes = np.full(room, -1, np.int32), np.array([0, 0, -1, 0])
    centre = np.zeros((room, 4), np.uint64)
    return Tree(sizes, centre, first, children, level, words, limit, head, tail, used, following, *blocks)


def _grown(tree: Tree, nodes: int, blocks: int) -> Tree:
    """The same with room for so many nodes and blocks, twice as many where it was too small."""
    room = dict.fromkeys(_OF_NODES, nodes) | dict.fromkeys(_OF_BLOCKS, blocks)
    grown = {}
    for name, needed in room.items():
        array = getattr(tree, name)
        if len(array) < needed:
            # Pages of zeros that nobody has written to take no memory yet.
            grown[name] = np.zeros((max(needed, 2 * len(array)), *array.shape[1:]), array.dtype)
            grown[name][: len(array)] = array
    return tree._replace(**grown)


def _checked(tree: Tree, rows: int, settings: WordSettings) -> Tree:
    """A tree whose numbers stay within it, so that kernels do, and as deep and wide as it grows. Raises MapError."""
    expected = _empty(1)
    nodes, blocks = len(tree.centre), len(tree.row)
    for name in Tree._fields:
        array, like = getattr(tree, name), getattr(expected, name)
        length = {**dict.fromkeys(_OF_NODES, nodes), **dict.fromkeys(_OF_BLOCKS, blocks)}.get(name, 4)
        if array.dtype != like.dtype or array.shape != (length, *like.shape[1:]):
            raise MapError(f"{name} of its words is {array.dtype}{array.shape}", fix="build the map anew")
    inner = np.flatnonzero(tree.children)
    first, last = tree.first[inner], tree.first[inner] + tree.children[inner]
    within = (
        (tree.sizes[:FREE] == (nodes, blocks)).all()
        and nodes > 0
        and (tree.children >= 0).all()
        and (tree.children <= settings.branching).all()
        and ((first > inner) & (last <= nodes)).all()
        and _is_within(tree.level, 0, settings.depth + 1)
        and (np.repeat(tree.level[inner] + 1, tree.children[inner]) == tree.level[_ranges(first, last)]).all()
        and all(_is_within(array, -1, blocks) for array in (tree.head, tree.tail, tree.following, tree.sizes[2:3]))
        and _is_within(tree.row, 0, max(rows, 1))
        and _is_within(tree.used, 0, BLOCK + 1)
        and _is_within(tree.postings, 0, blocks * BLOCK + 1)
    )
    if not within:
        raise MapError("its words contradict themselves", fix="build the map anew")
    return tree


def _ranges(first: NDArray[Any], end: NDArray[Any]) -> NDArray[np.int64]:
    """From each first to before its end, one range after the other."""
    lengths = (end - first).astype(np.int64)
    return np.asarray(np.arange(lengths.sum()) + np.repeat(first - np.cumsum(lengths) + lengths, lengths), np.int64)


def _is_within(array: NDArray[Any], least: int, end: int) -> bool:
    return bool(((array >= least) & (array < end)).all())


# Words as a file has them: no room between postings, and no descriptor that a keyframe on disk has, too.
#
# A descriptor is 32 bytes of bits that look random, so that no compression makes it smaller. Most of those that words
# hold are of keypoints that stand in their keyframe's own record; of these the file has the place there.


Descriptors = Callable[[KeyframeId], UInt64Array]
"""The descriptors (N, 4) that the record of a keyframe on disk holds; none where there is no such record."""

Arrays = dict[str, NDArray[Any]]
_KEPT_WORDS_OF_NODES = ("centre", "first", "children", "level", "postings", "limit")
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
    told = {name: arrays[name] for name in _KEPT_WORDS_OF_NODES}
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
    return {name: kept[name] for name in _KEPT_WORDS_OF_NODES} | _in_blocks(counts, row, descriptor)


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

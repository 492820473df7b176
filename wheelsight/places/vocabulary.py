"""Vocabulary: binary words of ORB descriptors that grow with the keyframes, and which keyframes have which.

A tree of words as Nistér & Stewénius 2006 have it, of binary words as Gálvez-López & Tardós 2012 have them; but nothing
is trained beforehand: a word that has become full is split among centres found among its own descriptors. So there are
as many words as the place needs, and no file of them must come along.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from wheelsight.errors import MapError
from wheelsight.geometry import Float32Array
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.places import _word_kernels as kernels
from wheelsight.settings import WordSettings

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
        self._rules = kernels.Rules(
            settings.branching, settings.split_at, settings.steps, settings.depth, settings.most_nodes
        )
        self._tree = _empty(_FIRST_ROOM)
        self._tree.limit[0], self._tree.sizes[kernels.NODES] = settings.split_at, 1

    def __len__(self) -> int:
        """Words."""
        nodes = int(self._tree.sizes[kernels.NODES])
        return int(np.count_nonzero(self._tree.children[:nodes] == 0))

    def add(self, descriptors: UInt64Array, row: int) -> None:
        """The keyframe of a row, larger than those before, shows (N, 4)."""
        chosen = descriptors[_evenly(len(descriptors), self._settings.descriptors)]
        # Every descriptor may split a word, which gives its blocks back and needs one more in each new word.
        nodes = int(self._tree.sizes[kernels.NODES]) + len(chosen) * self._settings.branching
        blocks = int(self._tree.sizes[kernels.BLOCKS]) + len(chosen) * (1 + self._settings.branching)
        self._tree = _grown(self._tree, nodes, blocks)
        kernels.insert(self._tree, np.ascontiguousarray(chosen), row, self._rules)

    def vote(self, descriptors: UInt64Array, rows: int) -> Float32Array:
        """Share (rows,) of the words of (N, 4), weighted by their idf, that each keyframe has too."""
        votes = np.empty(rows, np.float32)
        chosen = descriptors[_evenly(len(descriptors), self._settings.descriptors)]
        kernels.vote(self._tree, np.ascontiguousarray(chosen), self._settings.most_postings, votes)
        return votes

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that it knows, by name."""
        sizes = self._tree.sizes
        used = dict.fromkeys(_OF_NODES, sizes[kernels.NODES]) | dict.fromkeys(_OF_BLOCKS, sizes[kernels.BLOCKS])
        return {"sizes": sizes} | {name: getattr(self._tree, name)[:end] for name, end in used.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], settings: WordSettings, rows: int) -> Self:
        """As `arrays` has told it, of so many keyframes. Raises MapError for what contradicts itself."""
        kept = _checked(kernels.Tree(**{name: np.array(arrays[name]) for name in kernels.Tree._fields}), rows, settings)
        made = cls(settings)
        made._tree = kept
        return made


def _evenly(count: int, wanted: int) -> NDArray[np.int64]:
    """At most `wanted` indices, spread over `count`."""
    return np.arange(count) if count <= wanted else np.linspace(0, count - 1, wanted).astype(np.int64)


def _empty(room: int) -> kernels.Tree:
    numbers = [np.full(room, -1, np.int32) for _ in range(3)]
    counts = [np.zeros(room, np.int32) for _ in range(5)]
    first, head, tail = numbers
    children, level, words, limit, used = counts
    blocks = np.zeros((room, kernels.BLOCK), np.int32), np.zeros((room, kernels.BLOCK, 4), np.uint64)
    following, sizes = np.full(room, -1, np.int32), np.array([0, 0, -1, 0])
    centre = np.zeros((room, 4), np.uint64)
    return kernels.Tree(sizes, centre, first, children, level, words, limit, head, tail, used, following, *blocks)


def _grown(tree: kernels.Tree, nodes: int, blocks: int) -> kernels.Tree:
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


def _checked(tree: kernels.Tree, rows: int, settings: WordSettings) -> kernels.Tree:
    """A tree whose numbers stay within it, so that kernels do, and as deep and wide as it grows. Raises MapError."""
    expected = _empty(1)
    nodes, blocks = len(tree.centre), len(tree.row)
    for name in kernels.Tree._fields:
        array, like = getattr(tree, name), getattr(expected, name)
        length = {**dict.fromkeys(_OF_NODES, nodes), **dict.fromkeys(_OF_BLOCKS, blocks)}.get(name, 4)
        if array.dtype != like.dtype or array.shape != (length, *like.shape[1:]):
            raise MapError(f"{name} of its words is {array.dtype}{array.shape}", fix="build the map anew")
    inner = np.flatnonzero(tree.children)
    first, last = tree.first[inner], tree.first[inner] + tree.children[inner]
    within = (
        (tree.sizes[: kernels.FREE] == (nodes, blocks)).all()
        and nodes > 0
        and (tree.children >= 0).all()
        and (tree.children <= settings.branching).all()
        and ((first > inner) & (last <= nodes)).all()
        and _is_within(tree.level, 0, settings.depth + 1)
        and (np.repeat(tree.level[inner] + 1, tree.children[inner]) == tree.level[_ranges(first, last)]).all()
        and all(_is_within(array, -1, blocks) for array in (tree.head, tree.tail, tree.following, tree.sizes[2:3]))
        and _is_within(tree.row, 0, max(rows, 1))
        and _is_within(tree.used, 0, kernels.BLOCK + 1)
        and _is_within(tree.postings, 0, blocks * kernels.BLOCK + 1)
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

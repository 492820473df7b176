"""Compiled inner loops of place recognition: similarity of fern codes, and the vocabulary tree of binary words."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wheelsight.core.compiled import kernel
from wheelsight.core.geometry.arrays import Float32Array, Int32Array, IntArray, UInt64Array
from wheelsight.core.geometry.hamming_kernels import count_bits

# Comparison of fern codes, 16 ferns of 4 bits per word, and the best rows.

_ONE, _TWO = np.uint64(1), np.uint64(2)
_LOWEST_OF_FOUR = np.uint64(0x1111111111111111)


@kernel
def likeness_kernel(codes: UInt64Array, code: UInt64Array, out: Float32Array) -> Any:
    """Compute the share (N,) of equal ferns of a code (W,) and (N, W) others: 1 - the block Hamming distance."""
    words = len(code)
    for i in range(len(out)):
        differing = np.uint64(0)
        for w in range(words):
            bits = codes[i, w] ^ code[w]
            bits |= bits >> _ONE
            bits |= bits >> _TWO
            differing += count_bits(bits & _LOWEST_OF_FOUR)
        out[i] = 1.0 - np.float32(differing) / np.float32(16 * words)


@kernel
def best(scores: Float32Array, chosen: IntArray) -> Any:
    """Write the rows of the largest scores (N,) above 0, the largest first, to (K,); return their number.

    Of equal ones the earlier comes first.
    """
    found, most = 0, len(chosen)
    for row in range(len(scores)):
        score = scores[row]
        if score <= 0 or (found == most and score <= scores[chosen[most - 1]]):
            continue
        place = min(found, most - 1)
        found = min(found + 1, most)
        while place > 0 and scores[chosen[place - 1]] < score:
            chosen[place] = chosen[place - 1]
            place -= 1
        chosen[place] = row
    return found


# Vocabulary tree of binary words, with the keyframes of each word.

BLOCK = 16
NODES, BLOCKS, FREE, POSTINGS = range(4)
_BITS = 64
_FAR = 1000


class TreeRules(NamedTuple):
    """Rules of growth: children of a split word, its postings, rounds of clustering, and limits of depth and nodes."""

    branching: int
    split_at: int
    steps: int
    depth: int
    most_nodes: int


class WordTree(NamedTuple):
    """A tree with room for M nodes and K blocks of postings.

    `sizes` (4,) are nodes and blocks in use, the first free block or -1, and all postings. A node has a centre (4,),
    its `first` child, and the number of `children`; without children it is a word. A word has a number of `postings` in
    blocks, linked from `head` to `tail` by `following`, with `used` postings in the tail. At `limit` it is split. A
    posting is the row of a keyframe and the descriptor (4,).
    """

    sizes: IntArray
    centre: UInt64Array
    first: Int32Array
    children: Int32Array
    level: Int32Array
    postings: Int32Array
    limit: Int32Array
    head: Int32Array
    tail: Int32Array
    used: Int32Array
    following: Int32Array
    row: Int32Array
    descriptor: UInt64Array


@kernel
def word_of(tree: WordTree, descriptors: UInt64Array, i: int) -> Any:
    """Return the word of a descriptor, row i of (N, 4): from the root on, the child with the nearest centre."""
    node = 0
    while tree.children[node] > 0:
        best, nearest = 0, _FAR
        for child in range(tree.first[node], tree.first[node] + tree.children[node]):
            distance = _apart(tree.centre, child, descriptors, i)
            if distance < nearest:
                best, nearest = child, distance
        node = best
    return node


@kernel
def _apart(first: UInt64Array, i: int, second: UInt64Array, j: int) -> Any:
    """Return the number of bits in which row i of (N, 4) differs from row j of (M, 4); views of rows would be slow."""
    bits = count_bits(first[i, 0] ^ second[j, 0]) + count_bits(first[i, 1] ^ second[j, 1])
    return np.int64(bits + count_bits(first[i, 2] ^ second[j, 2]) + count_bits(first[i, 3] ^ second[j, 3]))


@kernel
def insert(tree: WordTree, descriptors: UInt64Array, row: int, rules: TreeRules) -> None:
    """Add the descriptors (N, 4) of a keyframe; full words are split."""
    for i in range(len(descriptors)):
        word = word_of(tree, descriptors, i)
        _append(tree, word, row, descriptors, i)
        tree.sizes[POSTINGS] += 1
        is_full = tree.postings[word] >= tree.limit[word]
        if is_full and tree.level[word] < rules.depth and tree.sizes[NODES] + rules.branching <= rules.most_nodes:
            _split(tree, word, rules)


@kernel
def vote(tree: WordTree, descriptors: UInt64Array, most_postings: int, out: Float32Array) -> None:
    """Compute the share (R,) of a view's words (N, 4), weighted by idf, that each keyframe has.

    A word counts as often as both show it. Rare words come first: after `most_postings`, the remaining common words are
    ignored.
    """
    out[:] = 0.0
    n, words = len(descriptors), np.empty(len(descriptors), np.int64)
    for i in range(n):
        word = word_of(tree, descriptors, i)
        words[i] = np.int64(tree.postings[word]) << 32 | word  # one sort: by rarity, then by number
    words.sort()
    all_postings, most, i, looked_at = float(tree.sizes[POSTINGS]), np.float32(0), 0, 0
    while i < n and looked_at < most_postings:
        key, word, shown = words[i], words[i] & 0xFFFFFFFF, 0
        while i < n and words[i] == key:
            i += 1
            shown += 1
        idf = np.float32(np.log((1.0 + all_postings) / (1.0 + tree.postings[word])))
        most += np.float32(shown) * idf
        looked_at += tree.postings[word]
        _count(tree, word, shown, idf, out)
    if most > 0:
        out /= most


@kernel
def _count(tree: WordTree, word: int, shown: int, idf: np.float32, out: Float32Array) -> None:
    """Add a word's idf to each keyframe that has it, as often as it has it but not more often than it is `shown`.

    A keyframe's postings follow each other.
    """
    last, times, block, left = -1, 0, tree.head[word], tree.postings[word]
    while left > 0:
        for slot in range(min(left, BLOCK)):
            row = tree.row[block, slot]
            times = times + 1 if row == last else 1
            last = row
            if times <= shown:
                out[row] += idf
        left -= BLOCK
        block = tree.following[block]


@kernel
def _append(tree: WordTree, word: int, row: int, descriptors: UInt64Array, i: int) -> None:
    if tree.head[word] < 0 or tree.used[word] == BLOCK:
        block = tree.sizes[FREE]
        if block >= 0:
            tree.sizes[FREE] = tree.following[block]
        else:
            block = tree.sizes[BLOCKS]
            tree.sizes[BLOCKS] += 1
        tree.following[block] = -1
        if tree.head[word] < 0:
            tree.head[word] = block
        else:
            tree.following[tree.tail[word]] = block
        tree.tail[word], tree.used[word] = block, 0
    block, slot = tree.tail[word], tree.used[word]
    tree.row[block, slot] = row
    _copy(tree.descriptor[block], np.int64(slot), descriptors, i)
    tree.used[word] += 1
    tree.postings[word] += 1


@kernel
def _split(tree: WordTree, word: int, rules: TreeRules) -> None:
    """Share a word's postings among new words about centres found among its descriptors; alike ones stay together."""
    n = np.int64(tree.postings[word])
    rows, descriptors = np.empty(n, np.int64), np.empty((n, 4), np.uint64)
    block = tree.head[word]
    for i in range(n):
        rows[i] = tree.row[block, i % BLOCK]
        _copy(descriptors, i, tree.descriptor[block], i % BLOCK)
        if i % BLOCK == BLOCK - 1:
            block = tree.following[block]
    centres = _spread_centres(descriptors, rules.branching)
    chosen = np.zeros(n, np.int64)
    for _ in range(rules.steps):
        _assign(descriptors, centres, chosen)
        _centre(descriptors, chosen, centres)
    _assign(descriptors, centres, chosen)
    number, kept = np.full(len(centres), -1, np.int64), 0
    first = tree.sizes[NODES]
    for i in range(n):
        if number[chosen[i]] < 0:
            number[chosen[i]] = kept
            kept += 1
    if kept < 2:
        tree.limit[word] *= 2
        return
    for c in range(len(centres)):
        if number[c] >= 0:
            _copy(tree.centre, first + number[c], centres, c)
            _begin(tree, first + number[c], tree.level[word] + 1, rules.split_at)
    tree.sizes[NODES] += kept
    tree.first[word], tree.children[word] = first, kept
    _free(tree, word)
    for i in range(n):
        _append(tree, first + number[chosen[i]], rows[i], descriptors, i)


@kernel
def _copy(to: UInt64Array, i: Any, source: UInt64Array, j: Any) -> None:
    for k in range(4):
        to[i, k] = source[j, k]


@kernel
def _begin(tree: WordTree, node: int, level: int, limit: int) -> None:
    tree.first[node], tree.children[node], tree.level[node] = -1, 0, level
    tree.postings[node], tree.limit[node] = 0, limit
    tree.head[node], tree.tail[node], tree.used[node] = -1, -1, 0


@kernel
def _free(tree: WordTree, word: int) -> None:
    tree.following[tree.tail[word]] = tree.sizes[FREE]
    tree.sizes[FREE] = tree.head[word]
    tree.postings[word], tree.head[word], tree.tail[word], tree.used[word] = 0, -1, -1, 0


@kernel
def _spread_centres(descriptors: UInt64Array, wanted: int) -> Any:
    """Return at most `wanted` of (N, 4): the first, and each time the one farthest from all before it."""
    n = len(descriptors)
    centres, found = np.empty((wanted, 4), np.uint64), 1
    _copy(centres, 0, descriptors, 0)
    nearest = np.empty(n, np.int64)
    for i in range(n):
        nearest[i] = _apart(descriptors, i, centres, 0)
    while found < wanted:
        farthest = int(np.argmax(nearest))
        if nearest[farthest] == 0:
            break
        _copy(centres, found, descriptors, farthest)
        for i in range(n):
            nearest[i] = min(nearest[i], _apart(descriptors, i, centres, found))
        found += 1
    return centres[:found].copy()


@kernel
def _assign(descriptors: UInt64Array, centres: UInt64Array, chosen: IntArray) -> None:
    for i in range(len(descriptors)):
        nearest = _FAR
        for c in range(len(centres)):
            distance = _apart(descriptors, i, centres, c)
            if distance < nearest:
                chosen[i], nearest = c, distance


@kernel
def _centre(descriptors: UInt64Array, chosen: IntArray, centres: UInt64Array) -> None:
    """Each centre becomes the majority of its descriptors, bit by bit; one that has none stays."""
    ones = np.zeros((len(centres), 4 * _BITS), np.int64)
    members = np.zeros(len(centres), np.int64)
    for i in range(len(descriptors)):
        members[chosen[i]] += 1
        for bit in range(4 * _BITS):
            ones[chosen[i], bit] += np.int64((descriptors[i, bit // _BITS] >> np.uint64(bit % _BITS)) & np.uint64(1))
    for c in range(len(centres)):
        for word in range(4 if members[c] > 0 else 0):
            bits = np.uint64(0)
            for bit in range(_BITS):
                if 2 * ones[c, word * _BITS + bit] > members[c]:
                    bits |= np.uint64(1) << np.uint64(bit)
            centres[c, word] = bits

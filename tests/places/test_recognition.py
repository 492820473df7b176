from __future__ import annotations

import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from places.seen_room import kept, ring, seen, standing

from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.settings import RecognitionSettings
from wheelsight.places import recognition_kernels as _likeness_kernels
from wheelsight.places import recognition_kernels as _word_kernels
from wheelsight.places import vocabulary as kept_words
from wheelsight.places.recognition import Ferns, Recognizer
from wheelsight.places.vocabulary import Vocabulary


@pytest.fixture
def small_words(monkeypatch):
    """Words that are split early."""
    monkeypatch.setattr(kept_words, "RULES", kept_words.RULES._replace(split_at=8, branching=3))


@pytest.fixture(scope="module")
def known() -> Recognizer:
    """Of the room, all round."""
    recognizer = Recognizer()
    for number, T in enumerate(ring()):
        recognizer.add(KeyframeId(number), kept(seen(T)))
    return recognizer


def descriptors(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.integers(0, 2**64, (n, 4), np.uint64)


@pytest.mark.parametrize("turn", [0.2, 1.5, 2.9, 4.0, 5.2])
def test_the_keyframes_that_look_there_come_first(known, turn):
    T = standing(0.6 * np.cos(turn) - 0.5, 0.4 * np.sin(turn), turn + 0.05)
    far_m = [float(se3.view_shift_m(se3.invert(T_keyframe) @ T)) for T_keyframe in ring()]
    first = [candidate.keyframe for candidate in known.candidates(seen(T), 3)]
    assert min(far_m[number] for number in first[:1]) < 0.6
    assert int(np.argmin(far_m)) in first


def test_scores_fall_and_a_keyframe_itself_has_the_best_one(known):
    found = known.candidates(seen(ring()[7]), 24)
    assert found[0].keyframe == 7
    assert found[0].score == pytest.approx(1.0)
    assert [c.score for c in found] == sorted((c.score for c in found), reverse=True)


def test_what_is_forbidden_is_no_candidate(known):
    forbidden = [KeyframeId(number) for number in (6, 7, 8)]
    found = known.candidates(seen(ring()[7]), 24, forbidden)
    assert found
    assert not {candidate.keyframe for candidate in found} & set(forbidden)


def test_a_frame_and_its_keyframe_have_the_same_candidates(known):
    view = seen(standing(-0.2, 0.3, 1.0))
    assert known.candidates(view, 3)[0].keyframe == known.candidates(kept(view), 3)[0].keyframe


def test_nothing_known_gives_no_candidates_and_each_is_known_once(known):
    view = seen(ring()[0])
    assert Recognizer().candidates(view) == []
    with pytest.raises(ArgumentError, match="keyframe 3 is known already"):
        known.add(KeyframeId(3), view)


def test_the_same_keyframes_give_the_same_answers():
    views = [seen(T) for T in ring()[:6]]
    one, two = Recognizer(), Recognizer()
    for recognizer in (one, two):
        for number, view in enumerate(views):
            recognizer.add(KeyframeId(number), view)
    assert one.candidates(views[3], 6) == two.candidates(views[3], 6)
    other = Recognizer(RecognitionSettings(seed=1))
    other.add(KeyframeId(0), views[0])
    assert not np.array_equal(Ferns.drawn(0).code(*_images(views[0])), Ferns.drawn(1).code(*_images(views[0])))


def test_what_is_saved_is_found_again(known, tmp_path):
    path = tmp_path / "codes.npz"
    known.save(path)
    again = Recognizer.load(path)
    view = seen(standing(-0.2, 0.3, 1.0))
    assert again.candidates(view, 24) == known.candidates(view, 24)
    # It goes on growing as the first one would.
    first = Recognizer.load(path)
    for recognizer in (again, first):
        recognizer.add(KeyframeId(100), view)
    assert again.candidates(view, 2)[0].keyframe == 100


def test_a_file_of_the_first_format_is_read(known, tmp_path):
    """It has blocks as they are in memory, and all descriptors."""
    path, view = tmp_path / "codes.npz", seen(standing(-0.2, 0.3, 1.0))
    known.save(path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if not name.startswith("words_")}
    arrays["format"] = np.frombuffer(b"wheelsight-recognition-1", np.uint8)
    words = Vocabulary()
    for number, T in enumerate(ring()):
        words.add(seen(T).features.descriptors, number)
    arrays |= {f"words_{name}": array for name, array in words.arrays().items()}
    np.savez(path, **arrays)
    assert Recognizer.load(path).candidates(view, 24) == known.candidates(view, 24)


@pytest.mark.usefixtures("small_words")
def test_words_come_back_in_the_order_in_which_they_were_added(rng):
    """From their keyframes as far as these have their descriptors; and they go on growing as they would have."""
    words = Vocabulary()
    rows = [descriptors(rng, 40) for _ in range(9)]
    rows[5][:30] = rows[2][:30]
    for row, shown in enumerate(rows):
        words.add(shown, row)
    numbers = [KeyframeId(3 * row) for row in range(len(rows))]
    kept = kept_words.packed(words.arrays(), numbers, lambda number: rows[number // 3][::2])
    assert len(kept["own"]) < 0.6 * 40 * len(rows)
    assert set(kept) == {"centre", "first", "children", "level", "postings", "limit", "row", "place", "own", "check"}
    with pytest.raises(MapError, match="of other keypoints"):
        kept_words.unpacked(kept, numbers, lambda number: rows[number // 3][1::2])
    with pytest.raises(MapError, match="keyframe 0 lacks keypoints"):
        kept_words.unpacked(kept, numbers, lambda _: rows[0][:2])
    arrays = kept_words.unpacked(kept, numbers, lambda number: rows[number // 3][::2])
    back = Vocabulary.from_arrays(arrays, len(rows))
    more = descriptors(rng, 40)
    for grown in (words, back):
        grown.add(more, len(rows))
    again = [kept_words.packed(grown.arrays(), [*numbers, KeyframeId(99)], lambda _: more) for grown in (words, back)]
    assert all((again[0][name] == again[1][name]).all() for name in again[0])


def test_a_file_that_is_none_is_refused_by_name(known, tmp_path):
    path = tmp_path / "codes.npz"
    path.write_bytes(b"no codes at all")
    with pytest.raises(MapError, match=r"codes\.npz"):
        Recognizer.load(path)
    known.save(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(MapError, match=r"codes\.npz"):
        Recognizer.load(path)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("format", lambda a: np.frombuffer(b"wheelsight-recognition-0", np.uint8)),
        ("pixel", lambda a: a + 10**6),
        ("codes", lambda a: a[:, :-1]),
        ("words_row", lambda a: a + 1000),
        ("words_row", lambda a: a[::-1].copy()),
        ("words_first", lambda a: np.zeros_like(a)),
        ("words_postings", lambda a: a.astype(np.int64)),
        ("words_postings", lambda a: a + 1),
        ("words_postings", lambda a: -a),
        ("words_place", lambda a: np.zeros_like(a)),
        ("words_own", lambda a: a[1:]),
        ("words_own", lambda a: a[::-1].copy()),
        ("words_children", lambda a: -a - 1),
    ],
)
def test_numbers_that_contradict_each_other_are_refused(known, tmp_path, name, change):
    path = tmp_path / "codes.npz"
    known.save(path)
    with np.load(path) as file:
        arrays = {own: file[own] for own in file.files}
    arrays[name] = change(arrays[name])
    np.savez(path, **arrays)
    with pytest.raises(MapError, match=r"codes\.npz"):
        Recognizer.load(path)


def test_no_pickle_is_opened(tmp_path):
    path, buffer = tmp_path / "codes.npz", io.BytesIO()
    np.save(buffer, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("format.npy", buffer.getvalue())
    with pytest.raises(MapError, match="damaged"):
        Recognizer.load(path)


def test_light_changes_few_ferns_and_another_view_changes_most():
    ferns = Ferns.drawn(0)
    depth_m, grey = _images(seen(ring()[3]))
    dimmed = ferns.code(depth_m, np.where(grey > 0, 0.5 * grey + 20, grey).astype(np.float32))
    codes = np.stack([dimmed, ferns.code(*_images(seen(ring()[15])))])
    like = np.empty(2, np.float32)
    _likeness_kernels.likeness_kernel(codes, ferns.code(depth_m, grey), like)
    assert like[0] > 0.98
    assert like[1] < 0.5


def test_without_images_all_ferns_say_no():
    empty = np.zeros((240, 320), np.float32)
    assert not Ferns.drawn(0).code(empty, empty).any()


@given(st.integers(0, 2**32))
def test_likeness_counts_ferns_of_four_bits(seed):
    rng = np.random.default_rng(seed)
    few = rng.integers(0, 4, (6, 32), np.uint8)  # of few values, so that some are alike
    packed = (few.reshape(6, 2, 16).astype(np.uint64) << np.arange(0, 64, 4, dtype=np.uint64)).sum(axis=2)
    like = np.empty(6, np.float32)
    _likeness_kernels.likeness_kernel(packed.astype(np.uint64), packed[0].astype(np.uint64), like)
    assert like == pytest.approx((few == few[0]).mean(axis=1))


@given(st.lists(st.integers(-3, 6), min_size=1, max_size=40), st.integers(1, 12))
def test_the_best_are_those_of_a_stable_sort(scores, wanted):
    reported, chosen = np.array(scores, np.float32), np.empty(wanted, np.int64)
    found = _likeness_kernels.best(reported, chosen)
    order = np.argsort(-reported, kind="stable")
    assert chosen[:found].tolist() == order[reported[order] > 0][:wanted].tolist()


def _nearest_words(tree, descriptor, node=0):
    """The words to which a descriptor leads: several, where children are equally near."""
    if tree.children[node] == 0:
        return [node]
    children = range(tree.first[node], tree.first[node] + tree.children[node])
    far = [int(np.bitwise_count(tree.centre[child] ^ descriptor).sum()) for child in children]
    nearest = [child for child, bits in zip(children, far, strict=True) if bits == min(far)]
    return [word for child in nearest for word in _nearest_words(tree, descriptor, child)]


@given(st.integers(0, 2**32))
@example(10445)  # two words are equally near to a descriptor
def test_a_keyframe_is_in_the_word_of_each_of_its_descriptors(seed):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kept_words, "RULES", kept_words.RULES._replace(split_at=8, branching=3))
        rng = np.random.default_rng(seed)
        rows = [descriptors(rng, 40) for _ in range(5)]
        rows[3] = rows[1].copy()
        words = Vocabulary()
        for row, shown in enumerate(rows):
            words.add(shown, row)
        assert len(words) > 10
        tree = _word_kernels.WordTree(**words.arrays())
        for row, shown in enumerate(rows):
            for i in range(len(shown)):
                assert any(row in _rows_of(tree, word) for word in _nearest_words(tree, shown[i]))
        is_word = tree.children == 0
        assert tree.postings[is_word].sum() == tree.sizes[_word_kernels.POSTINGS] == 200


@given(st.integers(0, 2**32))
def test_votes_are_those_counted_one_by_one(seed):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kept_words, "RULES", kept_words.RULES._replace(split_at=8, branching=3))
        rng = np.random.default_rng(seed)
        pool = descriptors(rng, 60)
        rows = [pool[rng.integers(0, 60, 30)] for _ in range(6)]
        words = Vocabulary()
        for row, shown in enumerate(rows):
            words.add(shown, row)
        query = pool[rng.integers(0, 60, 25)]
        tree = _word_kernels.WordTree(**words.arrays())
        asked = [int(_word_kernels.word_of(tree, query, i)) for i in range(len(query))]
        idf = {word: np.log((1 + tree.sizes[_word_kernels.POSTINGS]) / (1 + tree.postings[word])) for word in asked}
        both = [
            sum(min(asked.count(word), _rows_of(tree, word).count(row)) * idf[word] for word in idf) for row in range(6)
        ]
        most = sum(idf[word] for word in asked)
        assert words.vote(query, 6) == pytest.approx(np.array(both) / most, rel=1e-4)


def test_common_words_are_left_out_first(rng, monkeypatch):
    monkeypatch.setattr(kept_words, "RULES", kept_words.RULES._replace(split_at=4, branching=4))
    common, rare = descriptors(rng, 1), descriptors(rng, 36).reshape(3, 12, 4)
    asked = np.concatenate([common, rare[1, :1]])
    votes = {}
    for most_postings in (1, 1000):
        monkeypatch.setattr(kept_words, "_MOST_POSTINGS", most_postings)
        words = Vocabulary()
        for row in range(3):
            words.add(np.concatenate([np.repeat(common, 20, axis=0), rare[row]]), row)
        votes[most_postings] = words.vote(asked, 3)
    tree = _word_kernels.WordTree(**words.arrays())
    rarest = set(_rows_of(tree, int(_word_kernels.word_of(tree, asked, 1))))
    assert set(np.flatnonzero(votes[1]).tolist()) == rarest < {0, 1, 2}
    assert (votes[1000] > 0).all()


def test_words_stop_growing_at_the_most_nodes(rng, monkeypatch):
    monkeypatch.setattr(kept_words, "RULES", kept_words.RULES._replace(split_at=8, branching=4, most_nodes=40))
    words = Vocabulary()
    for row in range(20):
        words.add(descriptors(rng, 50), row)
    assert len(words) <= 40
    assert words.vote(descriptors(rng, 50), 20).max() > 0


def _rows_of(tree: _word_kernels.WordTree, word: int) -> list[int]:
    rows: list[int] = []
    block = tree.head[word]
    while len(rows) < tree.postings[word]:
        rows += tree.row[block].tolist()
        block = tree.following[block]
    return rows[: tree.postings[word]]


def _images(view):
    finest = replace(view.grid.levels[0])
    return finest.depth_m, finest.grey

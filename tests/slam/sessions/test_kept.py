from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sessions.kept_views import COUNT, keyframe, pose
from sessions.old_keyframes import write_old

from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.maps import MapFolder, SessionSettings
from wheelsight.slam.maps.journal import HEAD_BYTES, read_journal


def last_graph(path: Path) -> Path:
    return sorted(path.glob("graph-*"))[-1]


def test_few_keyframes_are_held_in_memory_and_more_may_be_added(written: Path) -> None:
    store = MapFolder.open(written, settings=SessionSettings(memory_keyframes=2)).store
    first = store[KeyframeId(0)]
    assert store[KeyframeId(0)] is first
    for number in (1, 2):
        store[KeyframeId(number)]
    assert store[KeyframeId(0)] is not first
    added = store.add(keyframe(50), pose(50))
    assert (added, len(store)) == (COUNT, COUNT + 1)
    assert store[added].stamp_s == 50
    store.move([KeyframeId(1)], pose(31)[None])
    assert_allclose(store.pose(KeyframeId(1)), pose(31), atol=1e-12)
    with pytest.raises(ArgumentError):
        store[KeyframeId(COUNT + 1)]


def test_a_damaged_keyframe_keeps_its_number_and_its_pose(copied: Path) -> None:
    path = copied / "keyframes-00000.journal"
    record, _ = read_journal(path).records[1]
    data = bytearray(path.read_bytes())
    data[record.offset + 100] ^= 4
    path.write_bytes(data)
    found = MapFolder.open(copied)
    assert list(found.store) == [0, 2, 3, 4, 5, 6]
    assert (len(found.store), found.store.missing, found.contents.health.missing) == (COUNT, (1,), (1,))
    assert_array_equal(found.store.pose(KeyframeId(1)), pose(1))
    with pytest.raises(MapError, match="keyframe 1 is lost"):
        found.store[KeyframeId(1)]
    damage, lost = found.contents.health.notes
    assert damage == f"{path.name}: {HEAD_BYTES + record.length:,} bytes from byte {record.offset:,} on are damaged."
    assert lost == "1 keyframes are lost: 1."
    assert not found.contents.health.is_whole


def test_a_damaged_place_leaves_no_pose_that_looks_good(copied: Path) -> None:
    path = last_graph(copied)
    record = next(record for record, _ in read_journal(path).records if record.kind == 2 and record.key == 2)
    data = bytearray(path.read_bytes())
    data[record.offset + 60] ^= 4
    path.write_bytes(data)
    found = MapFolder.open(copied)
    assert found.store.missing == (2,)
    assert np.isnan(found.store.pose(KeyframeId(2))).all()
    assert np.isfinite(np.delete(found.store.T_map_keyframe, 2, axis=0)).all()


@pytest.mark.parametrize("is_old", [False, True])
def test_images_larger_than_the_cameras_are_not_decoded(copied: Path, is_old: bool) -> None:
    """A keyframe of 300 bytes may say that it is of 16 million pixels, which take a second to read."""
    folder = MapFolder.open(copied, read_only=False)
    folder.append_keyframe(COUNT, keyframe(3, size=(96, 128)), pose(COUNT))
    folder.close()
    if is_old:
        large = MapFolder.open(copied)
        large.store.keep_on_disk(KeyframeId(COUNT), lambda: keyframe(3, size=(96, 128)))
        write_old(copied, large)
    found = MapFolder.open(copied)
    assert found.store[KeyframeId(0)].depth_m.shape == (48, 64)
    where = found.contents.where[COUNT]
    with pytest.raises(MapError, match=rf"{where[0].name}: .* an image of it cannot be read, or is larger") as refused:
        found.store[KeyframeId(COUNT)]
    assert f"its record at byte {where[1].offset:,}" in str(refused.value)

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from sessions.kept_views import CAMERA, INTRINSICS, edge, keyframe, pose

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import MapError
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures
from wheelsight.slam.maps import journal as records
from wheelsight.slam.maps import keyframes as keyframe_records
from wheelsight.slam.maps.journal import Place
from wheelsight.slam.maps.keyframes import DEPTH_SIGMAS, GREY_STEP, DepthSteps

NOISE = DepthNoise()
STEPS = DepthSteps.of_noise(NOISE)


def there_and_back(given: Keyframe, most_kb: int = 86) -> Keyframe:
    return keyframe_records.unpack_keyframe(keyframe_records.pack_keyframe(given, STEPS, most_kb))


def row_by_row(features: KeyframeFeatures) -> np.ndarray:
    """Keypoints with depth, in the order in which they are kept."""
    kept = np.flatnonzero(features.points[:, 2] > 0)
    px = np.rint(16 * features.px[kept])
    return kept[np.lexsort((px[:, 0], px[:, 1]))]


def test_a_keyframe_comes_back_within_its_noise() -> None:
    given = keyframe(3)
    back = there_and_back(given)
    assert back.stamp_s == 3.0
    assert_array_equal(back.intrinsics, INTRINSICS)
    known = given.depth_m > 0
    assert_array_equal(back.depth_m > 0, known)
    # Half a step, and what the keyframe itself rounds.
    limit = (0.5 * DEPTH_SIGMAS * NOISE.sigma_m(given.depth_m) + 0.0001 + 1e-6)[known]
    assert (np.abs(back.depth_m - given.depth_m)[known] <= 1.01 * limit).all()
    # What is darker than half a step must not become unknown.
    limit = np.where(given.grey < GREY_STEP / 2, GREY_STEP, GREY_STEP / 2)
    assert (np.abs(back.grey - given.grey) <= limit).all()
    assert_array_equal(back.grey > 0, given.grey > 0)
    assert given.features is not None
    assert back.features is not None
    kept = row_by_row(given.features)
    assert 0 < len(kept) < len(given.features.px)
    assert_array_equal(back.features.descriptors, given.features.descriptors[kept])
    assert_allclose(back.features.px, given.features.px[kept], rtol=0, atol=1 / 32)
    assert_allclose(back.features.points, given.features.points[kept], rtol=0, atol=0.0001 + 1e-9)


def test_what_came_back_once_stays_as_it_is() -> None:
    once = there_and_back(keyframe(4))
    twice = there_and_back(once)
    assert_array_equal(twice.depth_m, once.depth_m)
    assert_array_equal(twice.grey, once.grey)
    assert keyframe_records.pack_keyframe(twice, STEPS, 86) == keyframe_records.pack_keyframe(once, STEPS, 86)


def test_images_that_are_too_wide_are_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    given = keyframe(5, keypoints=None, size=(96, 128))
    assert there_and_back(given).depth_m.shape == (96, 128)
    monkeypatch.setattr(keyframe_records, "WIDTH_PX", 64)
    back = there_and_back(given)
    assert back.depth_m.shape == (48, 64)
    assert_allclose(back.intrinsics, [30, 30, 15.5, 11.5])
    assert back.features is None
    assert back.depth_m.shape == (CAMERA.height, CAMERA.width)


def test_keypoints_are_left_out_evenly_where_there_is_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keyframe_records, "_LEAST_KEYPOINTS", 10)
    given = keyframe(6, keypoints=2000)
    packed = keyframe_records.pack_keyframe(given, STEPS, 40)
    back = keyframe_records.unpack_keyframe(packed)
    assert given.features is not None
    assert back.features is not None
    assert 30_000 < len(packed) <= 40_000
    kept = given.features.descriptors[given.features.points[:, 2] > 0]
    rows = sorted(np.flatnonzero((kept == one).all(axis=1))[0] for one in back.features.descriptors)
    steps = np.diff(rows)
    assert (rows[0], rows[-1]) == (0, len(kept) - 1)
    assert set(steps) <= {steps.min(), steps.min() + 1}
    least = there_and_back(given, most_kb=1)
    assert least.features is not None
    assert len(least.features.px) == 10


def test_a_code_comes_back() -> None:
    given = keyframe(1)
    code = np.arange(5.0)
    coded = Keyframe(given.stamp_s, given.intrinsics, given.depth_png, given.grey_png, given.features, code)
    assert_array_equal(there_and_back(coded).code, code)
    assert there_and_back(given).code is None


@given(cut=st.integers(0, 20_000), at=st.integers(0, 20_000), value=st.integers(0, 255))
def test_bytes_that_are_no_keyframe_are_refused_or_one(cut: int, at: int, value: int) -> None:
    """Such bytes pass no checksum; a hostile file may bring them all the same."""
    data = bytearray(keyframe_records.pack_keyframe(keyframe(2), STEPS, 86))
    cut, at = cut % len(data), at % len(data)
    with pytest.raises(MapError):
        keyframe_records.unpack_keyframe(bytes(data[:cut]))
    data[at] = value
    try:
        found = keyframe_records.unpack_keyframe(bytes(data))
    except MapError:
        return
    assert found.depth_m.shape == found.grey.shape


def test_an_image_that_says_to_be_huge_is_refused() -> None:
    data = keyframe_records.pack_keyframe(keyframe(2), STEPS, 86)
    begin = data.index(b"VP8L") + 9
    huge = data[:begin] + ((1 << 28) - 1).to_bytes(4, "little") + data[begin + 4 :]
    with pytest.raises(MapError, match="an image of it cannot be read"):
        keyframe_records.unpack_keyframe(huge)


def test_places_edges_and_poses_come_back_to_the_last_bit() -> None:
    for T_odom in (pose(5), None):
        place = records.unpack_place(records.pack_place(Place(1.5, pose(4), T_odom)))
        assert place.stamp_s == 1.5
        assert_array_equal(place.T_map_keyframe, pose(4))
        assert (place.T_odom_keyframe is None) == (T_odom is None)
        if T_odom is not None:
            assert_array_equal(place.T_odom_keyframe, T_odom)
    edges = (edge(0, 1), edge(7, 2, is_loop=True))
    for back, one in zip(records.unpack_edges(records.pack_edges(edges)), edges, strict=True):
        assert (back.first, back.second, back.is_loop) == (one.first, one.second, one.is_loop)
        assert_array_equal(back.T_first_second, one.T_first_second)
        assert_array_equal(back.covariance, one.covariance)
    numbers, T = records.unpack_poses(records.pack_poses([3, 1], np.array([pose(3), pose(1)])))
    assert numbers.tolist() == [3, 1]
    assert_array_equal(T, [pose(3), pose(1)])
    assert records.unpack_numbers(records.pack_numbers([4, 2])) == (4, 2)


def test_what_contradicts_itself_is_refused() -> None:
    bent = pose(1) * 1.5
    with pytest.raises(MapError, match="no rigid motions"):
        records.unpack_place(records.pack_place(Place(1.0, bent)))
    with pytest.raises(MapError, match="no rigid motions"):
        records.unpack_poses(records.pack_poses([0], bent[None]))
    with pytest.raises(MapError, match="an invalid edge"):
        records.unpack_edges(records.pack_edges([edge(1, 1)]))
    with pytest.raises(MapError, match="holds 7 bytes, which are no numbers"):
        records.unpack_numbers(bytes(7))
    for number in (np.nan, np.inf, 1e300):
        far = pose(1)
        far[0, 3] = number
        with pytest.raises(MapError, match="no rigid motions"):
            records.unpack_poses(records.pack_poses([0], far[None]))
        vague = replace(edge(0, 1), covariance=np.diag([1e-4] * 5 + [number]))
        with pytest.raises(MapError, match="an invalid edge"):
            records.unpack_edges(records.pack_edges([vague]))
        turned = pose(1)
        turned[0, 0] = number
        with pytest.raises(MapError, match="no rigid motions"):
            records.unpack_place(records.pack_place(Place(1.0, turned)))
    for stamp_s in (np.nan, np.inf):
        with pytest.raises(MapError, match="is a keyframe of no time"):
            records.unpack_place(records.pack_place(Place(stamp_s, pose(1))))
    with pytest.raises(MapError, match="is no place"):
        records.unpack_place(b"short")


def test_keypoints_that_fit_once_compressed_are_all_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """All at one place, they take little more than their descriptors."""
    given = keyframe(3, keypoints=400)
    assert given.features is not None
    points = np.tile([0.1, 0.2, 1.0], (400, 1))
    alike = replace(given, features=KeyframeFeatures(np.ones((400, 2)), points, given.features.descriptors))
    size = len(keyframe_records.pack_keyframe(alike, STEPS, 86))
    monkeypatch.setattr(keyframe_records, "_LEAST_KEYPOINTS", 1)
    tight = -(-size // 1000)
    back = there_and_back(alike, tight).features
    assert back is not None
    assert len(back.px) == 400
    # Those of which each is elsewhere do not fit beside.
    apart = replace(given, features=replace(given.features, points=given.features.points + 1.0))
    back = there_and_back(apart, tight).features
    assert back is not None
    assert len(back.px) < 400

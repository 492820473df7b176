"""Keyframes that there is no room for as views come back from the store, where the camera does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import EXACT, Plane, apart, bench, dense, frame_of

from wheelsight.core.errors import MapError
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense.odometry import EvictedViews
from wheelsight.vision.dense.tracking import KeypointTracker, KnownView

WALL = [Plane((0, 0, 1), 2.0, is_painted=True)]
BENCH = bench()
NUDGE = se3.exp([0.5, -0.2, 0.3, 0.1, -0.2, 0.1])


def at(x_m: float) -> FloatArray:
    return np.asarray(se3.from_parts(np.eye(3), [x_m, 0, 0]))


class Known:
    """A store with a keyframe each metre, and what dense odometry holds of them."""

    def __init__(self, count: int = 3, shape: tuple[int, int] | None = None) -> None:
        self.keypoints = keypoints = KeypointTracker(EXACT, has_landmarks=False)
        self.store = KeyframeStore()
        self.gone = EvictedViews(self.store, BENCH.gridder, BENCH.maker, keypoints, room=1)
        self.views: list[KnownView] = []
        for number in range(count):
            frame, T = frame_of(WALL, at(number), float(number)), at(number)
            raw, grid = keypoints.extract(frame), BENCH.grid(frame)
            finest = grid.levels[0]
            height, width = shape or finest.depth_m.shape
            images = finest.depth_m[:height, :width], finest.grey[:height, :width]
            self.store.add(Keyframe.of_images(grid.stamp_s, finest.intrinsics, *images, keypoints.kept(raw)), T)
            turning = np.array([0.0, 0.1 * number, 0.0])
            reference, covariance = BENCH.maker.of_frame(grid, T), np.diag([1.0, 2, 3, 4, 5, 6]) * (1 + number)
            self.views.append(KnownView(KeyframeId(number), reference, covariance, raw, turning))
            self.gone.put(self.views[-1])
        for number in range(1, count):
            self.store.add_loop(KeyframeId(0), KeyframeId(number))


@pytest.fixture(scope="module")
def known() -> Known:
    return Known()


def test_it_comes_back_as_it_went(known: Known) -> None:
    went, back = known.views[1], not_none(known.gone.nearer(at(1.2), 0.5))
    assert back.keyframe == 1
    np.testing.assert_allclose(back.reference.T_map_reference, went.reference.T_map_reference)
    np.testing.assert_allclose(back.covariance, went.covariance, atol=1e-12)
    np.testing.assert_array_equal(back.turning_rad_s, went.turning_rad_s)
    for now, then in zip(back.reference.scales.levels, went.reference.scales.levels, strict=True):
        # Depth is kept in steps of 0.2 mm, grey in whole numbers.
        np.testing.assert_allclose(now.pixels[..., 4], then.pixels[..., 4], atol=2e-4)
        np.testing.assert_allclose(now.pixels[..., 5], then.pixels[..., 5], atol=0.5)


def test_its_keypoints_come_back_with_their_points(known: Known) -> None:
    went, back = not_none(known.views[1].features), not_none(not_none(known.gone.nearer(at(1.2), 0.5)).features)
    lifted = went.has_depth
    np.testing.assert_allclose(back.points, went.points[lifted], atol=1e-9)
    np.testing.assert_array_equal(back.descriptors, went.descriptors[lifted])
    assert (back.sigma_m > 0).all()
    assert (back.sigma_px > 0).all()


def test_none_comes_back_that_another_view_is_nearer_than(known: Known) -> None:
    assert known.gone.nearer(at(1.2), 0.1) is None


def test_it_has_moved_with_its_keyframe() -> None:
    known = Known()
    known.store.move(list(known.store), NUDGE @ known.store.T_map_keyframe)
    back = not_none(known.gone.nearer(NUDGE @ at(1.2), 0.5))
    np.testing.assert_allclose(back.reference.T_map_reference, NUDGE @ at(1.0), atol=1e-12)
    Ad = se3.adjoint(NUDGE)
    np.testing.assert_allclose(back.covariance, Ad @ known.views[1].covariance @ Ad.T, atol=1e-9)


def test_one_that_is_held_again_is_gone_no_more() -> None:
    known = Known()
    known.gone.take(not_none(known.gone.nearer(at(1.2), 0.5)))
    assert len(known.gone) == 2
    assert not_none(known.gone.nearer(at(1.2), 2.0)).keyframe == 2


def test_what_the_disk_has_lost_or_has_in_another_size_stays_away(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Known(2, shape=(120, 160)).gone.nearer(at(1.0), 0.5) is None
    known = Known(2)

    def lost(store: KeyframeStore, number: KeyframeId, at: KeyframeId) -> Keyframe:
        raise MapError("a keyframe that rests on disk is cut off", fix="")

    monkeypatch.setattr(KeyframeStore, "as_of", lost)
    assert known.gone.nearer(at(1.0), 0.5) is None


def there_and_back() -> list[tuple[FloatArray, RgbdFrame]]:
    ways_m = 0.3 * np.array([*range(9), *range(7, -1, -1)])
    return [(at(x_m), frame_of(WALL, at(x_m), k / 5)) for k, x_m in enumerate(ways_m)]


@pytest.mark.parametrize(
    ("settings", "is_tied", "comes_back"),
    [({}, False, True), ({"kept_keyframes": 2}, True, True), ({"kept_keyframes": 2}, False, False)],
    ids=["room for all", "room for two", "room for two, and no loops"],
)
def test_on_the_way_back_no_keyframe_is_made(settings: dict[str, Any], is_tied: bool, comes_back: bool) -> None:
    """With room for two views as with room for all, once loops tie them; before, each place was kept again."""
    subject, counts = dense(**settings), list[int]()
    for T, frame in there_and_back():
        answer = subject.process(frame)
        assert answer.status is Status.TRACKING
        assert apart(not_none(answer.T_odom_body), T)[0] < 0.02
        counts.append(len(subject.store))
        for number in subject.store if is_tied else ():
            subject.store.add_loop(number, KeyframeId(number + 10))
    assert counts[8] >= 4
    assert (counts[-1] == counts[8]) == comes_back


def test_one_that_no_loop_ties_to_another_time_stays_away() -> None:
    known = Known(4)
    known.gone = EvictedViews(known.store, BENCH.gridder, BENCH.maker, known.keypoints, room=3)
    for view in known.views:
        known.gone.put(view)
    assert [known.gone.is_tied(number) for number in known.store] == [True, False, False, True]
    assert not_none(known.gone.nearer(at(1.2), 2.0)).keyframe == 0
    assert known.gone.nearer(at(1.2), 0.5) is None

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from odometry.dense.scenes import Plane, render
from places.seen_room import EXACT, frame_at, kept, maker, seen, standing
from synthetic import CAMERA

from wheelsight.core.depth_errors import PointErrors
from wheelsight.core.geometry import se3, so3
from wheelsight.core.keyframes import KeyframeFeatures, KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.places.recognition import SeenView
from wheelsight.places.verification import PlaceVerifier, Refusal, RefusedPlace, VerifiedPlace
from wheelsight.vision.dense.alignment import judge as real_judge

ID = KeyframeId(4)
HOME = standing(-1.2, 0.0, 0.0)


@pytest.fixture
def verifier() -> PlaceVerifier:
    return PlaceVerifier(EXACT, views=maker())


def off(T_true: np.ndarray, T: np.ndarray) -> tuple[float, float]:
    D = se3.invert(T_true) @ T
    return float(np.linalg.norm(D[:3, 3])), float(so3.angle(D[:3, :3]))


@pytest.mark.parametrize(
    ("x", "y", "yaw"), [(-1.2, 0.0, 0.0), (-1.0, 0.3, -0.15), (-1.5, -0.25, 0.2), (-0.9, 0.1, 0.1)]
)
def test_a_place_seen_again_is_found(verifier, x, y, yaw):
    T = standing(x, y, yaw)
    T_true = se3.invert(HOME) @ T
    answer = verifier.verify(seen(T), ID, kept(seen(HOME)))
    assert isinstance(answer, VerifiedPlace)
    off_m, off_rad = off(T_true, answer.T_keyframe_camera)
    assert off_m < 0.01
    assert off_rad < 0.005
    assert answer.keyframe == ID
    assert answer.shows_all
    assert answer.intruding < 0.02
    error = se3.log(answer.T_keyframe_camera @ se3.invert(T_true))
    assert error @ np.linalg.solve(answer.covariance, error) < 22.5
    assert not verifier.refusals


def test_the_covariance_has_what_both_frames_and_the_way_between_them_are_off_by(verifier):
    view, keyframe = seen(standing(-1.0, 0.3, -0.15)), kept(seen(HOME))
    loose = PlaceVerifier(replace(EXACT, frame_sigma_m=0.05, frame_sigma_rad=0.03), views=maker())
    sure, unsure = (who.verify(view, ID, keyframe) for who in (verifier, loose))
    assert isinstance(sure, VerifiedPlace)
    assert isinstance(unsure, VerifiedPlace)
    assert np.linalg.eigvalsh(sure.covariance).min() >= 0.01**2 * 0.999
    of_frame = np.diag([0.05**2] * 3 + [0.03**2] * 3)
    Ad = se3.adjoint(unsure.T_keyframe_camera)
    assert unsure.shared == pytest.approx(Ad @ of_frame @ Ad.T)
    assert unsure.covariance - sure.covariance == pytest.approx(of_frame + unsure.shared, abs=1e-9)


def test_what_is_wrong_with_depth_grows_with_the_way_between_both_views():
    """Depth is 4 % long, two standard deviations of nominal cameras, and so is the way from one view to the other."""

    def stretched(T_map_camera: np.ndarray) -> SeenView:
        frame = frame_at(T_map_camera)
        return maker().of_frame(replace(frame, depth_m=1.04 * frame.depth_m))

    keyframe, exact = kept(stretched(HOME)), replace(EXACT, point_errors=PointErrors())
    sigmas = []
    for way_m in (0.0, 1.8):
        T_true = np.eye(4)
        T_true[2, 3] = way_m
        nominal, sure = (
            PlaceVerifier(of, views=maker()).verify(stretched(HOME @ T_true), ID, keyframe) for of in (EXACT, exact)
        )
        assert isinstance(nominal, VerifiedPlace)
        assert isinstance(sure, VerifiedPlace)
        error = se3.log(nominal.T_keyframe_camera @ se3.invert(T_true))
        assert error[2] == pytest.approx(0.04 * way_m, abs=0.003)
        assert error @ np.linalg.solve(nominal.covariance, error) < 6
        sigmas.append([np.sqrt(answer.covariance[2, 2]) for answer in (nominal, sure)])
    (near, near_sure), (far, far_sure) = sigmas
    assert near == pytest.approx(near_sure, abs=0.001)
    assert far > 2 * near
    assert far_sure < 1.5 * near_sure


def test_the_same_room_with_other_textures_is_another_place(verifier):
    answer = verifier.verify(seen(standing(-1.0, 0.1, 0.0), seed=5), ID, kept(seen(HOME)))
    assert isinstance(answer, RefusedPlace)
    assert answer.reason is Refusal.TOO_FEW_INLIERS
    assert verifier.refusals == {answer.reason: 1}


def test_a_bare_view_is_not_recognised(verifier):
    answer = verifier.verify(seen(HOME, blank=True), ID, kept(seen(HOME)))
    assert isinstance(answer, RefusedPlace)
    assert answer.reason is Refusal.TOO_FEW_MATCHES
    nothing = replace(kept(seen(HOME)), features=None)
    assert verifier.verify(seen(HOME), ID, nothing) == RefusedPlace(ID, Refusal.TOO_FEW_MATCHES)


def with_depth(frame: RgbdFrame, depth_m: np.ndarray) -> SeenView:
    """A frame before which something grey stands, where its depth is less."""
    color = np.where((depth_m < frame.depth_m)[..., None], 90, frame.color).astype(np.uint8)
    return maker().of_frame(replace(frame, color=color, depth_m=np.minimum(depth_m, frame.depth_m)))


def test_where_the_keyframe_saw_through_no_partition_may_stand(verifier):
    """It joins the wall, and comes nearer to the right."""
    frame = frame_at(standing(-1.0, 0.1, 0.0))
    slant = np.ones(CAMERA.width) - np.clip((np.arange(CAMERA.width) - 180) / 100, 0, 0.6)
    answer = verifier.verify(with_depth(frame, frame.depth_m * slant.astype(np.float32)), ID, kept(seen(HOME)))
    assert isinstance(answer, RefusedPlace)
    assert answer.reason is Refusal.INTRUDES
    assert answer.inliers > 12


def test_somebody_close_by_does_not_make_it_another_place(verifier):
    """Who stands free hides more than walls may, and the rest shows where it is."""
    frame = frame_at(standing(-1.0, 0.1, 0.0))
    depth_m = frame.depth_m.copy()
    depth_m[:, 180:260] = 0.9
    answer = verifier.verify(with_depth(frame, depth_m), ID, kept(seen(HOME)))
    assert isinstance(answer, VerifiedPlace)
    np.testing.assert_allclose(answer.T_keyframe_camera, se3.invert(HOME) @ standing(-1.0, 0.1, 0.0), atol=0.02)


def test_surfaces_that_stand_elsewhere_than_keypoints_are_refused(verifier):
    keyframe = kept(seen(HOME))
    assert keyframe.features is not None
    shift = np.where(keyframe.features.points[:, 2:] > 0, [0.6, 0.0, 0.0], 0.0)
    moved = replace(keyframe, features=replace(keyframe.features, points=keyframe.features.points + shift))
    answer = verifier.verify(seen(HOME), ID, moved)
    assert isinstance(answer, RefusedPlace)


def corridor(T_map_camera: np.ndarray, rng: np.random.Generator) -> SeenView:
    """A bare corridor along z, with `right` keypoints that belong together among many that do not."""
    planes = [
        Plane((1.0, 0.0, 0.0), 1.0),
        Plane((-1.0, 0.0, 0.0), 1.0),
        Plane((0.0, 1.0, 0.0), 1.2),
        Plane((0.0, -1.0, 0.0), 1.2),
    ]
    color, depth_m = render(planes, T_map_camera, CAMERA)
    noise = 1 + 1.425e-3 * depth_m * rng.standard_normal(depth_m.shape)
    view = maker().of_frame(RgbdFrame(0.0, color, (depth_m * noise).astype(np.float32)))
    own, right, wrong = np.random.default_rng(3), 20, 100
    sides = own.choice([-1.0, 1.0], right)
    p_map = np.column_stack([sides, own.uniform(-0.8, 0.8, right), own.uniform(1.5, 3.5, right)])
    points = se3.apply(se3.invert(T_map_camera), p_map)
    points = np.concatenate([points, rng.uniform((-1, -1, 1), (1, 1, 4), (wrong, 3))])
    descriptors = own.integers(0, 2**64, (right + wrong, 4), np.uint64)
    return SeenView(view.grid, KeyframeFeatures(np.zeros((len(points), 2)), points, descriptors))


def test_a_corridor_closes_sideways_and_in_heading_but_not_along(verifier, rng):
    T = se3.exp([0.1, 0.0, 0.2, 0.0, 0.05, 0.0])
    answer = verifier.verify(corridor(T, rng), ID, corridor(np.eye(4), rng))
    assert isinstance(answer, VerifiedPlace)
    assert np.abs(answer.degenerate) == pytest.approx(np.eye(6)[2:3], abs=0.05)
    sigma = np.sqrt(np.diag(answer.covariance))
    assert sigma[2] > 5
    assert sigma[0] < 0.05
    assert sigma[4] < 0.05
    error = se3.log(answer.T_keyframe_camera @ se3.invert(T))
    assert abs(error[0]) < 0.02
    assert abs(error[4]) < 0.02


def test_a_single_wall_is_no_place(verifier, rng):
    wall = [Plane((0.0, 0.0, 1.0), 2.0)]
    color, depth_m = render(wall, np.eye(4), CAMERA)
    view = maker().of_frame(RgbdFrame(0.0, color, depth_m))
    points = np.concatenate([rng.uniform((-0.8, -0.6, 2), (0.8, 0.6, 2), (20, 3)), rng.uniform(1, 3, (100, 3))])
    descriptors = rng.integers(0, 2**64, (120, 4), np.uint64)
    first, second = (
        SeenView(view.grid, KeyframeFeatures(np.zeros((120, 2)), shown, descriptors))
        for shown in (points, np.concatenate([points[:20], rng.uniform(1, 3, (100, 3))]))
    )
    answer = verifier.verify(first, ID, second)
    assert isinstance(answer, RefusedPlace)
    assert answer.reason is Refusal.DEGENERATE


def test_a_variance_that_hides_all_others_by_rounding_is_a_direction_that_is_not_known(verifier, monkeypatch):
    along = np.array([0.6, 0.3, -0.5, 0.2, 0.4, -0.1])

    def judge(*arguments):
        found = real_judge(*arguments)
        return replace(found, covariance=found.covariance + 1e16 * np.outer(along, along))

    monkeypatch.setattr("wheelsight.places.verification.judge", judge)
    answer = verifier.verify(seen(standing(-1.0, 0.3, -0.15)), ID, kept(seen(HOME)))
    assert isinstance(answer, RefusedPlace)
    assert answer.reason is Refusal.DEGENERATE
    assert verifier.refusals == {Refusal.DEGENERATE: 1}

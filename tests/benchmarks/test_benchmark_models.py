"""Dense tracking, surfels and volumes: what is measured of them, and the targets that speak of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.contenders import Contender, open3d_odometry, open3d_slam, opencv_odometry, wheelsight_dense
from benchmarks.dense import judge_dense, one_thread_sheet
from benchmarks.flat import FlatFigures, ModelFigures, judge_flat, model_figures, model_sheet, tracking_sheet, volume_of
from benchmarks.growth import Growth, growth_of, growth_sheet, judge_growth
from benchmarks.kernels import KernelTimes, judge_kernels, kernels_sheet, map_two_frames
from benchmarks.known_poses import KnownSurfels, TruePoses
from benchmarks.longdrive import against, drive
from benchmarks.mapping import judge_mapping, judge_whole, mapping_sheet
from benchmarks.measure import Passage
from benchmarks.run import Figures, Result
from benchmarks.sequences import Accuracy
from benchmarks.table import Sheet
from benchmarks.true_surface import SurfaceBuilder, TrueSurface
from wheelsight.core.geometry import PinholeCamera, se3, so3
from wheelsight_sim import SimulatedRecording, SimulationSettings, simulate

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)


def result(contender: Contender, mean_ms: float, ate_m: float | None = 0.01) -> Result:
    return Result(contender, "hall", Figures(Accuracy(ate_m), 20, 19, mean_ms, 2 * mean_ms, mean_ms))


def rows_fit(sheet: Sheet) -> bool:
    return {len(row) for row in sheet.rows} == {len(sheet.header)}


TRACKED = [
    result(wheelsight_dense.KEYFRAMES, 10.0, ate_m=0.021),
    result(opencv_odometry.RGB_DEPTH, 50.0),
    result(open3d_odometry.HYBRID, 20.0),
]


def test_dense_tracking_is_held_against_both_peers_and_its_error_against_a_limit() -> None:
    both = judge_dense(TRACKED)
    assert [target.limit for target in both] == pytest.approx([12.5, 8.0, 0.02])
    assert [target.is_met for target in both] == [True, False, False]
    assert [target.is_met for target in judge_dense(TRACKED, threads=1)] == [True, False]
    assert "1 thread," in judge_dense(TRACKED, threads=1)[0].what
    assert {target.verdict for target in judge_dense(TRACKED[1:])} == {"not measured"}


def test_a_contender_that_failed_has_a_row_too() -> None:
    failed = Result(open3d_slam.COARSE, "hall", problem="MemoryError")
    for sheet in (one_thread_sheet([*TRACKED, failed]), mapping_sheet([*TRACKED, failed])):
        assert rows_fit(sheet)
        assert sheet.rows[-1][1] == "failed"


def test_surfels_must_be_four_times_as_fast_as_open3d_and_keep_up_with_the_camera() -> None:
    ours, peer = result(wheelsight_dense.SURFELS, 20.0), result(open3d_slam.FINE, 79.0)
    (slow,) = judge_mapping([ours, peer])
    assert slow.limit == pytest.approx(4 * 1e3 / 79)
    assert slow.is_met is False
    assert judge_mapping([ours, result(open3d_slam.FINE, 81.0)])[0].is_met
    assert judge_mapping([ours])[0].verdict == "not measured"
    assert [target.is_met for target in judge_whole([ours, peer])] == [True, True]
    assert [target.is_met for target in judge_whole([result(wheelsight_dense.SURFELS, 34.0, 0.03)])] == [False, False]
    assert judge_whole([peer]) == []


def test_growth_compares_the_medians_of_the_outer_quarters() -> None:
    passage = Passage([], [0.010, 0.010, 0.5, 0.020, 0.020, 0.020, 0.012, 0.011, 0.011], 800.0)
    growth = growth_of("there and back", passage)
    assert growth.percent == pytest.approx(10.0)
    assert [target.is_met for target in judge_growth(replace(growth, last_ms=10.9))] == [True, True]
    assert [target.is_met for target in judge_growth(replace(growth, last_ms=11.2))] == [False, True]
    assert rows_fit(growth_sheet(growth))


def test_compiling_is_judged_by_the_first_process_alone() -> None:
    assert judge_kernels(KernelTimes(61.0, 3.0))[0].is_met is False
    assert judge_kernels(KernelTimes(59.0, 99.0))[0].is_met
    assert rows_fit(kernels_sheet(KernelTimes(1.0, 2.0)))


def test_two_frames_are_mapped() -> None:
    map_two_frames()


def test_the_model_is_held_against_its_limits_and_against_open3ds() -> None:
    stable, every, theirs = (
        ModelFigures(9, *each) for each in ((3e-3, 1e-2, 0.92), (5e-3, 3e-2, 0.96), (2e-3, 1e-2, 0.9))
    )
    figures = FlatFigures(60, 0.003, 0.011, stable, every, theirs)
    assert [target.is_met for target in judge_flat(figures)] == [True, False, True, False, True, True]
    assert judge_flat(replace(figures, every=stable))[4].is_met is False
    alone = judge_flat(replace(figures, volume=None))
    assert [target.verdict for target in alone].count("not measured") == 2
    assert all(map(rows_fit, (tracking_sheet(figures), model_sheet(replace(figures, volume=None)))))


def wall(depth_m: float = 2.0) -> TrueSurface:
    """What a camera turned about its axis and moved sees of the plane one side of it: z = 2 m of the world."""
    T = se3.from_parts(so3.exp(np.array([0.0, 0.0, 0.7])), np.array([0.3, -0.2, 2.0 - depth_m]))
    builder = SurfaceBuilder(CAMERA)
    was_measured = np.ones((48, 64), bool)
    was_measured[:, :32] = False
    for shift_m in (0.0, 0.011):
        T[0, 3] += shift_m
        builder.add(np.full((48, 64), depth_m, np.float32), T, was_measured)
    return builder.surface()


def test_the_true_surface_is_where_it_is_and_distances_to_it_are_exact() -> None:
    surface = wall()
    np.testing.assert_allclose(surface.points[:, 2], 2.0, atol=1e-6)
    np.testing.assert_allclose(np.abs(surface.normals[:, 2]), 1.0, atol=1e-6)
    assert 0.4 < surface.was_seen.mean() < 0.7
    rng = np.random.default_rng(0)
    off_m = rng.uniform(-0.03, 0.03, 500)
    # Between the samples, inside the view: the plane is nearest, not the sample.
    points = np.column_stack([rng.uniform(0.1, 0.5, 500), rng.uniform(-0.4, 0.0, 500), 2.0 + off_m])
    np.testing.assert_allclose(surface.distances_m(points), np.abs(off_m), atol=1e-6)


def test_only_what_was_seen_must_be_covered() -> None:
    surface = wall()
    seen = surface.points[surface.was_seen]
    assert surface.covered(seen + [0, 0, 0.019]) == 1.0
    assert surface.covered(seen + [0, 0, 0.021]) == 0.0
    assert surface.covered(surface.points[~surface.was_seen][:1] + [0, 0, 9.0]) == 0.0
    assert surface.covered(np.empty((0, 3))) == 0.0
    half = seen[: len(seen) // 2]
    assert model_figures(surface, half).covered == pytest.approx(0.5, abs=0.1)
    assert model_figures(surface, half + [0, 0, 0.005]).mean_m == pytest.approx(0.005, abs=1e-6)


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    pytest.importorskip("mujoco")
    settings = SimulationSettings("flat", "ideal", size=(160, 120), rate_hz=10.0, duration_s=2.0, seed=3)
    return simulate(settings)


@pytest.mark.slow
def test_maps_fed_with_true_poses_lie_on_the_true_surface(recording: SimulatedRecording) -> None:
    poses, builder = TruePoses(recording), SurfaceBuilder(recording.calibration.cameras[1])
    surfels, volume = KnownSurfels(recording.calibration), volume_of(recording)
    for frame in recording.renderer.frames():
        builder.add(frame.depth_m, poses.at(frame.stamp_s), frame.depth_m < 3.5)
        for each in (surfels, volume):
            if each is not None:
                each.fuse(frame, poses)
    surface = builder.surface()
    ours = model_figures(surface, surfels.map.surfels().position.astype(float))
    assert ours.mean_m < 0.004
    assert ours.covered > 0.9
    if volume is not None:
        theirs = model_figures(surface, volume.points())
        assert theirs.mean_m < 0.008
        assert theirs.covered > 0.9


def test_a_true_pose_moves_as_its_twist_says(recording: SimulatedRecording) -> None:
    poses = TruePoses(recording)
    T_a_b = se3.invert(poses.at(1.0)) @ poses.at(1.1)
    np.testing.assert_allclose(T_a_b[:3, 3] / 0.1, poses.twist(1.05)[:3], atol=0.02)


def test_a_long_drive_times_every_frame(recording: SimulatedRecording) -> None:
    surfels = KnownSurfels(recording.calibration)
    for passage in drive(recording, surfels):
        assert len(passage.seconds) == recording.frame_count
        assert passage.stamps_s == sorted(passage.stamps_s)
        assert min(passage.seconds) > 0
    assert len(surfels.map) > 1000


def test_a_machine_that_gets_slower_is_not_blamed_on_the_map() -> None:
    """All took half as long again; the map's share of it is what frames took beyond that."""
    growth, yardstick = Growth("way", 100, 20.0, 33.0, 500.0), Growth("way", 100, 4.0, 6.0, 500.0)
    assert against(growth, yardstick).percent == pytest.approx(10.0)

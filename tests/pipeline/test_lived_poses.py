"""Poses of a run are kept to the last bit, on the disk or, where that is full, in memory."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mapping.scenes import peak_bytes
from narrowing import not_none

from wheelsight.app.run import track as lived_poses
from wheelsight.app.run.track import LivedPoses
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import se3

COUNT = 50


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lived_poses, "_CHUNK", 8)


def estimates(seed: int = 0) -> list[Estimate]:
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(size=(COUNT, 6)))
    covariances = rng.normal(size=(COUNT, 6, 6))
    return [Estimate(0.1 * k, Status.TRACKING, T[k], covariances[k], body="base") for k in range(COUNT)]


def kept(given: list[Estimate]) -> LivedPoses:
    poses = LivedPoses()
    for estimate in given:
        poses.add(estimate)
    return poses


def assert_all_are_there(poses: LivedPoses, given: list[Estimate]) -> None:
    found = poses.trajectory("base", "odom")
    assert (len(poses), found.body, found.frame) == (len(given), "base", "odom")
    np.testing.assert_array_equal(found.stamps_s, [one.stamp_s for one in given])
    np.testing.assert_array_equal(found.T_frame_body, [one.T_odom_body for one in given])
    assert found.covariances is not None
    np.testing.assert_array_equal(found.covariances, [one.covariance for one in given])


def test_poses_come_back_to_the_last_bit_and_go_on_after_they_were_asked_for() -> None:
    given = estimates()
    poses = kept(given[:30])
    assert_all_are_there(poses, given[:30])
    for estimate in given[30:]:
        poses.add(estimate)
    assert_all_are_there(poses, given)


def test_poses_are_in_order_of_time_and_the_last_of_a_stamp_counts() -> None:
    given = estimates()
    late = [*given[::2], *given[1::2]]
    again = Estimate(given[3].stamp_s, Status.TRACKING, given[7].T_odom_body, given[7].covariance)
    found = kept([*late, again]).trajectory("base", "map")
    np.testing.assert_array_equal(found.stamps_s, [one.stamp_s for one in given])
    np.testing.assert_array_equal(found.T_frame_body[3], given[7].T_odom_body)
    np.testing.assert_array_equal(found.T_frame_body[4], given[4].T_odom_body)


def test_without_one_covariance_there_are_none() -> None:
    given = estimates()
    given[20] = Estimate(given[20].stamp_s, Status.TRACKING, given[20].T_odom_body)
    assert kept(given).trajectory("base", "map").covariances is None
    empty = LivedPoses().trajectory("base", "map")
    assert (len(empty), empty.covariances) == (0, None)


class _FullDisk:
    """A file that takes some bytes, and then no more."""

    def __init__(self, room: int) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        self._room = room

    def write(self, data: Any) -> int:
        taken = min(len(data), self._room)
        if not taken:
            raise OSError("no space left on device")
        self._room -= taken
        return self._file.write(data[:taken])

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@pytest.mark.parametrize("chunks", [0, 0.5, 2.5])
def test_where_the_disk_is_full_they_stay_in_memory(chunks: float, monkeypatch: pytest.MonkeyPatch) -> None:
    given, full = estimates(), _FullDisk(int(chunks * 8 * 52 * 8))
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: full)
    assert_all_are_there(kept(given), given)


def test_poses_in_odom_are_there_where_the_filter_has_leapt() -> None:
    given = estimates()
    assert kept(given).odom("base") is None
    T_filter_odom = se3.from_plane(np.linspace(0.0, 1.0, COUNT), 0.5, -3.0)
    leapt = [
        Estimate(one.stamp_s, one.status, one.T_odom_body, one.covariance, body="base", T_filter_odom=T)
        for one, T in zip(given, T_filter_odom, strict=True)
    ]
    poses = kept(leapt)
    odom, filtered = poses.odom("base"), poses.trajectory("base", "map")
    assert odom is not None
    assert (odom.body, odom.frame) == ("base", "odom")
    np.testing.assert_allclose(odom.T_frame_body, [not_none(one.T_odom_body) for one in given], atol=1e-12)
    np.testing.assert_array_equal(filtered.T_frame_body, [one.T_filter_body for one in leapt])
    np.testing.assert_array_equal(filtered.covariances, [one.filter_covariance for one in leapt])


def test_a_trajectory_takes_little_beside_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are 416 bytes, and what comes out of them 424: all rows beside it would be twice that."""
    monkeypatch.setattr(lived_poses, "_CHUNK", 100)
    poses, given = LivedPoses(), estimates()
    for k in range(5000):
        poses.add(replace(given[k % COUNT], stamp_s=0.1 * k))
    assert peak_bytes(lambda: poses.trajectory("base", "map")) < 1.7 * 424 * 5000

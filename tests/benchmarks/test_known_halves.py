"""Halves of a recording, and where a pose lies beside the nearest keyframe."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
from synthetic import make_tum_recording

from benchmarks.known_halves import Half
from benchmarks.session_starts import beside_nearest
from wheelsight.core.geometry import se3
from wheelsight.io.recordings import open_recording


def test_halves_share_no_frame_and_leave_none_out(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=4)
    whole = open_recording(tmp_path / "room")
    stamps_s = [event.stamp_s for event in whole.events()]
    middle_s = stamps_s[len(stamps_s) // 2]
    first, second = Half(whole, -np.inf, middle_s), Half(whole, middle_s, np.inf)
    assert [event.stamp_s for half in (first, second) for event in half.events()] == stamps_s
    assert len(list(first.events())) == len(stamps_s) // 2


def test_a_pose_goes_with_its_nearest_keyframe_alone() -> None:
    """Two pieces of a map that lie apart by other motions: each pose goes by that of its own piece."""
    T_of = np.array([se3.from_plane(0.0, 0.0, 0.0), se3.from_plane(10.0, 0.0, 0.5)])
    moved = np.array([se3.from_plane(1.0, 2.0, 0.3), se3.from_plane(-3.0, 0.5, -0.2)])
    for k in range(2):
        T = T_of[k] @ se3.from_plane(0.4, -0.2, 0.1)
        assert_allclose(beside_nearest(T, T_of, moved @ T_of), moved[k] @ T, atol=1e-12)

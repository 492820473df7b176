"""How far a trajectory is from what depth images say, against a trajectory that is wrong by a known motion."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import synthetic

from benchmarks.agreement import Agreement, DepthPairs, agreement, agreement_sheet, main
from benchmarks.sequences import Sequence
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory

# Not loaded here: each process that tests are shared between would, at most one of which needs it.
pytestmark = pytest.mark.skipif(find_spec("open3d") is None, reason="Open3D is not installed: pip install '.[bench]'")

TRUTH = synthetic.wobbling_trajectory(31)


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    poses = zip(TRUTH.stamps_s, TRUTH.T_frame_body, strict=True)
    return [RgbdFrame(float(stamp_s), *synthetic.render_room(T)) for stamp_s, T in poses]


@pytest.fixture(scope="module")
def pairs(frames: list[RgbdFrame]) -> DepthPairs:
    return DepthPairs(frames, synthetic.CAMERA)


def test_true_poses_agree_with_depth(pairs: DepthPairs, frames: list[RgbdFrame]) -> None:
    found = agreement(pairs, frames, TRUTH, 15)
    assert found.pairs == 2
    assert found.metres < 2e-3
    assert found.radians < 2e-3


def test_what_is_wrong_shows(pairs: DepthPairs, frames: list[RgbdFrame]) -> None:
    """Each pose off by its time along one axis: over 15 frames, half a second, by a known way."""
    speed_m_s = 0.04
    T = TRUTH.T_frame_body.copy()
    T[:, 0, 3] += speed_m_s * TRUTH.stamps_s
    way_m = speed_m_s * (TRUTH.stamps_s[15] - TRUTH.stamps_s[0])
    found = agreement(pairs, frames, Trajectory(TRUTH.stamps_s, T), 15)
    assert found.metres == pytest.approx(way_m, rel=0.2)


def test_frames_without_a_pose_are_not_compared(pairs: DepthPairs, frames: list[RgbdFrame]) -> None:
    known = np.r_[0:12, 20:31]
    few = Trajectory(TRUTH.stamps_s[known], TRUTH.T_frame_body[known])
    assert agreement(pairs, frames, few, 15).pairs == 1


def test_what_cannot_be_seen_together_says_nothing(pairs: DepthPairs) -> None:
    assert pairs.change(0, 1, se3.exp([50.0, 0, 0, 0, 0, 0])) is None


def test_a_row_a_trajectory() -> None:
    sheet = agreement_sheet("hall", {"its truth": [Agreement(gap, 3, 0.012, 0.01) for gap in (15, 30, 60)]})
    assert sheet.rows == (("its truth", *3 * ("12.0 mm, 0.57°",)),)
    assert {len(row) for row in sheet.rows} == {len(sheet.header)}


def test_an_unknown_recording_is_one_line_that_names_those_there_are(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    there = [Sequence(name, Path(name), None) for name in ("hall", "kitchen")]
    monkeypatch.setattr("benchmarks.agreement.find_sequences", lambda data: there)
    monkeypatch.setattr("benchmarks.agreement.keep_to", lambda threads: None)
    monkeypatch.setattr("sys.argv", ["agreement", "--recording", "cellar"])
    with pytest.raises(SystemExit, match="2"):
        main()
    assert "--recording cellar is none of hall, kitchen" in capsys.readouterr().err


def test_depth_through_a_lens_is_refused(frames: list[RgbdFrame]) -> None:
    with pytest.raises(CalibrationError, match="has a lens"):
        DepthPairs(frames, replace(synthetic.CAMERA, distortion=(0.1, 0.0, 0.0, 0.0, 0.0)))

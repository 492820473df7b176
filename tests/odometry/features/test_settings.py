from __future__ import annotations

import pytest
from odometry.views import FRAME_S, odometry, room_frames, run
from pydantic import ValidationError
from synthetic import wobbling_trajectory

from wheelsight.vision.features import FeatureSettings


@pytest.mark.parametrize(
    "wrong",
    [{"reference": "map"}, {"seed": -1}, {"seed": 2**32}, {"keypoints": 10}, {"max_speed_m_s": float("inf")}]
    + [{"keyframe_share": 1.5}, {"lost_after": 0}, {"unknown": 1}],
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValidationError):
        FeatureSettings(**wrong)


def test_the_largest_seed_works():
    frames = room_frames(wobbling_trajectory(3))
    assert frames[1].stamp_s - frames[0].stamp_s == pytest.approx(FRAME_S)
    assert run(odometry(seed=2**32 - 1), frames)[-1].T_odom_body is not None

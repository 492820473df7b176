"""Verdict: what contradicts what, how sure that is, and who is left out for it."""

from __future__ import annotations

import numpy as np

from wheelsight.odometry.extrinsics import Agreement, Culprit, Explanation, depth_cause
from wheelsight.settings import BaseCheckSettings


class Verdict:
    """Judges as pieces come.

    Args:
        settings: how much it takes.

    Attributes:
        found: what explains the contradiction, as far as that is likely.
        is_sure: whether one of these surely is so.
        left_out: whose motions are left out from now on, or None.
        has_agreed: whether both are known to tell of one drive.
    """

    def __init__(self, settings: BaseCheckSettings) -> None:
        self.found: list[Explanation] = []
        self.is_sure = self.has_agreed = False
        self.left_out: Culprit | None = None
        self._settings = settings

    @property
    def warnings(self) -> tuple[str, ...]:
        """What contradicts what, why, and what to do, as a sentence."""
        if not self.is_sure:
            return ()
        causes = [" or ".join(_causes(self.found, who)) for who in Culprit]
        if self.left_out is None:
            told = f"either the wheels' fault ({causes[0]}) or the camera's ({causes[1]})"
            return (f"Wheels and camera contradict each other all along: {told}. The answer covers both.",)
        whose = "the camera's: " if self.left_out is Culprit.CAMERA else "the wheels': "
        other = "the wheels" if self.left_out is Culprit.CAMERA else "the camera"
        cause = causes[list(Culprit).index(self.left_out)]
        return (
            f"Wheels and camera contradict each other all along, and the fault is {whose}{cause}. "
            f"The answer is by {other} alone.",
        )

    def judge(self, agreement: Agreement, floor_ratio: float | None) -> bool:
        """Weigh all pieces, and the floor; False where nothing contradicts anything."""
        told = agreement.explanations(floor_ratio, is_accused=bool(self.found))
        self.found = [one for one in told if self._is_likely(one, agreement)]
        self.is_sure = bool(self.found) and all(self._is_surely(one, agreement) for one in self.found)
        if self.is_sure and len({one.culprit for one in self.found}) == 1:
            self.left_out = self.found[0].culprit
        is_enough = agreement.way_m > self._settings.enough_m and agreement.turn_rad > self._settings.enough_rad
        if not self.found and is_enough and agreement.agrees():
            self.has_agreed = True
        return bool(told)

    def leave_out_late_color(self, late_frames: int) -> None:
        """Colour surely is later than its depth: the camera is left out."""
        self.found, self.is_sure, self.left_out = [late_color(late_frames)], True, Culprit.CAMERA

    def leave_out_blind(self, floor_ratio: float) -> None:
        """A camera that shows the floor elsewhere, and cannot be followed, is left out without its ways."""
        cause = f"{depth_cause(floor_ratio)}, or the height in T_base_camera"
        self.found = [Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)), True, floor_ratio)]
        self.is_sure, self.left_out = True, Culprit.CAMERA

    def _is_likely(self, one: Explanation, agreement: Agreement) -> bool:
        if not one.is_scale:
            return True
        apart_m, apart_rad = np.ptp(agreement.ways_m), np.ptp(agreement.turns_rad)
        return bool(apart_m > self._settings.likely_m or apart_rad > self._settings.likely_rad)

    def _is_surely(self, one: Explanation, agreement: Agreement) -> bool:
        of, slips = self._settings, one.is_scale and one.culprit is Culprit.WHEELS
        way_m, turn_rad = (of.sure_slip_m, of.sure_slip_rad) if slips else (of.sure_m, of.sure_rad)
        return agreement.pieces >= of.sure_pieces and (agreement.way_m > way_m or agreement.turn_rad > turn_rad)


def late_color(late_frames: int) -> Explanation:
    """Colour that is later than its depth by so many frames."""
    frames = "a frame" if late_frames == 1 else f"{late_frames} frames"
    cause = f"its colour images are {frames} later than the depth that they come with: pair them by their stamps"
    return Explanation(Culprit.CAMERA, cause, np.zeros((6, 2)))


def _causes(found: list[Explanation], whose: Culprit) -> list[str]:
    return list(dict.fromkeys(one.cause for one in found if one.culprit is whose))

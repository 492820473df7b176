"""What wheels, camera, the paper's filter and the default filter answer to one stream of events."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight.core.messages import Event
from wheelsight.estimation import FusedEstimate, Localizer

WHEELS, CAMERA, PAPER, JOINED = "wheels", "camera", "paper's filter", "joined"


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """All answers of one localizer, in order.

    Attributes:
        estimates: those of the events that it answers.
    """

    estimates: list[Estimate] = field(default_factory=list)

    @property
    def posed(self) -> list[Estimate]:
        """Those with a pose."""
        return [estimate for estimate in self.estimates if estimate.T_odom_body is not None]

    @property
    def stamps_s(self) -> FloatArray:
        """(N,) of all."""
        return np.array([estimate.stamp_s for estimate in self.estimates])

    def is_status(self, *statuses: Status) -> BoolArray:
        """(N,) whether the status is one of these."""
        return np.array([estimate.status in statuses for estimate in self.estimates], bool)

    def is_flagged(self, *names: str) -> BoolArray:
        """(N,) whether one of these flags is up."""
        fused = [estimate if isinstance(estimate, FusedEstimate) else None for estimate in self.estimates]
        return np.array([f is not None and any(getattr(f, name) for name in names) for f in fused], bool)


def localizer_of(name: str, calibration: Calibration, odometry: str = "dense") -> Localizer:
    """A fresh localizer by its name; dense odometry has a map, alone and joined."""
    has_map = {"map": "surfels"} if odometry == "dense" else {}
    both = {"odometry": f"wheels,{odometry}", **has_map}
    overrides = {
        WHEELS: {"odometry": "wheels"},
        CAMERA: {"odometry": odometry, **has_map},
        PAPER: {**both, "fusion": "ligocki"},
        JOINED: both,
    }
    return Localizer(calibration, load_config(overrides=overrides[name]))


def run_all(events: Iterable[Event], calibration: Calibration, odometry: str = "dense") -> dict[str, Answers]:
    """Each localizer's answers to the same events, by its name.

    The paper's filter is reported the answers of the camera alone: it goes by these, and would find the same again.
    """
    localizers = {name: localizer_of(name, calibration, odometry) for name in (WHEELS, CAMERA, PAPER, JOINED)}
    again = _Again()
    vars(localizers[PAPER]._estimator)["_camera"] = again
    answers = {name: Answers() for name in localizers}
    for event in events:
        for name, localizer in localizers.items():
            estimate = localizer.process(event)
            if estimate is not None:
                answers[name].estimates.append(estimate)
            if name == CAMERA:
                again.estimate = estimate
    return answers


class _Again:
    """Says once more what the camera has answered."""

    estimate: Estimate | None = None

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        return self.estimate, ""

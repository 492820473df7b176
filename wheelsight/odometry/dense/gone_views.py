"""GoneViews: keyframes that there is no room for as views, and that come back from the store where the camera does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.errors import MapError
from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.odometry.dense.grid import Gridder, GridFrame
from wheelsight.odometry.dense.keypoints import KeypointTracker
from wheelsight.odometry.dense.reference import ReferenceMaker
from wheelsight.odometry.dense.views import KnownView


@dataclass(frozen=True, slots=True, eq=False)
class _Gone:
    """What the store does not have of a view, some 0.5 kB.

    Attributes:
        covariance: (6, 6) of the right perturbation of its pose: no motion of the map changes that.
        turning_rad_s, vignetting: as the view and its reference have them.
    """

    covariance: FloatArray
    turning_rad_s: FloatArray
    vignetting: float


class GoneViews:
    """See the module.

    Only those come back that loops tie to keyframes of another time: how far off the others are from where the camera
    has come to, odometry alone would say, and that loops can mend it new keyframes are needed.

    Args:
        store: has the keyframes, and where they are.
        gridder, maker, keypoints: make views of them.
        room: of another time is a keyframe that so many others follow, for which there is room.
    """

    def __init__(
        self, store: KeyframeStore, gridder: Gridder, maker: ReferenceMaker, keypoints: KeypointTracker, room: int
    ) -> None:
        self._store, self._gridder, self._maker, self._keypoints = store, gridder, maker, keypoints
        self._room = room
        self._gone: dict[KeyframeId, _Gone] = {}

    def __len__(self) -> int:
        return len(self._gone)

    def put(self, view: KnownView) -> None:
        """A view that is a keyframe of the store."""
        Ad = se3.adjoint(se3.invert(view.reference.T_map_reference))
        covariance = Ad @ view.covariance @ Ad.T
        self._gone[view.keyframe] = _Gone(covariance, view.turning_rad_s, view.reference.vignetting)

    def nearer(self, T_map_camera: FloatArray, limit_m: float) -> KnownView | None:
        """The tied one whose view is nearest to one from there (4, 4), a turn by a radian as 1.5 m, if that is nearer.

        None, too, where the disk has lost it, or has it in another size than frames are aligned in. It stays here: see
        `take`.
        """
        numbers = [number for number in self._gone if self.is_tied(number)]
        if not numbers:
            return None
        apart_m = se3.view_shift_m(se3.invert(self._store.T_map_keyframe[numbers]) @ T_map_camera)
        nearest = int(np.argmin(apart_m))
        return self._recalled(numbers[nearest]) if apart_m[nearest] < limit_m else None

    def is_tied(self, number: KeyframeId) -> bool:
        """Whether loops tie a keyframe to one of another time."""
        return self._store.tied_over(number) >= self._room

    def take(self, view: KnownView) -> None:
        """One that is held from now on."""
        self._gone.pop(view.keyframe, None)

    def _recalled(self, number: KeyframeId) -> KnownView | None:
        try:
            keyframe = self._store.recalled(number, KeyframeId(len(self._store) - 1))
        except MapError:  # the disk is gone, or damaged there: the camera goes on without
            return None
        gone, T_map_keyframe = self._gone[number], self._store.pose(number)
        grid = self._on_grid(keyframe, gone.vignetting)
        if grid is None:
            return None
        reference, Ad = self._maker.of_frame(grid, T_map_keyframe), se3.adjoint(T_map_keyframe)
        features = None if keyframe.features is None else self._keypoints.recalled(keyframe.stamp_s, keyframe.features)
        return KnownView(number, reference, Ad @ gone.covariance @ Ad.T, features, gone.turning_rad_s)

    def _on_grid(self, keyframe: Keyframe, vignetting: float) -> GridFrame | None:
        """None for one of another size."""
        depth_m, grey = keyframe.depth_m, keyframe.grey
        if depth_m.shape != self._gridder.shape:
            return None
        grey[grey == 0] = -1  # as which unknown grey is kept
        return GridFrame(keyframe.stamp_s, self._gridder.pyramid(depth_m, grey), np.zeros(6), vignetting)

"""LandmarkMap: points seen from keyframes, the small local map against which frames are aligned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.odometry.features.extraction import Features

# Where a camera looks: two views are near when the points this far in front of them are.
_VIEW_DISTANCE_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame whose pose is known.

    Attributes:
        features: of the frame.
        T_map_color: (4, 4) its colour camera's pose.
        covariance: (6, 6) of the left perturbation of that pose.
        landmark: (N,) number of the landmark each keypoint shows, -1 for none.
    """

    features: Features
    T_map_color: FloatArray
    covariance: FloatArray
    landmark: IntArray


class LandmarkMap:
    """Landmarks in flat arrays, held as long as a kept keyframe saw them; numbers are never reused.

    Attributes:
        keyframes: those kept, oldest first.
        numbers: (L,) of the landmarks, growing.
        points: (L, 3) in the map, metres.
        descriptors: (L, 4) of the last view.
        sightings: (L,) how often each was seen.
    """

    def __init__(self, kept_keyframes: int) -> None:
        self.keyframes: list[View] = []
        self.numbers: IntArray = np.zeros(0, np.int64)
        self.points: FloatArray = np.zeros((0, 3))
        self.descriptors: UInt64Array = np.zeros((0, 4), np.uint64)
        self.sightings: FloatArray = np.zeros(0)
        self._weight: FloatArray = np.zeros(0)
        self._last_keyframe: IntArray = np.zeros(0, np.int64)
        self._kept_keyframes = kept_keyframes
        self._forgotten = 0
        self._next_number = 0

    def add_keyframe(self, view: View) -> View:
        """Keep a view; its keypoints with depth that show no landmark yet become new ones. Returns it with those."""
        features, landmark = view.features, view.landmark.copy()
        landmark[landmark >= 0] = np.where(self.holds(landmark[landmark >= 0]), landmark[landmark >= 0], -1)
        number = self._forgotten + len(self.keyframes)
        self._last_keyframe[self._rows(landmark[landmark >= 0])] = number
        new = np.flatnonzero((landmark < 0) & features.has_depth)
        landmark[new] = self._next_number + np.arange(len(new))
        self._next_number += len(new)
        self.numbers = np.concatenate([self.numbers, landmark[new]])
        self.points = np.concatenate([self.points, se3.apply(view.T_map_color, features.points[new])])
        self.descriptors = np.concatenate([self.descriptors, features.descriptors[new]])
        self.sightings = np.concatenate([self.sightings, np.ones(len(new))])
        self._weight = np.concatenate([self._weight, features.sigma_m[new] ** -2.0])
        self._last_keyframe = np.concatenate([self._last_keyframe, np.full(len(new), number)])
        keyframe = View(features, view.T_map_color, view.covariance, landmark)
        self.keyframes.append(keyframe)
        if len(self.keyframes) > self._kept_keyframes:
            self._forget_oldest()
        return keyframe

    def near(self, T_map_color: FloatArray, count: int) -> IntArray:
        """Numbers (M,) of landmarks last kept by the `count` keyframes that look where this camera (4, 4) looks."""
        if len(self.keyframes) <= count:
            return self.numbers
        views = np.array([keyframe.T_map_color for keyframe in self.keyframes])
        ahead = views[:, :3, 3] + _VIEW_DISTANCE_M * views[:, :3, 2]
        here = T_map_color[:3, 3] + _VIEW_DISTANCE_M * T_map_color[:3, 2]
        chosen = np.zeros(len(self.keyframes), bool)
        chosen[np.argsort(np.linalg.norm(ahead - here, axis=1), kind="stable")[:count]] = True
        return self.numbers[chosen[self._last_keyframe - self._forgotten]]

    def get(self, numbers: IntArray) -> tuple[FloatArray, UInt64Array, FloatArray]:
        """Points (M, 3), descriptors (M, 4) and sightings (M,) of held landmarks (M,)."""
        rows = self._rows(numbers)
        return self.points[rows], self.descriptors[rows], self.sightings[rows]

    def holds(self, numbers: IntArray) -> BoolArray:
        """(M,) which of the landmarks (M,) are still held."""
        return np.isin(numbers, self.numbers, assume_unique=True)

    def see_again(self, numbers: IntArray, features: Features, seen: IntArray, T_map_color: FloatArray) -> None:
        """Average landmarks (M,) with the points that keypoints `seen` (M,) show of them, each weighted by 1/σ_z²."""
        rows = self._rows(numbers)
        self.descriptors[rows] = features.descriptors[seen]
        self.sightings[rows] += 1
        lifted = features.has_depth[seen]
        rows, seen = rows[lifted], seen[lifted]
        weight = features.sigma_m[seen] ** -2.0
        total = self._weight[rows] + weight
        p_map = se3.apply(T_map_color, features.points[seen])
        self.points[rows] += (weight / total)[:, None] * (p_map - self.points[rows])
        self._weight[rows] = total

    def _rows(self, numbers: IntArray) -> IntArray:
        return np.searchsorted(self.numbers, numbers)

    def _forget_oldest(self) -> None:
        self.keyframes.pop(0)
        self._forgotten += 1
        kept = self._last_keyframe >= self._forgotten
        self.numbers, self.points, self.descriptors = self.numbers[kept], self.points[kept], self.descriptors[kept]
        self.sightings, self._weight = self.sightings[kept], self._weight[kept]
        self._last_keyframe = self._last_keyframe[kept]

"""LandmarkMap: points seen from keyframes, the small local map against which frames are aligned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.geometry.arrays import UInt64Array
from wheelsight.keyframes import KeyframeId
from wheelsight.odometry.features.extraction import Features
from wheelsight.odometry.features.settings import FeatureSettings


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame whose pose is known.

    Attributes:
        features: of the frame.
        T_map_color: (4, 4) its colour camera's pose.
        covariance: (6, 6) of the left perturbation of that pose.
        landmark: (N,) number of the landmark each keypoint shows, -1 for none.
        keyframe: with which the view moves, or None.
    """

    features: Features
    T_map_color: FloatArray
    covariance: FloatArray
    landmark: IntArray
    keyframe: KeyframeId | None = None

    def moved(self, T_new_old: FloatArray) -> View:
        """The same after keyframes have moved in the map by (K, 4, 4)."""
        if self.keyframe is None:
            return self
        T, Ad = T_new_old[self.keyframe], se3.adjoint(T_new_old[self.keyframe])
        return replace(self, T_map_color=se3.mended(T @ self.T_map_color), covariance=Ad @ self.covariance @ Ad.T)


class LandmarkMap:
    """Landmarks in flat arrays, held as long as a kept keyframe saw them; numbers are never reused.

    Attributes:
        keyframes: those kept, oldest first.
        numbers: (L,) of the landmarks, growing.
        points: (L, 3) in the map, metres.
        descriptors: (L, 4) of the last view.
        sightings: (L,) how often each was seen.
        made_by: (L,) the keyframes that made them, with which they move.
    """

    def __init__(self, settings: FeatureSettings) -> None:
        self.keyframes: list[View] = []
        self.numbers: IntArray = np.zeros(0, np.int64)
        self.points: FloatArray = np.zeros((0, 3))
        self.descriptors: UInt64Array = np.zeros((0, 4), np.uint64)
        self.sightings: FloatArray = np.zeros(0)
        self.made_by: IntArray = np.zeros(0, np.int64)
        self._weight: FloatArray = np.zeros(0)
        self._last_keyframe: IntArray = np.zeros(0, np.int64)
        self._settings = settings
        self._forgotten = 0
        self._next_number = 0

    def add_keyframe(self, view: View, number: KeyframeId) -> View:
        """Keep a view as that keyframe; its keypoints with depth that show no landmark yet become new ones.

        Returns it with those.
        """
        features, landmark = view.features, view.landmark.copy()
        landmark[landmark >= 0] = np.where(self.holds(landmark[landmark >= 0]), landmark[landmark >= 0], -1)
        place = self._forgotten + len(self.keyframes)
        self._last_keyframe[self._rows(landmark[landmark >= 0])] = place
        new = np.flatnonzero((landmark < 0) & features.has_depth)
        landmark[new] = self._next_number + np.arange(len(new))
        self._next_number += len(new)
        self.numbers = np.concatenate([self.numbers, landmark[new]])
        self.points = np.concatenate([self.points, se3.apply(view.T_map_color, features.points[new])])
        self.descriptors = np.concatenate([self.descriptors, features.descriptors[new]])
        self.sightings = np.concatenate([self.sightings, np.ones(len(new))])
        self._weight = np.concatenate([self._weight, features.sigma_m[new] ** -2.0])
        self._last_keyframe = np.concatenate([self._last_keyframe, np.full(len(new), place)])
        self.made_by = np.concatenate([self.made_by, np.full(len(new), number)])
        keyframe = replace(view, landmark=landmark, keyframe=number)
        self.keyframes.append(keyframe)
        if len(self.keyframes) > self._settings.kept_keyframes:
            self._forget_oldest()
        return keyframe

    def forget_keypoints(self) -> None:
        """Of keyframes but the newest keep only where they are: for who recognises none by its keypoints."""
        if len(self.keyframes) > 1:
            before = self.keyframes[-2]
            self.keyframes[-2] = replace(before, features=before.features.some(0), landmark=before.landmark[:0].copy())

    def move(self, T_new_old: FloatArray) -> None:
        """Landmarks and views go with their keyframes, which have moved in the map by (K, 4, 4)."""
        self.keyframes[:] = [keyframe.moved(T_new_old) for keyframe in self.keyframes]
        self.points = se3.apply(T_new_old[self.made_by], self.points[:, None])[:, 0]

    def near(self, T_map_color: FloatArray, count: int) -> IntArray:
        """Numbers (M,) of landmarks last kept by the `count` keyframes that look where this camera (4, 4) looks."""
        if len(self.keyframes) <= count:
            return self.numbers
        views = np.array([keyframe.T_map_color for keyframe in self.keyframes])
        distance_m = self._settings.view_distance_m
        ahead = views[:, :3, 3] + distance_m * views[:, :3, 2]
        here = T_map_color[:3, 3] + distance_m * T_map_color[:3, 2]
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
        self._last_keyframe, self.made_by = self._last_keyframe[kept], self.made_by[kept]

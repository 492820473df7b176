"""Where one frame is seen from another, by the transforms of /tf_static and /tf."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wheelsight.geometry import FloatArray, se3, so3
from wheelsight.recordings.rosbag.definitions import are_measured

_LONGEST_QUATERNION_OFF = 0.1
# A humanoid has 200 frames. Of messages, 400 are read with up to 200 transforms each.
_MOST_FRAMES, _MOST_READ, _MOST_WARNINGS = 1000, 100_000, 20


class Transforms:
    """A tree of frames as a bag tells it; what contradicts itself is told in `warnings`, and the first stands.

    Attributes:
        warnings: one sentence each.
        moving: (parent, child) of transforms that change.
    """

    def __init__(self, apart_m: float, apart_rad: float) -> None:
        self.warnings: list[str] = []
        self.moving: set[tuple[str, str]] = set()
        self._T: dict[tuple[str, str], FloatArray] = {}
        self._static: set[tuple[str, str]] = set()
        self._parents: dict[str, str] = {}
        self._left = _MOST_READ
        self._apart_m, self._apart_rad = apart_m, apart_rad

    def __bool__(self) -> bool:
        return bool(self._T)

    def add(self, transforms: Sequence[Any], is_static: bool) -> bool:
        """Count in what a TFMessage holds; whether there is room for more."""
        self._left -= len(transforms)
        if self._left < 0 or len(self._T) > _MOST_FRAMES:
            self._warn(f"tf has more than {_MOST_FRAMES:,} frames or {_MOST_READ:,} transforms; others are left out.")
            return False
        for stamped in transforms:
            parent, child = stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/")
            T = motion_of(stamped.transform.translation, stamped.transform.rotation)
            if len(self._T) > _MOST_FRAMES:
                return False
            if T is None:
                self._warn(f"tf: the transform from {parent} to {child} is no rigid motion; it is left out.")
            elif (parent, child) not in self._T:
                self._check_parent(parent, child)
                self._T[parent, child] = T
            elif self._differ(self._T[parent, child], T):
                self._contradict(parent, child, is_static)
            if is_static:
                self._static.add((parent, child))
        return True

    def between(self, a: str, b: str) -> FloatArray | None:
        """T_a_b (4, 4); None where no transforms that stand still lead from one to the other."""
        reached, todo = {a: np.eye(4)}, [a]
        while todo:
            frame = todo.pop()
            for (parent, child), T in self._T.items():
                if (parent, child) in self.moving:
                    continue
                if parent == frame and child not in reached:
                    reached[child] = se3.compose(reached[frame], T)
                    todo.append(child)
                elif child == frame and parent not in reached:
                    reached[parent] = se3.compose(reached[frame], se3.invert(T))
                    todo.append(parent)
        return reached.get(b)

    def _check_parent(self, parent: str, child: str) -> None:
        first = self._parents.setdefault(child, parent)
        if first != parent:
            self._warn(f"tf contradicts itself: {child} hangs on {first} and on {parent}; the first is believed first.")

    def _contradict(self, parent: str, child: str, is_static: bool) -> None:
        if is_static or (parent, child) in self._static:
            self._warn(f"tf contradicts itself: two static transforms lead from {parent} to {child}; the first stands.")
        else:
            self.moving.add((parent, child))

    def _differ(self, T: FloatArray, other: FloatArray) -> bool:
        apart = se3.compose(se3.invert(T), other)
        is_far = np.linalg.norm(apart[:3, 3]) > self._apart_m
        return bool(is_far or so3.angle(apart[:3, :3]) > self._apart_rad)

    def _warn(self, sentence: str) -> None:
        if sentence not in self.warnings and len(self.warnings) < _MOST_WARNINGS:
            self.warnings.append(sentence)


def motion_of(t: Any, q: Any) -> FloatArray | None:
    """T (4, 4) of a translation and a quaternion as messages have them, or None where their numbers are none."""
    if not are_measured((t.x, t.y, t.z, q.x, q.y, q.z, q.w)):
        return None
    quaternion = np.array([q.x, q.y, q.z, q.w])
    if abs(np.linalg.norm(quaternion) - 1) > _LONGEST_QUATERNION_OFF:
        return None
    return se3.from_quaternion([t.x, t.y, t.z], quaternion / np.linalg.norm(quaternion))

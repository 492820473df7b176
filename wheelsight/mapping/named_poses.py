"""`NamedPoses` holds the named poses of a map, such as "kitchen"; each may move with a keyframe.

The module also checks names of poses and areas, and reads the JSON files of annotations.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.core.errors import ArgumentError, MapError
from wheelsight.core.files import StrPath, write_text
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.inputs import Kind, parse_json, read_text
from wheelsight.core.keyframes import KeyframeId

FORMAT, VERSION = "wheelsight-named-poses", 1
_FILE = Kind("named poses of a map", most_mb=4, fix="give a file that NamedPoses.save wrote")
_FIELDS = ("name", "pose", "keyframe", "T_map_keyframe")
_FARTHEST_M = 1e6
# A name for each shelf of a large store; reading this many takes half a second.
_MOST_NAMES = 10_000


@dataclass(frozen=True, slots=True, eq=False)
class NamedPose:
    """A pose of the base with a name.

    Attributes:
        name: up to 60 letters, digits, spaces and signs, without commas, which coordinates have.
        pose: (3,) x, y in metres and yaw in radians in `map`; a yaw of NaN is any heading.
        T_map_keyframe: (4, 4) pose of the keyframe when the pose was named, or None.

    Raises MapError if the name is invalid, the position is beyond 1000 km, or a keyframe has no pose.
    """

    name: str
    pose: FloatArray
    keyframe: KeyframeId | None = None
    T_map_keyframe: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", checked_name(self.name))
        at = np.array(self.pose, float).ravel()
        at = np.array([*at, np.nan]) if len(at) == 2 else at
        if len(at) != 3 or not (np.abs(at[:2]) < _FARTHEST_M).all() or np.isinf(at[2]):
            problem = f"{self.name} is beyond 1000 km"
            raise MapError(problem, fix="x and y in metres in the frame map, and a heading")
        at.setflags(write=False)
        object.__setattr__(self, "pose", at)
        check_anchor(self)

    def pose_now(self, T_map_keyframe: ArrayLike) -> FloatArray:
        """Return the pose (3,) at the current keyframe pose, given poses (K, 4, 4) by number.

        Raises ArgumentError if the pose of its keyframe is missing.
        """
        T_new_old = motion_of_anchor(self, T_map_keyframe)
        if T_new_old is None:
            return self.pose
        x, y, yaw = self.pose
        at = T_new_old @ se3.from_plane(x, y, 0.0 if np.isnan(yaw) else yaw)
        return np.array([at[0, 3], at[1, 3], np.nan if np.isnan(yaw) else np.arctan2(at[1, 0], at[0, 0])])

    def moved_to_now(self, T_map_keyframe: FloatArray) -> NamedPose:
        """Return the pose at the current keyframe pose."""
        return replace(self, pose=self.pose_now(T_map_keyframe))

    def attached_to_nearest(self, T_map_keyframe: ArrayLike, among: IntArray) -> NamedPose:
        """Return the pose attached to the nearest of keyframes `among` (N,), given poses (K, 4, 4) of all."""
        return replace(self, **nearest_anchor(self.pose[:2], T_map_keyframe, among))


@dataclass(frozen=True, slots=True, eq=False)
class NamedPoses:
    """All named poses of a map, sorted by name, at most 10 000.

    Raises MapError if a name is given twice, or there are too many.
    """

    poses: tuple[NamedPose, ...] = ()

    def __post_init__(self) -> None:
        if len(self.poses) > _MOST_NAMES:
            raise MapError(f"there are more than {_MOST_NAMES:,} names", fix="remove some")
        twice = name_given_twice(one.name for one in self.poses)
        if twice is not None:
            raise MapError(f"the name {twice!r} is given twice", fix="each name once")
        object.__setattr__(self, "poses", tuple(sorted(self.poses, key=lambda one: one.name)))

    def __len__(self) -> int:
        return len(self.poses)

    def __iter__(self) -> Iterator[NamedPose]:
        return iter(self.poses)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(one.name for one in self.poses)

    def named(self, name: str) -> NamedPose:
        """Return the pose with a name. Raises MapError with the nearest name and all known ones."""
        found = next((one for one in self.poses if one.name == name), None)
        if found is None:
            raise unknown_name(name, self.names)
        return found

    def with_pose(self, pose: NamedPose) -> NamedPoses:
        """Return the poses with one more, which replaces the one with the same name."""
        return NamedPoses((*(one for one in self.poses if one.name != pose.name), pose))

    def without(self, name: str) -> NamedPoses:
        """Return the poses without the one with a name. Raises MapError as `named`."""
        gone = self.named(name)
        return NamedPoses(tuple(one for one in self.poses if one is not gone))

    def transferred(self, T_map_keyframe: ArrayLike, numbers: IntArray, *, is_same_frame: bool = True) -> NamedPoses:
        """Return the poses for a map made of this one's keyframes, by the rules of `MapEdits.transferred`."""
        return NamedPoses(transferred(self.poses, T_map_keyframe, numbers, is_same_frame))

    def beside(self, other: NamedPoses) -> NamedPoses:
        """Return both. If both have the same name, the other one's gets a number appended."""
        names = free_names(other.names, self.names)
        renamed = [replace(one, name=name) for one, name in zip(other.poses, names, strict=True) if name is not None]
        return NamedPoses((*self.poses, *renamed))

    def save(self, path: StrPath) -> None:
        """Write the poses as JSON, atomically. Raises OutputError."""
        listed = []
        for one in self.poses:
            pose = one.pose.tolist() if np.isfinite(one.pose[2]) else one.pose[:2].tolist()
            T = None if one.T_map_keyframe is None else one.T_map_keyframe.tolist()
            values = (one.name, pose, one.keyframe, T)
            listed.append({field: value for field, value in zip(_FIELDS, values, strict=True) if value is not None})
        document = {"format": FORMAT, "version": VERSION, "places": listed}
        write_text(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n")

    @classmethod
    def load(cls, path: StrPath) -> NamedPoses:
        """Read a file written by `save`. Raises MapError if it is missing, of another format or newer, or has an
        invalid pose.
        """
        path = Path(path)
        listed = read_list(path, _FILE, (FORMAT, VERSION), "places")
        try:
            if len(listed) > _MOST_NAMES:
                raise MapError(f"holds {len(listed):,} names, more than {_MOST_NAMES:,}", fix="is it the right file?")
            poses = []
            for fields in listed:
                if not isinstance(fields, dict) or not set(fields) <= set(_FIELDS):
                    raise MapError("a place has wrong fields", fix=f"its fields are {', '.join(_FIELDS)}")
                name, pose, keyframe, T = (fields.get(field) for field in _FIELDS)
                number = keyframe_number(keyframe, f"keyframe of {name!r}")
                T = None if T is None else _numbers(T, f"T_map_keyframe of {name!r}", ((4, 4),))
                at = _numbers(pose, f"{name!r}", ((2,), (3,)))
                poses.append(NamedPose(name if isinstance(name, str) else "", at, number, T))
            return cls(tuple(poses))
        except MapError as error:
            raise MapError(error.problem, path=path, fix=error.fix) from error


def _numbers(value: Any, name: str, shapes: tuple[tuple[int, ...], ...]) -> FloatArray:
    try:
        found = np.array(value, float)
    except (TypeError, ValueError):
        found = np.empty(0)
    if found.shape not in shapes or not np.isfinite(found).all():
        raise MapError(f"{name} is no pose", fix="finite numbers: [x, y] or [x, y, yaw]; of a keyframe (4, 4)")
    return found


_Annotation = TypeVar("_Annotation")  # a `NamedPose` or a `MapEdit`


def check_anchor(one: Any) -> None:
    """Raise MapError for a keyframe without its pose, a pose without its keyframe, or an invalid pose."""
    if (one.keyframe is None) != (one.T_map_keyframe is None):
        raise MapError("an anchor is a keyframe and its pose", fix="give both, or neither")
    if one.T_map_keyframe is not None and not se3.is_valid(one.T_map_keyframe):
        raise MapError(f"the pose of keyframe {one.keyframe} is no rigid motion", fix="give SE(3), (4, 4)")


def motion_of_anchor(one: Any, T_map_keyframe: ArrayLike) -> FloatArray | None:
    """Return T_new_old (4, 4) of an annotation's keyframe, given poses (K, 4, 4) by number; None if it has none.

    Raises ArgumentError if the keyframe's pose is missing.
    """
    if one.keyframe is None or one.T_map_keyframe is None:
        return None
    table = np.asarray(T_map_keyframe, float)
    if one.keyframe >= len(table) or not np.isfinite(table[one.keyframe]).all():
        raise ArgumentError(f"there is no pose of keyframe {one.keyframe}", fix="give those of the annotation's map")
    return np.asarray(table[one.keyframe] @ se3.invert(one.T_map_keyframe))


def nearest_anchor(xy_map: FloatArray, T_map_keyframe: ArrayLike, among: IntArray) -> dict[str, Any]:
    """Return the anchor of a point (2,): the nearest of keyframes `among` (N,) with its pose; None without any."""
    if not len(among):
        return {"keyframe": None, "T_map_keyframe": None}
    table = np.asarray(T_map_keyframe, float)
    nearest = int(among[np.argmin(np.linalg.norm(table[among, :2, 3] - xy_map, axis=1))])
    return {"keyframe": KeyframeId(nearest), "T_map_keyframe": table[nearest].copy()}


def transferred(
    annotations: Iterable[_Annotation], T_map_keyframe: ArrayLike, numbers: IntArray, is_same_frame: bool
) -> tuple[_Annotation, ...]:
    """Return annotations for a map made of this one's keyframes; see `MapEdits.transferred`."""
    table, kept = np.asarray(T_map_keyframe, float), np.flatnonzero(numbers >= 0)
    found = []
    for one in cast(Iterable[Any], annotations):
        # A file may name keyframes that its map never had.
        number = -1 if one.keyframe is None or one.keyframe >= len(numbers) else int(numbers[one.keyframe])
        if one.keyframe is None and is_same_frame:
            found.append(one)
        elif number >= 0:
            found.append(replace(one, keyframe=KeyframeId(number)))
        elif len(kept):
            is_lost = one.keyframe is not None and not np.isfinite(table[one.keyframe : one.keyframe + 1]).any()
            attached = (one if is_lost else one.moved_to_now(table)).attached_to_nearest(table, kept)
            found.append(replace(attached, keyframe=KeyframeId(int(numbers[attached.keyframe]))))
    return tuple(found)


LONGEST_NAME = 60
# Room for a space and a number after a name.
_ROOM = 6
# Names shown in one line; `wheelsight map name MAP --list` shows all.
_MOST_SHOWN = 50


def checked_name(name: Any) -> str:
    """Return a name with single spaces between its words.

    It has up to 60 letters, digits, spaces and signs, without commas, which coordinates have.

    Raises MapError if the name is invalid.
    """
    text = " ".join(name.split()) if isinstance(name, str) else ""
    if not text or "," in text or len(text) > LONGEST_NAME or not text.isprintable() or text.startswith("-"):
        problem = f"{name!r} is no name for a place"
        raise MapError(problem, fix=f"up to {LONGEST_NAME} letters, digits and spaces, without commas")
    return text


def free_names(names: Iterable[str | None], taken: Iterable[str]) -> Iterator[str | None]:
    """Yield each name, with a number from 2 on appended if it is taken, or used before in the list."""
    used, next_number = set(taken), dict[str, int]()
    for name in names:
        found, begin = name, "" if name is None else name[: LONGEST_NAME - _ROOM]
        number = next_number.get(begin, 2)  # searching from 2 each time would be quadratic
        while found in used:
            found, number = f"{begin} {number}", number + 1
        next_number[begin] = number
        if found is not None:
            used.add(found)
        yield found


def keyframe_number(value: Any, what: str) -> KeyframeId | None:
    """Return the number of a keyframe in JSON, or None. Raises MapError."""
    if value is not None and (type(value) is not int or value < 0):
        raise MapError(f"{what} is {value!r}", fix="the number of a keyframe")
    return None if value is None else KeyframeId(value)


def name_given_twice(names: Iterable[str]) -> str | None:
    """Return the first name that occurs more than once, or None."""
    return next((name for name, count in Counter(names).items() if count > 1), None)


def unknown_name(name: str, known: Collection[str]) -> MapError:
    """Return the error for an unknown name, with the nearest known name and all of them."""
    lower = {one.lower(): one for one in known}
    near = get_close_matches(name.lower(), lower, n=1)
    meant = f" (did you mean {lower[near[0]]}?)" if near else ""
    fix = "the map has no names yet: wheelsight map name MAP NAME --at X,Y,YAW_DEG"
    if known:
        shown, more = sorted(known)[:_MOST_SHOWN], len(known) - _MOST_SHOWN
        fix = f"known: {', '.join(shown)}" + (f" and {more:,} more" if more > 0 else "")
    return MapError(f"no place of the map is called {name!r}{meant}", fix=fix)


def read_list(path: Path, kind: Kind, written: tuple[str, int], field: str) -> list[Any]:
    """Return the list of an annotation file.

    Args:
        written: its format, and the newest readable version.

    Raises MapError if the file is missing, of another format, newer, or has no list.
    """
    name, newest = written
    try:
        document = parse_json(read_text(path, kind, MapError))
    except ValueError as error:
        raise MapError(f"is no JSON: {error}", path=path, fix=kind.fix) from error
    if not isinstance(document, dict) or document.get("format") != name:
        raise MapError(f"is not of format {name!r}", path=path, fix=kind.fix)
    version = document.get("version")
    if type(version) is not int or not 1 <= version <= newest:
        problem = f"its version is {version!r}, and this wheelsight reads {newest}"
        raise MapError(problem, path=path, fix="open it with the wheelsight that wrote it, or a newer one")
    listed = document.get(field)
    if not isinstance(listed, list):
        raise MapError(f"its {field} are no list", path=path, fix=kind.fix)
    return listed

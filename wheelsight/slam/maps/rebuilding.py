"""New maps from old ones: merging of two maps, pruning of redundant keyframes, and rebuilding of the surfels."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from wheelsight.core.errors import MapError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import IntArray, se3, so3
from wheelsight.core.keyframes import FrameSurface, KeyframeId, KeyframeStore
from wheelsight.core.settings import RecognitionSettings
from wheelsight.mapping import SurfelMap, SurfelSettings
from wheelsight.places.recognition import ViewMaker, known_grey
from wheelsight.places.verification import shown_share
from wheelsight.slam.drive_graph import SubmapGraph
from wheelsight.slam.graph import RelativePose, anchor
from wheelsight.slam.maps.contents import (
    MapAnnotations,
    MapParts,
    Progress,
    add_occupancy,
    are_there,
    current_edits,
    current_named_poses,
    new_numbers,
    pieces_of,
    recognizer_of,
    transferred,
    write_parts,
)
from wheelsight.slam.maps.folder import MapFolder, make_room, map_being_made
from wheelsight.slam.maps.journal import MERGE, PRUNE, REBUILD
from wheelsight.slam.place_recognition import PlaceWatcher
from wheelsight.vision.dense.alignment import Level, ReferenceMaker

# Pruning removes a keyframe if another one at most this far, metres and radians, shows this share of its surfaces. From
# another direction, keypoints differ. Chosen; the share is from docs/decisions/recognition-and-sessions.md.
_NEAR_M, _NEAR_RAD, _COVERED = 0.2, 0.25, 0.7
# Frames that a keyframe counts as when surfels are fused from keyframes alone: two keyframes make a surfel stable.
_REBUILD_FRAMES = 6
_FIX_EMPTY = "give a map of a drive that kept some"


@dataclass(frozen=True, slots=True, eq=False)
class MergedMap:
    """A map made of two.

    Attributes:
        keyframes: number of keyframes from the first and the second map.
        loops: number of loops between the maps that are kept, and of all loops that are refused.
        left_out: number of keyframes of both maps whose pose relative to the first map is unknown.
    """

    folder: MapFolder
    keyframes: tuple[int, int]
    loops: tuple[int, int]
    left_out: int


def merge(
    first: MapFolder,
    second: MapFolder,
    out: StrPath,
    *,
    recognition: RecognitionSettings | None = None,
    surfels: SurfelSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> MergedMap:
    """Write two maps as one into another folder, in the frame of the first map.

    Keyframes of the second map are recognized in the first. One graph of both maps is optimised, and the surfels are
    fused from all keyframes. The first map's keyframes come first; those of unknown pose are left out. Both input maps
    remain unchanged.

    Args:
        first, second: open maps of one camera.
        out: folder that is empty, missing, or left by an interrupted merge, rebuild or prune.
        on_keyframe: called with the current task, the number of finished keyframes, and their total.

    Raises MapError if the cameras differ, no keyframe of the second map is recognized in the first, or a keyframe
    cannot be read; then nothing is written. Raises OutputError if the folder cannot be written.
    """
    why = first.header.camera.why_other(second.header.camera)
    if why is not None:
        problem = f"is of another camera than {second.path}: {why}"
        raise MapError(problem, path=first.path, fix="give two maps of one camera")
    for folder in (first, second):
        if not any(True for _ in folder.store):
            raise MapError("has no keyframes", path=folder.path, fix=_FIX_EMPTY)
    make_room(out)
    of_first, of_second = MapParts.of(first), MapParts.of(second)
    both, count = of_first.beside(of_second), len(of_first)
    if count == len(first.store):
        known = first.recognizer(recognition, lambda done, total: on_keyframe("recognition", done, total))
    else:
        known = recognizer_of(of_first, recognition, on_keyframe)
    watcher = PlaceWatcher(both.store(first.settings.memory_keyframes), first.calibration, 0.0, recognition, known)
    pieces = pieces_of(of_first)
    pieces = np.concatenate([pieces, pieces_of(of_second) + pieces.max(initial=-1) + 1])
    graph, recognised = _joined_graph(both, count, pieces, watcher, on_keyframe)
    kept = np.flatnonzero(graph.submaps == 0)
    if kept.max() < count:
        problem = f"nothing of {second.path} is recognised in it"
        if recognised:
            of_all = f"{recognised} of {len(of_second)} keyframes of {second.path}"
            problem = f"cannot be joined: {of_all} are recognised in it, and no two agree on where that lies"
        raise MapError(problem, path=first.path, fix="give maps that show a place in common, from two views at least")
    # Edges between pieces are too uncertain to optimise by.
    between = [edge for edge in both.edges if pieces[edge.first] != pieces[edge.second]]
    parts = replace(both, T_map_keyframe=graph.poses, edges=(*graph.edges, *between)).some(kept)
    stamps_s = {KeyframeId(number): place.stamp_s for number, place in enumerate(parts.places)}
    store = parts.store(first.settings.memory_keyframes)
    surfel_map = _fused(store, stamps_s, first, surfels, lambda done, total: on_keyframe("fusing", done, total))
    # The second map's annotations all refer to keyframes, since its frame is dropped.
    mine, others = transferred(first, kept), transferred(second, kept, count, is_same_frame=False)
    annotations = MapAnnotations(mine.edits.beside(others.edits), mine.poses.beside(others.poses))
    if len(parts) < len(both):
        recognizer = recognizer_of(parts, recognition, on_keyframe)
    else:  # the first map's recognizer, since the numbers are unchanged
        recognizer = watcher.recognizer
        for done, number in enumerate(range(count, len(parts)), start=1):
            watcher.add(KeyframeId(number))
            on_keyframe("recognition", done, len(of_second))
    source = " and ".join(filter(None, (first.header.source, second.header.source)))
    with map_being_made(out, MERGE, first, source) as new:
        write_parts(parts, new, (recognizer, surfel_map, annotations), on_keyframe)
        add_occupancy(new, on_keyframe)
    from_first = int(np.count_nonzero(kept < count))
    across = sum((edge.first < count) != (edge.second < count) for edge in graph.edges)
    counts = (from_first, len(kept) - from_first), (across, len(graph.report().refused))
    return MergedMap(MapFolder.open(out, settings=first.settings), *counts, len(both) - len(kept))


def _joined_graph(
    both: MapParts, count: int, pieces: IntArray, watcher: PlaceWatcher, on_keyframe: Progress
) -> tuple[SubmapGraph, int]:
    """Return a graph of two maps, joined by loops, and the number of recognized keyframes of the second map.

    The prior of the first map's largest piece is permanent, the others last until loops join their pieces.

    Args:
        both: keyframes of both maps.
        count: number of keyframes of the first map.
        pieces: (N,) piece of each keyframe.
    """
    graph, recognised = SubmapGraph(), 0
    for T_map_keyframe, piece in zip(both.T_map_keyframe, pieces.tolist(), strict=True):
        graph.add_pose(T_map_keyframe, piece)
    for piece, number in zip(*np.unique(pieces, return_index=True), strict=True):
        prior = anchor(KeyframeId(int(number)), both.T_map_keyframe[number])
        graph.add_prior(prior, until_joined=bool(piece))
    graph.add_edges([edge for edge in both.edges if pieces[edge.first] == pieces[edge.second]])
    for done, number in enumerate(range(count, len(both)), start=1):
        found = watcher.recognised(KeyframeId(number))
        if found:
            recognised += 1
            graph.offer(found)
        on_keyframe("recognising", done, len(both) - count)
    graph.review()
    return graph, recognised


@dataclass(frozen=True, slots=True, eq=False)
class PrunedMap:
    """A map without redundant keyframes.

    Attributes:
        left_out: number of removed keyframes.
    """

    folder: MapFolder
    left_out: int


def prune(
    folder: MapFolder,
    out: StrPath,
    recognition: RecognitionSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> PrunedMap:
    """Write a map into another folder without keyframes whose view another one shows.

    The remaining keyframes get new numbers and keep their poses. Edges of a removed keyframe move to a neighbour, see
    `without`. Its surfels move to the keyframe that shows the same view.

    Args:
        out: folder that is empty, missing, or left by an interrupted merge, rebuild or prune.
        on_keyframe: called with the current task, the number of finished keyframes, and their total.

    Raises MapError if there are no keyframes, or one cannot be read, and OutputError if the folder cannot be written.
    """
    make_room(out)
    parts = MapParts.of(folder)
    if not len(parts):
        raise MapError("has no keyframes", path=folder.path, fix=_FIX_EMPTY)
    # The keyframe that covers each one: itself, or an earlier one of the same piece that is kept.
    views, store = ViewMaker(folder.calibration), parts.store(1)
    pieces, noise = pieces_of(parts), folder.calibration.depth_noise
    T, numbers, shown_by = parts.T_map_keyframe, np.arange(len(parts)), np.arange(len(parts))
    levels: list[Level] = []
    nearby = cKDTree(T[:, :3, 3]).query_ball_point(T[:, :3, 3], _NEAR_M, return_sorted=True)
    for number in range(len(parts)):
        levels.append(views.of_keyframe(store[KeyframeId(number)]).grid.levels[-1])
        earlier = [k for k in nearby[number] if k < number and shown_by[k] == k and pieces[k] == pieces[number]]
        found = 0.0
        for other in earlier:
            T_other_this = se3.invert(T[other]) @ T[number]
            if so3.angle(T_other_this[:3, :3]) > _NEAR_RAD:
                continue
            share = shown_share(levels[number], levels[other], T_other_this, noise)
            if share >= _COVERED and share > found:
                found, shown_by[number] = share, other
        on_keyframe("comparing", number + 1, len(parts))
    kept = np.flatnonzero(shown_by == numbers)
    edges = without(parts.edges, np.flatnonzero(shown_by != numbers).tolist())
    left = replace(parts, edges=edges).some(kept)
    recognizer = recognizer_of(left, recognition, on_keyframe)
    old, surfel_map = folder.surfels(), None
    if old is not None:
        # By the folder's keyframe numbers; surfels of a keyframe lost to damage are attached to none.
        of_parts, surfels = np.full(len(folder.store) + 1, -1), old.surfels()
        of_parts[np.flatnonzero(are_there(folder))] = new_numbers(kept, len(parts))[shown_by]
        surfel_map = SurfelMap(old.settings)
        surfel_map.add(replace(surfels, keyframe=of_parts[surfels.keyframe].astype(np.int32)), old.stamp_s)
        surfel_map.restore(old.dropped, left.T_map_keyframe)
    made = recognizer, surfel_map, transferred(folder, kept)
    with map_being_made(out, PRUNE, folder) as new:
        write_parts(left, new, made, on_keyframe)
        add_occupancy(new, on_keyframe)
    return PrunedMap(MapFolder.open(out, settings=folder.settings), len(parts) - len(left))


def rebuild(
    folder: MapFolder,
    out: StrPath,
    surfels: SurfelSettings | None = None,
    recognition: RecognitionSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> MapFolder:
    """Write a map into another folder from its keyframes at their current poses, with surfels fused from them.

    Withdrawn edges, outdated poses and lost keyframes are left out.

    Args:
        out: folder that is empty, missing, or left by an interrupted merge, rebuild or prune.
        on_keyframe: called with the current task, the number of finished keyframes, and their total.

    Returns the new map, open to read.

    Raises MapError if there are no keyframes, or one cannot be read, and OutputError if the folder cannot be written.
    """
    make_room(out)
    annotations = MapAnnotations(current_edits(folder), current_named_poses(folder))
    surfel_map = fuse_keyframes(folder, surfels, lambda done, total: on_keyframe("fusing", done, total))
    with map_being_made(out, REBUILD, folder) as new:
        numbers = list(folder.store)
        for done, number in enumerate(numbers, start=1):
            place = folder.contents.places[number]
            new.append_keyframe(number, folder.store[number], folder.store.pose(number), place.T_odom_keyframe)
            on_keyframe("writing", done, len(numbers))
        new.append_edges(folder.edges)
        found = folder.recognizer(recognition, lambda done, total: on_keyframe("recognition", done, total))
        new.save_recognition(found)
        new.save_surfels(surfel_map)
        annotations.save(new)
        add_occupancy(new, on_keyframe)
    return MapFolder.open(out, settings=folder.settings)


def fuse_keyframes(
    folder: MapFolder,
    settings: SurfelSettings | None = None,
    on_keyframe: Callable[[int, int], None] = lambda done, total: None,
) -> SurfelMap:
    """Return surfels fused from all keyframes in order of their stamps, grey, since keyframes have no colour.

    Args:
        on_keyframe: called with the number of finished keyframes and their total.

    Raises MapError if there are no keyframes, or one cannot be read.
    """
    places = folder.contents.places
    stamps_s = {number: places[number].stamp_s for number in folder.store}
    return _fused(folder.store, stamps_s, folder, settings, on_keyframe)


def _fused(
    store: KeyframeStore,
    stamps_s: Mapping[KeyframeId, float],
    like: MapFolder,
    settings: SurfelSettings | None,
    on_keyframe: Callable[[int, int], None],
) -> SurfelMap:
    """Return surfels fused from the keyframes that have a stamp, in order of stamps."""
    noise, numbers = like.calibration.depth_noise, sorted(stamps_s, key=lambda number: stamps_s[number])
    if not numbers:
        raise MapError("has no keyframes", path=like.path, fix=_FIX_EMPTY)
    surfel_map = SurfelMap(settings, store, keeps_unstable=True)
    maker = ReferenceMaker(noise)
    for done, number in enumerate(numbers, start=1):
        keyframe = store[number]
        how = (keyframe.stamp_s, noise, _REBUILD_FRAMES, number)
        level = Level(keyframe.intrinsics, keyframe.depth_m, known_grey(keyframe))
        surface = FrameSurface(level.depth_m, maker.normals(level), level.grey)
        surfel_map.fuse(surface, keyframe.intrinsics, store.pose(number), *how)
        on_keyframe(done, len(numbers))
    return surfel_map


def without(edges: Sequence[RelativePose], left_out: Iterable[int]) -> tuple[RelativePose, ...]:
    """Return the edges of a graph without some keyframes, with the same connectivity.

    The edges of a removed keyframe move to the neighbour at its most certain edge, odometry before loops. Motions and
    covariances are composed; a composition with a loop is a loop. Two keyframes keep at most one composed edge, the
    most certain, and none if a measured edge is more certain. Edges composed with the same edge share its error, so
    several would count it repeatedly.
    """
    graph = _EdgeTable(edges)
    for number in left_out:
        graph.contract(number)
    return graph.all()


class _EdgeTable:
    def __init__(self, edges: Sequence[RelativePose]) -> None:
        self._edges: dict[int, RelativePose] = dict(enumerate(edges))
        self._count, self._measured = len(edges), len(edges)
        self._of: defaultdict[int, set[int]] = defaultdict(set)
        for key, edge in self._edges.items():
            self._of[edge.first].add(key)
            self._of[edge.second].add(key)

    def all(self) -> tuple[RelativePose, ...]:
        """Return the edges in the order in which they were added."""
        return tuple(self._edges[key] for key in sorted(self._edges))

    def contract(self, number: int) -> None:
        """Move the edges of a keyframe to a neighbour."""
        of_it = [self._taken(key) for key in sorted(self._of[number])]
        if not of_it:
            return
        surest = min(of_it, key=lambda edge: (edge.is_loop, _volume(edge)))
        by = surest if surest.second == number else inverse(surest)
        for edge in of_it:
            onward = edge if edge.first == number else inverse(edge)
            if edge is surest or onward.second == by.first:
                continue
            # Add the composed edge, unless a more certain one connects the same keyframes.
            new = composed(by, onward)
            beside = sorted(self._of[new.first] & self._of[new.second])
            if any(_volume(self._edges[key]) <= _volume(new) for key in beside):
                continue
            for key in beside:
                if key >= self._measured:
                    self._taken(key)
            self._edges[self._count] = new
            for end in (new.first, new.second):
                self._of[end].add(self._count)
            self._count += 1

    def _taken(self, key: int) -> RelativePose:
        edge = self._edges.pop(key)
        for end in (edge.first, edge.second):
            self._of[end].discard(key)
        return edge


def composed(first: RelativePose, second: RelativePose) -> RelativePose:
    """Return the edge from the first edge's first keyframe to the second edge's second one."""
    T, Ad = first.T_first_second, se3.adjoint(first.T_first_second)
    C = first.covariance + Ad @ second.covariance @ Ad.T
    T_both, is_loop = se3.nearest(T @ second.T_first_second), first.is_loop or second.is_loop
    return RelativePose(first.first, second.second, T_both, (C + C.T) / 2, is_loop)


def inverse(edge: RelativePose) -> RelativePose:
    """Return the edge in the opposite direction."""
    T_second_first = se3.invert(edge.T_first_second)
    Ad = se3.adjoint(T_second_first)
    C = Ad @ edge.covariance @ Ad.T
    first, second = KeyframeId(edge.second), KeyframeId(edge.first)
    return RelativePose(first, second, T_second_first, (C + C.T) / 2, edge.is_loop)


def _volume(edge: RelativePose) -> float:
    """Return the log-determinant of the covariance: an uncertainty that needs no weighting of metres and radians."""
    return float(np.linalg.slogdet(edge.covariance)[1])

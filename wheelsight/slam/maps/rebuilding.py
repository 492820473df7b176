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
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore, Surface
from wheelsight.core.settings import PlaceVerificationSettings, RecognitionSettings
from wheelsight.core.threads import Rows
from wheelsight.mapping import SurfelMap, SurfelSettings
from wheelsight.places.recognition import Recognizer, ViewMaker, known_grey
from wheelsight.places.verification import shown_share
from wheelsight.slam.drive_graph import PieceGraph
from wheelsight.slam.graph import RelativePose, anchor
from wheelsight.slam.maps.contents import (
    MapParts,
    Progress,
    SaidOfMap,
    add_occupancy,
    are_there,
    carried,
    edits_as_known,
    names_as_known,
    new_numbers,
    pieces_of,
    recognizer_of,
    write_parts,
)
from wheelsight.slam.maps.folder import MapFolder, make_room, map_being_made
from wheelsight.slam.maps.journal import MERGE, PRUNE, REBUILD
from wheelsight.slam.place_recognition import PlaceWatcher
from wheelsight.slam.settings import LoopSettings
from wheelsight.vision.dense.pyramid import Level, ReferenceMaker
from wheelsight.vision.dense.settings import DenseSettings

# Two maps made one: keyframes of the second are recognised in the first, and a graph of both says where all are.


_FIX = "give maps that show a place in common, from two views at least"


@dataclass(frozen=True, slots=True, eq=False)
class MergedMap:
    """A map that was made of two.

    Attributes:
        folder: the new map, open to read.
        keyframes: how many are of the first map, and of the second.
        loops: that join them, and how many others were refused.
        left_out: keyframes of both of which nobody knows how they lie to the first map's.
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
    loops: LoopSettings | None = None,
    recognition: RecognitionSettings | None = None,
    surfels: SurfelSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> MergedMap:
    """Write two maps as one into another folder: in the frame of the first, solved together, surfels fused anew.

    The first map's keyframes come before the second's; those that lie nowhere are left out. Both maps stay as they are.

    Args:
        first, second: open maps of one camera.
        out: a folder that is empty or not there, or that a merge, rebuild or prune left when it was ended.
        loops, recognition, surfels: or the defaults.
        on_keyframe: called with what is being done, how many keyframes are done, and of how many.

    Raises:
        MapError: the cameras differ, nothing of the second is recognised in the first, or a keyframe cannot be read;
            then nothing is written.
        OutputError: it cannot be written.
    """
    _refuse_unlike(first, second)
    make_room(out)
    pair, settings = _Pair(MapParts.of(first), MapParts.of(second)), loops or LoopSettings()
    watcher = _watcher(first, pair, settings, recognition, on_keyframe)
    graph = _begun(pair, first, settings)
    _recognise(pair, watcher, graph, on_keyframe)
    kept = np.flatnonzero(graph.pieces == 0)
    if kept.max() < len(pair.first):
        raise _unjoined(first, second, pair)
    parts = replace(pair.both, T_map_keyframe=graph.poses, edges=(*graph.edges, *_between(pair, first))).some(kept)
    surfel_map = fused_of(parts, first, surfels, lambda done, total: on_keyframe("fusing", done, total))
    source = " and ".join(filter(None, (first.header.source, second.header.source)))
    made = _knows_all(parts, pair, watcher, recognition, on_keyframe), surfel_map, _said(first, second, kept, pair)
    with map_being_made(out, MERGE, first, source) as new:
        write_parts(parts, new, made, on_keyframe)
        add_occupancy(new, on_keyframe)
    return _told(MapFolder.open(out, settings=first.settings), pair, kept, graph)


def _said(first: MapFolder, second: MapFolder, kept: IntArray, pair: _Pair) -> SaidOfMap:
    """Of both maps; the second's all hang on keyframes, whose frame goes."""
    of_first, of_second = carried(first, kept), carried(second, kept, len(pair.first), is_same_frame=False)
    return SaidOfMap(of_first.edits.beside(of_second.edits), of_first.poses.beside(of_second.poses))


def _told(folder: MapFolder, pair: _Pair, kept: IntArray, graph: PieceGraph) -> MergedMap:
    of_first = int(np.count_nonzero(kept < len(pair.first)))
    across = sum(pair.is_across(edge) for edge in graph.edges)
    counts = (of_first, len(kept) - of_first), (across, len(graph.report().refused))
    return MergedMap(folder, *counts, len(pair.both) - len(kept))


class _Pair:
    """Both maps, each by itself and together, under the numbers that they have together."""

    def __init__(self, first: MapParts, second: MapParts) -> None:
        self.first, self.second, self.both = first, second, first.beside(second)
        self.found: list[int] = []  # keyframes of the second that were recognised

    def is_across(self, edge: RelativePose) -> bool:
        """Whether an edge goes from one map to the other."""
        return (edge.first < len(self.first)) != (edge.second < len(self.first))

    def pieces(self, folder: MapFolder) -> IntArray:
        """(N,) of both; those of the second map have higher numbers."""
        of_first, of_second = (pieces_of(parts, folder.settings) for parts in (self.first, self.second))
        return np.concatenate([of_first, of_second + of_first.max(initial=-1) + 1])


def _watcher(
    first: MapFolder, pair: _Pair, loops: LoopSettings, recognition: RecognitionSettings | None, on_keyframe: Progress
) -> PlaceWatcher:
    """It knows the first map's keyframes."""
    if len(pair.first) == len(first.store):
        known = first.recognizer(recognition, lambda done, total: on_keyframe("recognition", done, total))
    else:
        known = recognizer_of(pair.first, recognition, on_keyframe)
    store = pair.both.store(first.settings.memory_keyframes)
    return PlaceWatcher(store, first.calibration, loops.seen, recognition, known)


def _begun(pair: _Pair, first: MapFolder, settings: LoopSettings) -> PieceGraph:
    """Both maps in one graph, each piece held at its first keyframe; the first map's largest one for good."""
    graph, pieces = PieceGraph(settings), pair.pieces(first)
    for T_map_keyframe, piece in zip(pair.both.T_map_keyframe, pieces.tolist(), strict=True):
        graph.add(T_map_keyframe, piece)
    for piece, number in zip(*np.unique(pieces, return_index=True), strict=True):
        held = anchor(KeyframeId(int(number)), pair.both.T_map_keyframe[number])
        graph.hold(held, until_joined=bool(piece))
    graph.add_edges([edge for edge in pair.both.edges if pieces[edge.first] == pieces[edge.second]])
    return graph


def _between(pair: _Pair, first: MapFolder) -> Sequence[RelativePose]:
    """Edges between pieces, which are too vague to solve by."""
    pieces = pair.pieces(first)
    return [edge for edge in pair.both.edges if pieces[edge.first] != pieces[edge.second]]


def _recognise(pair: _Pair, watcher: PlaceWatcher, graph: PieceGraph, on_keyframe: Progress) -> None:
    """Look for each keyframe of the second map in the first, and judge all that is found."""
    for done, number in enumerate(range(len(pair.first), len(pair.both)), start=1):
        found = watcher.recognised(KeyframeId(number))
        if found:
            pair.found.append(number)
            graph.close(found)
        on_keyframe("recognising", done, len(pair.second))
    graph.review()


def _knows_all(
    parts: MapParts,
    pair: _Pair,
    watcher: PlaceWatcher,
    recognition: RecognitionSettings | None,
    on_keyframe: Progress,
) -> Recognizer:
    """What recognises the new map's keyframes; that of the first goes on where numbers are as they were."""
    if len(parts) < len(pair.both):
        return recognizer_of(parts, recognition, on_keyframe)
    for done, number in enumerate(range(len(pair.first), len(parts)), start=1):
        watcher.pass_by(KeyframeId(number))
        on_keyframe("recognition", done, len(pair.second))
    return watcher.recognizer


def _refuse_unlike(first: MapFolder, second: MapFolder) -> None:
    """Raises MapError for two cameras, and for a map without keyframes."""
    why = first.header.camera.why_other(second.header.camera, first.settings.camera_share)
    if why is not None:
        problem = f"is of another camera than {second.path}: {why}"
        raise MapError(problem, path=first.path, fix="give two maps of one camera")
    for folder in (first, second):
        if not any(True for _ in folder.store):
            raise MapError("has no keyframes", path=folder.path, fix="give a map of a drive that kept some")


def _unjoined(first: MapFolder, second: MapFolder, pair: _Pair) -> MapError:
    of_all = f"{len(pair.found)} of {len(pair.second)} keyframes of {second.path}"
    problem = f"cannot be joined: {of_all} are recognised in it, and no two agree on where that lies"
    if not pair.found:
        problem = f"nothing of {second.path} is recognised in it"
    return MapError(problem, path=first.path, fix=_FIX)


# A map without the keyframes that show nothing which others do not show, so that it does not grow day by day.


@dataclass(frozen=True, slots=True, eq=False)
class PrunedMap:
    """A map without some of its keyframes.

    Attributes:
        folder: the new map, open to read.
        left_out: how many keyframes it does not have.
    """

    folder: MapFolder
    left_out: int


def prune(
    folder: MapFolder,
    out: StrPath,
    recognition: RecognitionSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> PrunedMap:
    """Write a map into another folder without keyframes whose view another one shows; see `PruneSettings`.

    Those that stay are numbered anew and stay where they are. Edges of one that is left out are carried over to a
    neighbour, see `slam.contraction`; surfels that hung on it hang on the one that shows what it showed.

    Args:
        folder: an open map; it stays as it is.
        out: a folder that is empty or not there, or that a merge, rebuild or prune left when it was ended.
        recognition: or the defaults.
        on_keyframe: called with what is being done, how many keyframes are done, and of how many.

    Raises:
        MapError: there are no keyframes, or one cannot be read.
        OutputError: it cannot be written.
    """
    make_room(out)
    parts = MapParts.of(folder)
    if not len(parts):
        raise MapError("has no keyframes", path=folder.path, fix="give a map of a drive that kept some")
    shown_by = _shown_by(parts, folder, lambda done, total: on_keyframe("comparing", done, total))
    numbers = np.arange(len(parts))
    kept = np.flatnonzero(shown_by == numbers)
    edges = without(parts.edges, np.flatnonzero(shown_by != numbers).tolist())
    left = replace(parts, edges=edges).some(kept)
    recognizer = recognizer_of(left, recognition, on_keyframe)
    hangs_on = new_numbers(kept, len(parts))[shown_by]
    made = recognizer, _rehung(folder, left, hangs_on), carried(folder, kept)
    with map_being_made(out, PRUNE, folder) as new:
        write_parts(left, new, made, on_keyframe)
        add_occupancy(new, on_keyframe)
    return PrunedMap(MapFolder.open(out, settings=folder.settings), len(parts) - len(left))


def _shown_by(parts: MapParts, folder: MapFolder, on_keyframe: Callable[[int, int], None]) -> IntArray:
    """(N,) the keyframe that shows what each shows: itself, or an earlier one of the same piece that stays."""
    views, store, settings = ViewMaker(folder.calibration), parts.store(1), folder.settings.prune
    pieces, noise, free = pieces_of(parts, folder.settings), folder.calibration.depth_noise, PlaceVerificationSettings()
    T, shown_by = parts.T_map_keyframe, np.arange(len(parts))
    levels: list[Level] = []
    nearby = cKDTree(T[:, :3, 3]).query_ball_point(T[:, :3, 3], settings.near_m, return_sorted=True)
    for number in range(len(parts)):
        levels.append(views.of_keyframe(store[KeyframeId(number)]).grid.levels[-1])
        earlier = [k for k in nearby[number] if k < number and shown_by[k] == k and pieces[k] == pieces[number]]
        found = 0.0
        for other in earlier:
            T_other_this = se3.invert(T[other]) @ T[number]
            if so3.angle(T_other_this[:3, :3]) > settings.near_rad:
                continue
            share = shown_share(levels[number], levels[other], T_other_this, noise, free)
            if share >= settings.covered and share > found:
                found, shown_by[number] = share, other
        on_keyframe(number + 1, len(parts))
    return shown_by


def _rehung(folder: MapFolder, left: MapParts, hangs_on: IntArray) -> SurfelMap | None:
    """The map's surfels where they are, on keyframes (N,) of the new one; None where it has none."""
    old = folder.surfels()
    if old is None:
        return None
    surfels = old.surfels()
    # Of keyframes with numbers as the folder has them; of one that damage took surfels hang on nothing.
    of_parts = np.full(len(folder.store) + 1, -1)
    of_parts[np.flatnonzero(are_there(folder))] = hangs_on
    new = SurfelMap(old.settings)
    new.add(replace(surfels, keyframe=of_parts[surfels.keyframe].astype(np.int32)), old.stamp_s)
    new.restore(old.dropped, left.T_map_keyframe)
    return new


# A map made anew of its keyframes, where they are by now: its surfels fused, its journals without what is outdated.


# Between two keyframes that show a surface many seconds may pass: none of it is forgotten.
_KEPT_S = 1e6


def rebuild(
    folder: MapFolder,
    out: StrPath,
    surfels: SurfelSettings | None = None,
    recognition: RecognitionSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> MapFolder:
    """Write a map anew into another folder: keyframes where they are by now, edges that hold, and what is made of them.

    Args:
        folder: an open map; it stays as it is.
        out: a folder that is empty or not there, or that a merge, rebuild or prune left when it was ended.
        surfels, recognition: or the defaults.
        on_keyframe: called with what is being done, how many keyframes are done, and of how many.

    Returns the new map, open to read.

    Raises:
        MapError: there are no keyframes, or one cannot be read.
        OutputError: it cannot be written.
    """
    make_room(out)
    said = SaidOfMap(edits_as_known(folder), names_as_known(folder))
    surfel_map = fused_anew(folder, surfels, lambda done, total: on_keyframe("fusing", done, total))
    with map_being_made(out, REBUILD, folder) as new:
        _copy_keyframes(folder, new, lambda done, total: on_keyframe("writing", done, total))
        new.append_edges(folder.edges)
        found = folder.recognizer(recognition, lambda done, total: on_keyframe("recognition", done, total))
        new.save_recognition(found)
        new.save_surfels(surfel_map)
        said.save(new)
        add_occupancy(new, on_keyframe)
    return MapFolder.open(out, settings=folder.settings)


def _copy_keyframes(folder: MapFolder, new: MapFolder, on_keyframe: Callable[[int, int], None]) -> None:
    numbers = list(folder.store)
    for done, number in enumerate(numbers, start=1):
        place = folder.contents.places[number]
        new.append_keyframe(number, folder.store[number], folder.store.pose(number), place.T_odom_keyframe)
        on_keyframe(done, len(numbers))


def fused_anew(
    folder: MapFolder,
    settings: SurfelSettings | None = None,
    on_keyframe: Callable[[int, int], None] = lambda done, total: None,
) -> SurfelMap:
    """Surfels of all keyframes, in the order of their stamps; grey, since keyframes keep no colour.

    Args:
        folder: an open map.
        settings: of surfels, or the defaults.
        on_keyframe: called with how many are done, and of how many.

    Raises:
        MapError: there are no keyframes, or one cannot be read.
    """
    places = folder.contents.places
    stamps_s = {number: places[number].stamp_s for number in folder.store}
    return _fused(folder.store, stamps_s, folder, settings, on_keyframe)


def fused_of(
    parts: MapParts, like: MapFolder, settings: SurfelSettings | None, on_keyframe: Callable[[int, int], None]
) -> SurfelMap:
    """Likewise of parts, of the camera and by the settings of a map. Raises MapError."""
    stamps_s = {KeyframeId(number): place.stamp_s for number, place in enumerate(parts.places)}
    return _fused(parts.store(like.settings.memory_keyframes), stamps_s, like, settings, on_keyframe)


def _fused(
    store: KeyframeStore,
    stamps_s: Mapping[KeyframeId, float],
    like: MapFolder,
    settings: SurfelSettings | None,
    on_keyframe: Callable[[int, int], None],
) -> SurfelMap:
    """Of the keyframes that have a stamp, in the order of that."""
    noise, numbers = like.calibration.depth_noise, sorted(stamps_s, key=lambda number: stamps_s[number])
    if not numbers:
        raise MapError("has no keyframes", path=like.path, fix="give a map of a drive that kept some")
    kept = {"unstable_s": _KEPT_S, "unseen_s": _KEPT_S}
    surfel_map, dense = SurfelMap((settings or SurfelSettings()).model_copy(update=kept), store), DenseSettings()
    maker = ReferenceMaker(noise, dense, Rows(dense.threads))
    for done, number in enumerate(numbers, start=1):
        keyframe = store[number]
        how = (keyframe.stamp_s, noise, like.settings.rebuild_frames, number)
        surfel_map.fuse(_surface(keyframe, maker), keyframe.intrinsics, store.pose(number), *how)
        on_keyframe(done, len(numbers))
    return surfel_map


def _surface(keyframe: Keyframe, maker: ReferenceMaker) -> Surface:
    level = Level(keyframe.intrinsics, keyframe.depth_m, known_grey(keyframe))
    return Surface(level.depth_m, maker.normals(level), level.grey)


# Graphs without some of their keyframes: what edges said across one that is left out, they say between others.


def without(edges: Sequence[RelativePose], left_out: Iterable[int]) -> tuple[RelativePose, ...]:
    """Edges of a graph without some keyframes, hanging together as before.

    All edges of a keyframe that is left out are carried over to one neighbour: that at the end of its surest edge, of
    odometry before a loop. Motions and covariances are composed, and what is composed of a loop is a loop. Between two
    keyframes at most one such edge is kept, the surest, and none where a measured one is surer: those that were carried
    over by one edge share its error, and several would count it as often.
    """
    graph = _Edges(edges)
    for number in left_out:
        graph.contract(number)
    return graph.all()


class _Edges:
    def __init__(self, edges: Sequence[RelativePose]) -> None:
        self._edges: dict[int, RelativePose] = dict(enumerate(edges))
        self._count, self._measured = len(edges), len(edges)
        self._of: defaultdict[int, set[int]] = defaultdict(set)
        for key, edge in self._edges.items():
            self._of[edge.first].add(key)
            self._of[edge.second].add(key)

    def all(self) -> tuple[RelativePose, ...]:
        """In the order in which they came."""
        return tuple(self._edges[key] for key in sorted(self._edges))

    def contract(self, number: int) -> None:
        """Carry the edges of a keyframe over to a neighbour."""
        of_it = [self._taken(key) for key in sorted(self._of[number])]
        if not of_it:
            return
        surest = min(of_it, key=lambda edge: (edge.is_loop, _volume(edge)))
        by = surest if surest.second == number else inverse(surest)
        for edge in of_it:
            onward = edge if edge.first == number else inverse(edge)
            if edge is not surest and onward.second != by.first:
                self._carry(composed(by, onward))

    def _carry(self, new: RelativePose) -> None:
        """Keep a composed edge, unless a surer one says how its ends lie to each other."""
        beside = sorted(self._of[new.first] & self._of[new.second])
        if any(_volume(self._edges[key]) <= _volume(new) for key in beside):
            return
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
    """From the one's first keyframe to the other's second, by the one between."""
    T, Ad = first.T_first_second, se3.adjoint(first.T_first_second)
    C = first.covariance + Ad @ second.covariance @ Ad.T
    T_both, is_loop = se3.nearest(T @ second.T_first_second), first.is_loop or second.is_loop
    return RelativePose(first.first, second.second, T_both, (C + C.T) / 2, is_loop)


def inverse(edge: RelativePose) -> RelativePose:
    """The same, seen from the other end."""
    T_second_first = se3.invert(edge.T_first_second)
    Ad = se3.adjoint(T_second_first)
    C = Ad @ edge.covariance @ Ad.T
    first, second = KeyframeId(edge.second), KeyframeId(edge.first)
    return RelativePose(first, second, T_second_first, (C + C.T) / 2, edge.is_loop)


def _volume(edge: RelativePose) -> float:
    """How unsure an edge is: the log of its covariance's volume, in which metres and radians need no exchange rate."""
    return float(np.linalg.slogdet(edge.covariance)[1])

"""Two maps made one: keyframes of the second are recognised in the first, and a graph of both says where all are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from wheelsight.errors import MapError
from wheelsight.files import StrPath
from wheelsight.geometry import IntArray
from wheelsight.keyframes import KeyframeId
from wheelsight.mapping import SurfelSettings
from wheelsight.places.recognition import Recognizer
from wheelsight.settings import RecognitionSettings
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.piece_graph import PieceGraph
from wheelsight.slam.recognised import PlaceWatcher
from wheelsight.slam.sessions.hanging import pieces_of
from wheelsight.slam.sessions.header import MERGE
from wheelsight.slam.sessions.map_folder import MapFolder, make_room, map_being_made
from wheelsight.slam.sessions.occupancy import add_occupancy
from wheelsight.slam.sessions.parts import MapParts, Progress, SaidOfMap, carried, recognizer_of, write_parts
from wheelsight.slam.sessions.rebuilding import fused_of
from wheelsight.slam.settings import LoopSettings
from wheelsight.slam.steps import anchor

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

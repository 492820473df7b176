"""How the keyframes of a map hang together: in one piece, or in some of which nobody knows how they lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.geometry import BoolArray, FloatArray, IntArray
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.sessions.map_folder import MapFolder
from wheelsight.slam.sessions.parts import MapParts, are_there
from wheelsight.slam.sessions.settings import SessionSettings


def lie_together(folder: MapFolder) -> BoolArray:
    """(N,) which keyframes of a map hang together by edges that are sure: the largest such piece."""
    there = are_there(folder)
    together = np.zeros(len(there), bool)
    together[there] = pieces_of(MapParts.of(folder), folder.settings) == 0
    return together


def pieces_of(parts: MapParts, settings: SessionSettings) -> IntArray:
    """(N,) the piece that each keyframe is in, by edges that are sure; the largest piece is 0."""
    piece = connected([edge for edge in parts.edges if is_sure(edge, settings)], len(parts))
    order = np.argsort(-np.bincount(piece, minlength=1), kind="stable")
    return np.asarray(np.argsort(order)[piece], np.int64)


def connected(edges: Sequence[RelativePose], count: int) -> IntArray:
    """(count,) the piece that each keyframe is in, from 0 on, by edges between them."""
    if not count:
        return np.zeros(0, np.int64)
    ends = np.array([(edge.first, edge.second) for edge in edges], np.int64).reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def is_sure(edge: RelativePose, settings: SessionSettings) -> bool:
    """Whether an edge tells how its ends lie to each other; that of a camera that was carried off does not."""
    sigmas: FloatArray = np.sqrt(np.diag(edge.covariance))
    return bool((sigmas[:3] < settings.sure_m).all() and (sigmas[3:] < settings.sure_rad).all())

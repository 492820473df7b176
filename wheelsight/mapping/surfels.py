"""`SurfelMap` fuses RGB-D frames into surfels and predicts views from them.

`MapBuilder` chooses the tracked frames that it fuses. Surfels are those of Keller et al. 2013; the active time
window is that of Whelan et al. 2015 and 2016.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.checks import why_not_metres
from wheelsight.core.errors import MapError
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, Int32Array, se3
from wheelsight.core.keyframes import FrameSurface, KeyframeId, KeyframeStore, PredictedView
from wheelsight.core.settings import ASKED, CHOSEN, ON_SIMULATOR, Settings, setting
from wheelsight.mapping import fusion_kernels as fusion
from wheelsight.mapping import view_kernels as view
from wheelsight.mapping.block_kernels import CONFIDENCE, PAGE, RADIUS, InView, SurfelArrays
from wheelsight.mapping.blocks import LEAST_ROOM, Blocks, SurfelPaging
from wheelsight.mapping.fusion_kernels import (
    READING,
    Camera,
    Candidates,
    FrameReadings,
    FusionRules,
    choose,
    find_candidates,
    find_new,
)

if TYPE_CHECKING:
    from wheelsight.core.calibration import Calibration
    from wheelsight.core.messages import RgbdFrame
    from wheelsight.vision.dense import DenseEstimate, DenseOdometry

_COPIED_AT_ONCE = 1 << 16  # 5 MB
# Time after its first observation, and without observation, at which an unstable surfel is removed. Chosen.
_UNSTABLE_S, _UNSEEN_S = 3.0, 1.0
_KEPT_S = 1e6  # likewise if none expires: many seconds may pass between two keyframes of one surface
# Duplicates are merged in one fused frame in this many: those of a few frames can be merged at once. Chosen.
_MERGED_EVERY = 3
_BLOCK_M = 0.5  # edge of the blocks that index surfels in view; chosen
# Surfels are added up to far_m plus this many standard deviations of depth: there, readings that err towards the camera
# add surfels, and others correct them before they are predicted. Simulator: docs/decisions/dense-alignment.md.
_ADDED_SIGMAS = 12.0
# Standard deviation of a reading's weight over its distance from the image centre, 1 at the farthest corner: Keller et
# al. 2013, 4.2.
_RADIAL_SIGMA = 0.6
# Unstable surfels with a larger standard deviation are not predicted: the depth errors of a far wall are correlated.
# Simulator: docs/decisions/dense-alignment.md.
_VAGUE_M = 0.035
# Disks in a view. Chosen: limits of their radius (below the least, disks that were seen from nearer leave gaps; above
# the largest, drawing takes long), the least cosine of the viewing angle, and the distance of disks of one surface, per
# metre of depth and at any depth, metres.
_SMALLEST_PX, _LARGEST_PX, _SHOWN_COSINE, _BLEND, _BLEND_M = 0.75, 24.0, 0.05, 0.012, 0.006


class SurfelSettings(Settings):
    """Settings of the surfel map; unknown names are rejected."""

    stable_confidence: float = setting(10.0, "number of frames that make a surfel stable", CHOSEN, gt=0, le=1e6)
    active_s: float = setting(
        60.0, "surfels not seen for longer are kept, but not used in tracking", CHOSEN, gt=0, le=1e9
    )
    fused_way_m: float = setting(
        0.04,
        "frames nearer to the last fused one are skipped; a turn by a radian counts as 1.5 m",
        CHOSEN,
        ge=0,
        le=100,
    )
    fused_after_s: float = setting(
        0.1, "time after the last fused frame at which a frame is always fused", CHOSEN, gt=0, le=3600
    )
    far_m: float = setting(
        6.0,
        "largest distance of predicted surfels; some are added farther, by the depth noise",
        f"{ON_SIMULATOR}: docs/decisions/dense-alignment.md",
        gt=0,
        le=40,
    )
    max_surfels: int = setting(
        3_000_000,
        "largest number of surfels in memory, about 72 bytes each; others are on disk",
        "estimated",
        ge=1024,
        le=6_000_000,
    )
    resting_folder: str | None = setting(
        None, "folder of surfels on disk; none for the system's folder of temporary files", ASKED
    )


class SurfelMap:
    """Surfels in the map frame: fuses frames with poses, and predicts views. A `ReferenceModel` for tracking.

    Each surfel is attached to the keyframe that was current when it was created. With a store, surfels move with their
    keyframes: the map applies their motion before fusing, predicting and reading. When memory is short, surfels of
    distant keyframes are on disk until the camera comes near.

    Not thread-safe.

    Args:
        store: store of the keyframes; without one, surfels do not move.
        keeps_unstable: whether unstable surfels never expire, as when keyframes alone are fused.

    Attributes:
        blocks: storage of the surfels; only the map changes it.
    """

    def __init__(
        self,
        settings: SurfelSettings | None = None,
        store: KeyframeStore | None = None,
        *,
        keeps_unstable: bool = False,
    ) -> None:
        self.settings = settings or SurfelSettings()
        self._lifetime_s = (_KEPT_S, _KEPT_S) if keeps_unstable else (_UNSTABLE_S, _UNSEEN_S)
        self._store, self._follower = store, None if store is None else store.follow()
        self._T_map_keyframe = np.zeros((0, 4, 4))
        self.stamp_s, self.frames = -np.inf, 0
        self.blocks = Blocks(_BLOCK_M, self.settings.max_surfels)
        self._paging = SurfelPaging(self.settings.max_surfels, self.settings.far_m, self.settings.resting_folder)
        self._scratch: dict[str, np.ndarray] = {}
        self._weight_of: tuple[float, ...] = ()

    def fuse(
        self,
        surface: FrameSurface,
        intrinsics: FloatArray,
        T_map_camera: FloatArray,
        stamp_s: float,
        noise: DepthNoise | None = None,
        frames: int = 1,
        keyframe: KeyframeId | None = None,
    ) -> FusedFrame:
        """Fuse a frame of an ideal pinhole camera into the map.

        Args:
            intrinsics: (4,) fx, fy, cx, cy.
            T_map_camera: (4, 4) pose of the frame. A frame whose tracking failed has none, and cannot be fused.
            stamp_s: stamp, not before that of the last frame.
            noise: depth noise; by default that of Kinect v1.
            frames: weight, as a number of frames, with similar ones that were skipped.
            keyframe: keyframe that new surfels are attached to.

        Raises MapError if shapes differ, depth is not in metres, the pose is not a rigid motion, the stamp is before
        the last one, or the keyframe is unknown.
        """
        noise = noise or DepthNoise()
        depth_m, normal, grey, color = checked_frame(surface, noise.far_m)
        pose = checked_pose(T_map_camera, intrinsics)
        if not np.isfinite(stamp_s) or stamp_s < self.stamp_s:
            raise MapError(f"stamp_s is {stamp_s}, after {self.stamp_s}", fix="fuse frames in order of time")
        if keyframe is not None and not 0 <= keyframe < len(self.T_map_keyframe):
            raise MapError(f"there is no keyframe {keyframe}", fix="give the map the store that has it")
        self.stamp_s, dropped = float(stamp_s), self.blocks.dropped
        self._load_near(pose)
        sensor = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m, noise.far_m], np.float32)
        shape, size = depth_m.shape, depth_m.size
        lens = pose.T.astype(np.float32), pose.grid.astype(np.float32), *rays_of(pose.grid, shape)
        camera = Camera(*lens, np.float32(1 / min(pose.grid[:2])), sensor)  # with the size of a pixel at one metre
        reading, radius = self._rooms(reading=((size, READING), np.float32), radius=((size,), np.float32))
        looks = (color.reshape(-1, 3), grey.reshape(-1))
        since_s = self.stamp_s - np.array([*self._lifetime_s, self.settings.active_s])
        seen = FrameReadings(depth_m, reading, radius, *looks, self.stamp_s, np.float32(frames), since_s)
        weight, rules = self._weight(pose.grid, shape), self._rules_for(camera.noise)
        fusion.read(0, shape[0], seen, normal, weight, camera, rules)
        matched, removed, merged, is_new = self._average(seen, camera, pose, rules)
        n = int(np.count_nonzero(is_new))
        images = np.empty((n, 8), np.float32), np.empty((n, 4), np.float32), np.empty((n, 2))
        of_keyframe = np.full(n, -1 if keyframe is None else keyframe, np.int32)
        new = SurfelArrays(*images, np.empty(n, np.float32), of_keyframe)
        fusion.make_new(is_new.reshape(-1), seen, new)
        kept = self._rules
        added = self.blocks.append(new, self.stamp_s, kept)
        self.frames += 1
        removed += self.blocks.sweep(self.stamp_s, kept)
        return FusedFrame(matched, added, removed, merged, self.blocks.dropped - dropped)

    def _weight(self, grid: FloatArray, shape: tuple[int, int]) -> Float32Array:
        """Return the weight of readings (h, w) by distance from the image centre; Keller et al. 2013, section 4.2."""
        key = (*grid, *shape)
        if self._weight_of != key:
            self._weight_of = key
            u, v = np.arange(shape[1]) - grid[2], np.arange(shape[0]) - grid[3]
            farthest2 = max(np.abs(u[[0, -1]])) ** 2 + max(np.abs(v[[0, -1]])) ** 2
            share2 = (u[None] ** 2 + v[:, None] ** 2) / max(farthest2, 1.0)
            self._scratch["weight"] = np.exp(-share2 / (2 * _RADIAL_SIGMA**2)).astype(np.float32)
        return self._scratch["weight"]

    def _average(
        self, seen: FrameReadings, camera: Camera, pose: Pose, rules: FusionRules
    ) -> tuple[int, int, int, np.ndarray]:
        """Match, average and merge; return the numbers of matched, removed and merged surfels, and which pixels are new
        (h, w).
        """
        blocks = self.blocks
        height, width = seen.depth_m.shape
        pages = blocks.pages_in_view(pose.T, pose.grid, (height, width), self._surfels_far_m(camera.noise) + 1, -np.inf)
        entries, surfels = (len(pages) * PAGE,), blocks.surfels
        found = Candidates(
            *self._rooms(
                slots=(entries, np.int32),
                pixel=(entries, np.int32),
                rank=(entries, np.float32),
                found=((len(pages), 4), np.int32),
                chosen=((seen.depth_m.size,), np.int32),
            )
        )
        best, is_new = self._rooms(best=((seen.depth_m.size,), np.float32), is_new=((height, width), np.bool_))
        in_view = InView(pages, blocks.page_fill)
        find_candidates(0, len(pages), in_view, surfels, seen, camera, rules, found)
        choose(0, height, width, found.pixel, found.rank, found.counts, best, found.chosen)
        find_new(0, height, found, surfels, seen, camera.pitch, rules, is_new)
        home = fusion.Home(blocks.page_cell, blocks.cell_xyz, blocks.cell_seen_s, blocks.block_m)
        fusion.update(0, len(pages), found, surfels, home, camera, seen, rules)
        is_due = self.frames % _MERGED_EVERY == 1
        merged = 0
        if is_due:
            by_row = np.zeros(height, np.int64)
            fusion.merge(0, height, width, found, surfels, rules, by_row)
            merged = int(by_row.sum())
        _, died, matched, died_then = found.counts.sum(axis=0, dtype=np.int64).tolist()
        blocks.count_deaths(died + died_then + merged)
        return matched, died + died_then, merged, is_new

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        """Return a view of the active map: stable surfels, and unstable ones where there are no stable ones.

        Args: as of `ReferenceModel.predict`. Raises MapError for an invalid pose.
        """
        pose = checked_pose(T_map_camera, intrinsics)
        self._load_near(pose)
        limits = (self.settings.far_m, 0.0, _VAGUE_M**2)
        return PredictedView(*self._show(pose, shape, limits, self._active_since_s, False)[:3])

    def render(
        self,
        T_map_camera: FloatArray,
        intrinsics: FloatArray,
        shape: tuple[int, int],
        which: Literal["all", "active", "stable"] = "all",
        far_m: float | None = None,
    ) -> ColoredView:
        """Return a colour view of all, active or all stable surfels, up to the distance `far_m`."""
        least = self.settings.stable_confidence if which == "stable" else 0.0
        far_m = self.settings.far_m if far_m is None else far_m
        since_s = self._active_since_s if which == "active" else -np.inf
        pose = checked_pose(T_map_camera, intrinsics)
        self._load_near(pose)
        return ColoredView(*self._show(pose, shape, (far_m, least, np.inf), since_s, True))

    def _show(
        self, pose: Pose, shape: tuple[int, int], limits: tuple[float, float, float], since_s: float, with_color: bool
    ) -> tuple[Float32Array, ...]:
        """Draw depth, normal, grey, and colour if requested.

        `limits` are the largest distance, the least confidence, and the largest variance.
        """
        far_m, least, vague_m2 = limits
        blocks, (height, width) = self.blocks, shape
        pages = blocks.pages_in_view(pose.T, pose.grid, shape, far_m, since_s)
        entries = len(pages) * PAGE
        disks = view.Disks(
            *self._rooms(
                disk=((entries, view.DISK), np.float32),
                bound=((entries, 4), np.int16),
                count=((len(pages), 2), np.int32),
            )
        )
        sizes = (_SMALLEST_PX, _LARGEST_PX, _SHOWN_COSINE)
        numbers = (far_m, self.settings.stable_confidence, least, vague_m2, *sizes)
        shown = view.RenderLimits._make((*map(np.float32, numbers), since_s))
        lens = view.RenderCamera(pose.T.astype(np.float32), pose.grid.astype(np.float32), width, height)
        in_view = InView(pages, blocks.page_fill)
        view.project_disks(0, len(pages), in_view, blocks.surfels, lens, shown, disks)
        near, sums = self._rooms(near=((*shape, view.NEAR), np.float32), sums=((*shape, view.SUMS), np.float32))
        image = view.RenderImage(*rays_of(pose.grid, shape), near, sums, np.float32(_BLEND), np.float32(_BLEND_M))
        view.blend(0, height, disks, image)
        view.fill_in(0, height, disks, image)
        color = np.empty((*shape, 3) if with_color else (0, 0, 3), np.float32)
        out = np.empty(shape, np.float32), np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
        view.divide(0, height, near, sums, *out, color)
        return *out, color

    def _load_near(self, pose: Pose) -> None:
        """Apply the motion of keyframes, and load the surfels that a camera may see."""
        self._follow()
        self._paging.load_near(self.blocks, (self.T_map_keyframe, pose.T), self.stamp_s, self._rules)

    def __len__(self) -> int:
        return self.blocks.alive + len(self._paging.resting)

    @property
    def dropped(self) -> int:
        """Number of surfels lost so far for lack of memory, or unreadable on disk."""
        return self.blocks.dropped + self._paging.resting.lost

    @property
    def memory_bytes(self) -> int:
        """Size of all arrays."""
        return self.blocks.memory_bytes + sum(array.nbytes for array in self._scratch.values())

    @property
    def T_map_keyframe(self) -> FloatArray:
        """Poses (K, 4, 4) of the keyframes by number, from the store or from the file."""
        return self._T_map_keyframe if self._store is None else self._store.T_map_keyframe

    def status(self) -> MapStatus:
        """Return counts of the map; visits all surfels."""
        stable = active = 0
        for part in self._parts():
            stable += int(np.count_nonzero(self._are_stable(part)))
            active += int(np.count_nonzero(part.seen_s[:, 1] >= self._active_since_s))
        rests = len(self._paging.resting)
        return MapStatus(len(self), stable, active, self.dropped, self.memory_bytes, rests)

    def surfels(self, which: Literal["all", "stable"] = "all") -> Surfels:
        """Return copies of all surfels, or of the stable ones, block by block."""
        self._follow()
        # Filled part by part, without a temporary second copy; unused room is never touched and takes no memory.
        copies: dict[str, np.ndarray] = {
            name: np.empty((len(self), *shape), dtype) for name, (dtype, shape) in _ARRAYS.items()
        }
        end = 0
        for part in self._parts():
            views = views_of(part if which == "all" else _chosen(part, self._are_stable(part)))
            begin, end = end, end + len(views.grey)
            for name, array in copies.items():
                array[begin:end] = getattr(views, name)
        return Surfels(*(copies[name][:end] for name in Surfels.__slots__))

    def parts(
        self, which: Literal["all", "stable"] = "all", keyframes: tuple[int, int] | None = None
    ) -> Iterator[Surfels]:
        """Yield such copies, some megabytes at a time; only those of keyframes in an interval, if given."""
        self._follow()
        for part in self._parts(keyframes):
            yield views_of(part if which == "all" else _chosen(part, self._are_stable(part)))

    def _parts(self, keyframes: tuple[int, int] | None = None) -> Iterator[SurfelArrays]:
        """Yield copies of all surfels in memory, block by block, then of those on disk."""
        slots = self.blocks.slots()
        for begin in range(0, len(slots), _COPIED_AT_ONCE):
            some = slots[begin : begin + _COPIED_AT_ONCE]
            if keyframes is not None:
                of_some = self.blocks.surfels.keyframe[some]
                some = some[(of_some >= keyframes[0]) & (of_some < keyframes[1])]
            yield SurfelArrays(*(array[some] for array in self.blocks.surfels))
        yield from self._paging.resting.all(self.T_map_keyframe, keyframes)

    def _are_stable(self, part: SurfelArrays) -> BoolArray:
        return np.asarray(part.geometry[:, CONFIDENCE] >= self.settings.stable_confidence)

    def add(self, surfels: Surfels, stamp_s: float) -> int:
        """Add surfels unchanged, at a map's time; return how many found room, in memory or on disk."""
        self._follow()
        self.stamp_s = max(self.stamp_s, stamp_s)
        radius, confidence = surfels.radius_m[:, None], surfels.confidence[:, None]
        geometry = np.hstack([surfels.position, radius, surfels.normal, confidence]).astype(np.float32)
        look = np.hstack([surfels.color, surfels.grey[:, None]]).astype(np.float32)
        seen_s = np.stack([surfels.first_s, surfels.last_s], axis=-1)
        new = SurfelArrays(geometry, look, seen_s, surfels.variance_m2, surfels.keyframe)
        most = int((1 - LEAST_ROOM) * self.settings.max_surfels) - self.blocks.alive
        staying = self._paging.store_surplus(new, self.T_map_keyframe, most)
        rest = len(new.geometry) - len(staying.geometry)
        return rest + self.blocks.append(staying, self.stamp_s, self._rules)

    def restore(self, dropped: int, T_map_keyframe: FloatArray) -> None:
        """Set the count of dropped surfels and the keyframe poses (K, 4, 4), for a map read from a file."""
        self.blocks.dropped, self._T_map_keyframe = dropped, T_map_keyframe

    def attach_to(self, store: KeyframeStore) -> None:
        """Attach a map from a file to a store: move surfels to its keyframe poses, now and from now on.

        Raises MapError if the store has fewer keyframes than the map.
        """
        self._follow()
        known = self.T_map_keyframe
        if len(known) > len(store):
            raise MapError(f"has {len(known)} keyframes, the store {len(store)}", fix="give the store of this map")
        moves = store.T_map_keyframe[: len(known)] @ se3.invert(known)
        moves = np.where(np.isfinite(moves).all(axis=(1, 2), keepdims=True), moves, np.eye(4))
        if not np.allclose(moves, np.eye(4), atol=1e-12):
            self.blocks.move(np.concatenate([moves, np.eye(4)[None]]), self.stamp_s, self._rules)
        self._store, self._follower = store, store.follow()

    def move(self, T_new_old: FloatArray) -> None:
        """Move the whole map, and all keyframes of its store, by a rigid motion (4, 4) from the left.

        Raises MapError for an invalid motion.
        """
        T = checked_motion(T_new_old, "T_new_old")
        self._follow()
        if self._store is None or self._follower is None:
            self._T_map_keyframe = T @ self._T_map_keyframe
        else:
            self._store.move(list(self._store), T @ self._store.T_map_keyframe)
            self._follower.moves()  # moved below, with surfels that have no keyframe
        self.blocks.move(T[None], self.stamp_s, self._rules)

    def settle(self) -> int:
        """Remove expired unstable surfels in memory, and return their number.

        Fusion removes them gradually, a part of the map per frame.
        """
        return self.blocks.sweep_all(self.stamp_s, self._rules)

    def _follow(self) -> None:
        """Move surfels by the motion of their keyframes since the last call."""
        moves = None if self._follower is None else self._follower.moves()
        if moves is not None:
            self.blocks.move(np.concatenate([moves, np.eye(4)[None]]), self.stamp_s, self._rules)

    @property
    def _active_since_s(self) -> float:
        return self.stamp_s - self.settings.active_s

    @property
    def _rules(self) -> FloatArray:
        unstable_s, unseen_s = self._lifetime_s
        return np.array([self.settings.stable_confidence, unstable_s, self.settings.active_s, unseen_s])

    def _rules_for(self, sensor: Float32Array) -> FusionRules:
        """Return the rules of fusion for a sensor's depth noise."""
        own = self.settings.stable_confidence, self.settings.far_m, self._surfels_far_m(sensor)
        return FusionRules(*map(np.float32, FusionRules(*own)))

    def _surfels_far_m(self, sensor: Float32Array) -> float:
        """Return the largest distance of surfels, with a margin for depth noise."""
        far_m = self.settings.far_m
        return far_m + _ADDED_SIGMAS * float(sensor[0] + sensor[1] * far_m**2)

    def _rooms(self, **wanted: tuple[tuple[int, ...], type]) -> list[np.ndarray]:
        """Return buffers by shape and type that are reused from frame to frame.

        New memory costs more than the computation in it.
        """
        rooms = []
        for name, (shape, dtype) in wanted.items():
            size = math.prod(shape)
            kept = self._scratch.get(name)
            if kept is None or len(kept) < size:
                kept = self._scratch[name] = np.empty(size + size // 2, dtype)
            rooms.append(kept[:size].reshape(shape))
        return rooms


def _chosen(part: SurfelArrays, which: BoolArray) -> SurfelArrays:
    return SurfelArrays(*(array[which] for array in part))


# Frame of positions and normals, as written in files.
FRAME = "map"


@dataclass(frozen=True, slots=True)
class FusedFrame:
    """Result of fusing a frame.

    Attributes:
        matched: number of surfels that pixels were averaged into.
        removed: number of surfels in free space, expired before they became stable, or outside their block.
        merged: number of duplicates merged into another surfel.
        dropped: number removed or not added for lack of memory.
    """

    matched: int
    added: int
    removed: int
    merged: int
    dropped: int


@dataclass(frozen=True, slots=True)
class MapStatus:
    """Counts of a map.

    Attributes:
        active: those seen within the time window.
        dropped: number dropped so far for lack of memory.
        resting: number of surfels on disk, far from the camera.
    """

    surfels: int
    stable: int
    active: int
    dropped: int
    memory_bytes: int
    resting: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Surfels:
    """Copies of surfels as flat arrays.

    Attributes:
        position: (n, 3) float32 in metres, in the map frame.
        normal: (n, 3) float32 of length 1, towards the viewpoint.
        radius_m: (n,) float32.
        color: (n, 3) float32 red, green, blue from 0 to 255; -1 if unknown.
        grey: (n,) float32 from 0 to 255; -1 if unknown.
        confidence: (n,) float32, number of frames that saw it, up to 100.
        variance_m2: (n,) float32 variance of the position along the normal.
        first_s, last_s: (n,) first and last time seen.
        keyframe: (n,) int32 number of its keyframe, -1 for none.
    """

    position: Float32Array
    normal: Float32Array
    radius_m: Float32Array
    color: Float32Array
    grey: Float32Array
    confidence: Float32Array
    variance_m2: Float32Array
    first_s: FloatArray
    last_s: FloatArray
    keyframe: Int32Array


# Type and further dimensions of each array of `Surfels`.
_ARRAYS: dict[str, tuple[type, tuple[int, ...]]] = dict.fromkeys(Surfels.__slots__, (np.float32, ()))
_ARRAYS |= dict.fromkeys(("position", "normal", "color"), (np.float32, (3,)))
_ARRAYS |= dict.fromkeys(("first_s", "last_s"), (np.float64, ())) | {"keyframe": (np.int32, ())}

Parts = Callable[[], Iterable[Surfels]]
"""Returns the surfels of a map in parts, at each call. All at once, they would take as much memory as the map."""


@dataclass(frozen=True, slots=True, eq=False)
class ColoredView(PredictedView):
    """A predicted view with `color` (h, w, 3) float32 from 0 to 255; grey if only that is known, else -1."""

    color: Float32Array


_NONE_LARGER_PX = 4096
_KNOWN_POSES = "fuse, predict and move only where the pose is known"
_UNITS = {
    "depth_m": "divide raw depth by its units a metre: of millimetres, (depth / 1000).astype(np.float32)",
    "normal": "unit vectors in the camera frame",
    "grey": "0 to 255, -1 where unknown",
    "color": "0 to 255, -1 where unknown",
}


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """T_map_camera (4, 4) and fx, fy, cx, cy (4,)."""

    T: FloatArray
    grid: FloatArray


def rays_of(grid: FloatArray, shape: tuple[int, ...]) -> tuple[Float32Array, Float32Array]:
    """Return the slopes of the columns (w,) and rows (h,) of a camera with fx, fy, cx, cy."""
    fx, fy, cx, cy = grid
    x, y = (np.arange(shape[1]) - cx) / fx, (np.arange(shape[0]) - cy) / fy
    return x.astype(np.float32), y.astype(np.float32)


def checked_frame(surface: FrameSurface, far_m: float) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Return depth (h, w), normals (h, w, 3), grey (h, w), and colour (h, w, 3), which is (0, 0, 3) without any.

    Raises MapError if the shapes differ or the depth is not in metres. Pixels with NaN depth add nothing.
    """
    given = {name: _array(name, getattr(surface, name)) for name in ("depth_m", "normal", "grey")}
    depth_m = given["depth_m"]
    if depth_m.ndim != 2 or not 0 < max(depth_m.shape) <= _NONE_LARGER_PX:
        raise MapError(f"depth_m is of shape {depth_m.shape}, not (h, w)")
    color = np.empty((0, 0, 3), np.float32) if surface.color is None else _array("color", surface.color)
    for name, image in (given if surface.color is None else given | {"color": color}).items():
        expected = (*depth_m.shape, 3) if name in ("normal", "color") else depth_m.shape
        if image.shape != expected:
            raise MapError(f"{name} is of shape {image.shape}, not {expected} as for depth_m")
    if wrong := why_not_metres(depth_m, far_m):
        raise MapError(f"depth_m {wrong[0]}", fix=wrong[1])
    return depth_m, given["normal"], given["grey"], color


def _array(name: str, image: Any) -> Float32Array:
    if not isinstance(image, np.ndarray):
        raise MapError(f"{name} is a {type(image).__name__}, not an array", fix="np.asarray(image, np.float32)")
    is_bytes = name == "color" and image.dtype == np.uint8
    if image.dtype.kind != "f" and not is_bytes:
        raise MapError(f"{name} is of {image.dtype}, not float32", fix=_UNITS[name])
    return np.ascontiguousarray(image, np.float32)


def checked_pose(T_map_camera: FloatArray, intrinsics: FloatArray) -> Pose:
    """Return the pose; raise MapError if it is invalid."""
    T = checked_motion(T_map_camera, "T_map_camera")
    try:
        grid = np.ascontiguousarray(intrinsics, float)
    except (TypeError, ValueError) as error:
        raise MapError("intrinsics are not fx, fy, cx, cy") from error
    if grid.shape != (4,) or not np.isfinite(grid).all() or min(grid[:2]) <= 0:
        raise MapError("intrinsics are not fx, fy, cx, cy with positive focal lengths")
    return Pose(T, grid)


def checked_motion(T: FloatArray, name: str) -> FloatArray:
    """Return the rigid motion (4, 4); raise MapError if it is invalid."""
    try:
        T = np.ascontiguousarray(T, float)
    except (TypeError, ValueError) as error:
        raise MapError(f"{name} is a {type(T).__name__}, not (4, 4) of numbers", fix=_KNOWN_POSES) from error
    if wrong := se3.why_invalid(T, tolerance=1e-4):
        raise MapError(f"{name} is not a rigid motion: {wrong[0]}", fix=f"{wrong[1]}; {_KNOWN_POSES}")
    return T


def views_of(part: SurfelArrays) -> Surfels:
    """Return flat arrays that are views of the same memory."""
    position, radius_m, normal, confidence = np.split(part.geometry, (3, RADIUS + 1, CONFIDENCE), axis=1)
    color, grey, first_s, last_s = part.look[:, :3], part.look[:, 3], part.seen_s[:, 0], part.seen_s[:, 1]
    others = radius_m[:, 0], color, grey, confidence[:, 0], part.variance, first_s, last_s, part.keyframe
    return Surfels(position, normal, *others)


_COLORED_EVERY = 3  # one fused frame in this many gives colour, for display only, which takes time to load; chosen


class MapBuilder:
    """Fuses tracked frames into a surfel map; at most one in a tenth of a second while the camera hardly moves.

    Args:
        odometry: tracks the frames, extracts surfaces, and keeps the keyframes to which surfels are attached.
        calibration: has the noise of depth.
        settings: of the map.

    Attributes:
        map: the surfel map.
    """

    def __init__(
        self, odometry: DenseOdometry, calibration: Calibration, settings: SurfelSettings | None = None
    ) -> None:
        self.map = SurfelMap(settings, odometry.store)
        self._odometry = odometry
        self._thinning = Thinning(self.map.settings)
        self._noise = calibration.depth_noise

    def fuse_tracked(self, frame: RgbdFrame, seen: DenseEstimate) -> FusedFrame | None:
        """Fuse a frame that odometry has tracked, T_map_camera; return None if it is skipped or has no pose."""
        T_map_camera, odometry = seen.T_odom_body, self._odometry
        if seen.frame is None or T_map_camera is None:
            return None
        frames = self._thinning.count(T_map_camera, frame.stamp_s)  # with the skipped ones before it
        if not frames:
            return None
        with odometry.watch.stage("fuse"):
            with_color = self.map.frames % _COLORED_EVERY == 0
            surface = odometry.surface(seen.frame, frame, with_color)
            how = (self._noise, frames, seen.keyframe)
            return self.map.fuse(surface, odometry.intrinsics, T_map_camera, frame.stamp_s, *how)

    def track_map(self, tracks: bool) -> None:
        """Align further frames with the map's prediction, or with keyframes."""
        self._odometry.refer_to(self.map if tracks else None)


class Thinning:
    """Remembers the last fused frame, and counts the frames skipped since.

    A frame from the same place shows the same pixels with the same sensor errors. It costs as much as one from
    elsewhere and adds less information.
    """

    def __init__(self, settings: SurfelSettings) -> None:
        self._settings = settings
        self._T_map_last: FloatArray | None = None
        self._last_s, self._skipped = -np.inf, 0

    def count(self, T_map_camera: FloatArray, stamp_s: float) -> int:
        """Return the weight, in frames, of one at a pose (4, 4), with those skipped before; 0 to skip it too."""
        if self._T_map_last is not None and stamp_s - self._last_s < self._settings.fused_after_s:
            shift_m = se3.view_shift_m(se3.invert(self._T_map_last) @ T_map_camera)
            if shift_m < self._settings.fused_way_m:
                self._skipped += 1
                return 0
        frames, self._skipped = self._skipped + 1, 0
        self._T_map_last, self._last_s = T_map_camera, stamp_s
        return frames

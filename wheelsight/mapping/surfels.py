"""SurfelMap: a model of what was seen, of small disks that frames are averaged into and that views are predicted from.

Keller et al. 2013 for the surfels; Whelan et al. 2015 and 2016 for the window in time.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.errors import MapError
from wheelsight.geometry import Float32Array, FloatArray, Int32Array
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.mapping import _fusion_kernels as fusion
from wheelsight.mapping import _match_kernels as match
from wheelsight.mapping import _view_kernels as view
from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, RADIUS, SurfelArrays
from wheelsight.mapping._inputs import Frame, Pose, checked_frame, checked_motion, checked_pose, rays_of
from wheelsight.mapping.blocks import Blocks
from wheelsight.mapping.settings import SurfelSettings
from wheelsight.mapping.values import ColoredView, FusedFrame, MapStatus, Surfels
from wheelsight.threads import Rows
from wheelsight.views import PredictedView, Surface

# Duplicates are looked for in one of so many frames, and not in that which brings colour: those of a few frames can be
# merged at once.
_MERGED_EVERY = 3
# Surfels are laid so many standard deviations farther than they are shown: where laying ends, the readings that err
# towards the camera lay the surfels, and others are to mend that first.
_LAID_SIGMAS = 12.0
# Of the weight over the distance from the image's centre, which is 1 at its farthest corner (Keller et al. 2013).
_RADIAL_SIGMA = 0.6


class SurfelMap:
    """Surfels in the map frame; frames with poses go in, views come out. A `ReferenceModel` to track against.

    Each surfel hangs on the keyframe that was current when it was made. Where the map follows a store, surfels move
    with their keyframes: before it is fused into, shown or read, it asks how they have moved.

    Results do not depend on `settings.threads`, to the last bit. Not to be used by two threads at once.

    Args:
        settings: or the defaults.
        store: of the keyframes; without one, nothing moves.

    Attributes:
        settings: of the map.
        stamp_s: of the last frame.
        frames: how many were fused.
    """

    def __init__(self, settings: SurfelSettings | None = None, store: KeyframeStore | None = None) -> None:
        self.settings = settings or SurfelSettings()
        self._store, self._follower = store, None if store is None else store.follow()
        self._T_map_keyframe = np.zeros((0, 4, 4))
        self.stamp_s, self.frames = -np.inf, 0
        self._blocks = Blocks(self.settings.block_m, self.settings.max_surfels)
        self._rows = Rows(self.settings.threads)
        self._scratch: dict[str, np.ndarray] = {}
        self._weight_of: tuple[float, ...] = ()

    def __len__(self) -> int:
        return self._blocks.alive

    @property
    def dropped(self) -> int:
        """How many surfels were given up so far for want of room."""
        return self._blocks.dropped

    @property
    def memory_bytes(self) -> int:
        """Of all arrays."""
        return self._blocks.memory_bytes + sum(array.nbytes for array in self._scratch.values())

    @property
    def T_map_keyframe(self) -> FloatArray:
        """Poses (K, 4, 4) of the keyframes that surfels hang on, by number: those of the store, or of the file."""
        return self._T_map_keyframe if self._store is None else self._store.T_map_keyframe

    def status(self) -> MapStatus:
        """How the map stands; goes over all surfels."""
        slots = self._blocks.slots()
        stable = self._blocks.geometry[slots, CONFIDENCE] >= self.settings.stable_confidence
        active = self._blocks.seen_s[slots, 1] >= self._active_since_s
        counts = (len(slots), int(np.count_nonzero(stable)), int(np.count_nonzero(active)))
        return MapStatus(*counts, self.dropped, self.memory_bytes)

    def surfels(self, which: Literal["all", "stable"] = "all") -> Surfels:
        """Copies of all surfels, or of the stable ones, block by block."""
        self._follow()
        blocks, slots = self._blocks, self._blocks.slots()
        if which == "stable":
            slots = slots[blocks.geometry[slots, CONFIDENCE] >= self.settings.stable_confidence]
        geometry, look, seen_s = blocks.geometry[slots], blocks.look[slots], blocks.seen_s[slots]
        return Surfels(
            geometry[:, :3].copy(),
            geometry[:, 4:7].copy(),
            geometry[:, RADIUS].copy(),
            look[:, :3].copy(),
            look[:, 3].copy(),
            geometry[:, CONFIDENCE].copy(),
            blocks.variance[slots],
            seen_s[:, 0].copy(),
            seen_s[:, 1].copy(),
            blocks.keyframe[slots],
        )

    def add(self, surfels: Surfels, stamp_s: float) -> int:
        """Put surfels in as they are, at a map's time; how many found room."""
        self._follow()
        self.stamp_s = max(self.stamp_s, stamp_s)
        radius, confidence = surfels.radius_m[:, None], surfels.confidence[:, None]
        geometry = np.hstack([surfels.position, radius, surfels.normal, confidence]).astype(np.float32)
        look = np.hstack([surfels.color, surfels.grey[:, None]]).astype(np.float32)
        seen_s = np.stack([surfels.first_s, surfels.last_s], axis=-1)
        new = SurfelArrays(geometry, look, seen_s, surfels.variance_m2, surfels.keyframe)
        return self._blocks.append(new, self.stamp_s, self._rules)

    def restore(self, dropped: int, T_map_keyframe: FloatArray) -> None:
        """Count so many surfels as given up before, and know the keyframes (K, 4, 4): for a map read from a file."""
        self._blocks.dropped, self._T_map_keyframe = dropped, T_map_keyframe

    def move(self, T_new_old: FloatArray) -> None:
        """Move the whole map by a rigid motion (4, 4) from the left, and all keyframes of its store.

        Raises MapError for what is none.
        """
        T = checked_motion(T_new_old, "T_new_old")
        self._follow()
        if self._store is None or self._follower is None:
            self._T_map_keyframe = T @ self._T_map_keyframe
        else:
            self._store.move(list(self._store), T @ self._store.T_map_keyframe)
            self._follower.moves()  # moved below, with those that hang on none
        self._blocks.move(T[None], self.stamp_s, self._rules)

    def _follow(self) -> None:
        """Move surfels as their keyframes have moved since this was called last."""
        moves = None if self._follower is None else self._follower.moves()
        if moves is not None:
            self._blocks.move(np.concatenate([moves, np.eye(4)[None]]), self.stamp_s, self._rules)

    def fuse(
        self,
        surface: Surface,
        intrinsics: FloatArray,
        T_map_camera: FloatArray,
        stamp_s: float,
        noise: DepthNoise | None = None,
        frames: int = 1,
        keyframe: KeyframeId | None = None,
    ) -> FusedFrame:
        """Average a frame on the grid of an ideal camera into the map.

        Args:
            surface: what it shows.
            intrinsics: (4,) fx, fy, cx, cy.
            T_map_camera: (4, 4) of this frame: one whose tracking failed has none, and cannot be fused.
            stamp_s: not before that of the last frame.
            noise: of depth; by default Kinect v1's.
            frames: how many it counts as, with those alike that were left out.
            keyframe: that new surfels hang on.

        Raises:
            MapError: shapes that differ, a pose that is no rigid motion, a stamp before the last, or a keyframe that
                the map does not know.
        """
        frame, pose = checked_frame(surface), checked_pose(T_map_camera, intrinsics)
        if not np.isfinite(stamp_s) or stamp_s < self.stamp_s:
            raise MapError(f"stamp_s is {stamp_s}, after {self.stamp_s}", fix="fuse frames in order of time")
        if keyframe is not None and not 0 <= keyframe < len(self.T_map_keyframe):
            raise MapError(f"there is no keyframe {keyframe}", fix="give the map the store that has it")
        self._follow()
        self.stamp_s, noise = float(stamp_s), noise or DepthNoise()
        sensor = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m, noise.far_m], np.float32)
        dropped = self._blocks.dropped
        readings = self._readings(frame.depth_m, frame.normal, pose, sensor)
        when = (self.stamp_s, np.float32(frames))
        matched, removed, merged, is_new = self._average(frame, pose, readings, sensor, when)
        added = self._add_new(frame, readings, is_new, when, -1 if keyframe is None else keyframe)
        self.frames += 1
        removed += self._blocks.sweep(self.stamp_s, self._rules)
        return FusedFrame(matched, added, removed, merged, self._blocks.dropped - dropped)

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        """What the active part of the map looks like: stable surfels, and unstable ones where there is no stable one.

        Args: as of `ReferenceModel.predict`. Raises MapError for a pose that is no rigid motion.
        """
        pose = checked_pose(T_map_camera, intrinsics)
        self._follow()
        limits = (self.settings.far_m, 0.0, self.settings.vague_m**2)
        return PredictedView(*self._show(pose, shape, limits, self._active_since_s, False)[:3])

    def render(
        self,
        T_map_camera: FloatArray,
        intrinsics: FloatArray,
        shape: tuple[int, int],
        which: Literal["all", "active", "stable"] = "all",
        far_m: float | None = None,
    ) -> ColoredView:
        """A view in colour: of all surfels, of those active, or of all stable ones, as far as `far_m`."""
        least = self.settings.stable_confidence if which == "stable" else 0.0
        far_m = self.settings.far_m if far_m is None else far_m
        since_s = self._active_since_s if which == "active" else -np.inf
        pose = checked_pose(T_map_camera, intrinsics)
        self._follow()
        return ColoredView(*self._show(pose, shape, (far_m, least, np.inf), since_s, True))

    @property
    def _active_since_s(self) -> float:
        return self.stamp_s - self.settings.active_s

    @property
    def _rules(self) -> FloatArray:
        s = self.settings
        return np.array([s.stable_confidence, s.unstable_s, s.active_s, s.unseen_s])

    def _kernel_settings(self, sensor: Float32Array) -> Float32Array:
        """In the order of the fusion kernels' constants."""
        s = self.settings
        turn, slant = np.cos(np.radians([s.max_angle_deg, s.max_slant_deg]))
        gates = [s.stable_confidence, s.gate_sigmas, s.gate_m, turn, slant]
        return np.array([*gates, s.free_m, s.drift_m, self._laid_m(sensor), s.gap_m], np.float32)

    def _laid_m(self, sensor: Float32Array) -> float:
        """How far surfels are laid."""
        far_m = self.settings.far_m
        return far_m + _LAID_SIGMAS * float(sensor[0] + sensor[1] * far_m**2)

    def _readings(
        self, depth_m: Float32Array, normal: Float32Array, pose: Pose, sensor: Float32Array
    ) -> tuple[Float32Array, Float32Array]:
        """What each pixel says of the map (h·w, 8), and the radius (h·w,) a surfel there would have."""
        shape = depth_m.shape
        reading = self._room("reading", (depth_m.size, match.READING), np.float32)
        radius = self._room("radius", (depth_m.size,), np.float32)
        weight = self._weight(pose.grid, (shape[0], shape[1]))
        given = (
            depth_m,
            normal,
            weight,
            pose.T32,
            *rays_of(pose.grid, shape),
            pose.pitch,
            sensor,
            self._kernel_settings(sensor),
        )
        self._rows.share(shape[0], lambda a, b: fusion.read(a, b, *given, reading, radius))
        return reading, radius

    def _weight(self, grid: FloatArray, shape: tuple[int, int]) -> Float32Array:
        """How much readings (h, w) count by their distance from the image's centre: Keller et al. 2013, 4.2."""
        key = (*grid, *shape)
        if self._weight_of != key:
            self._weight_of = key
            u, v = np.arange(shape[1]) - grid[2], np.arange(shape[0]) - grid[3]
            farthest2 = max(np.abs(u[[0, -1]])) ** 2 + max(np.abs(v[[0, -1]])) ** 2
            share2 = (u[None] ** 2 + v[:, None] ** 2) / max(farthest2, 1.0)
            self._scratch["weight"] = np.exp(-share2 / (2 * _RADIAL_SIGMA**2)).astype(np.float32)
        return self._scratch["weight"]

    def _average(
        self,
        frame: Frame,
        pose: Pose,
        readings: tuple[Float32Array, Float32Array],
        sensor: Float32Array,
        when: tuple[float, np.float32],
    ) -> tuple[int, int, int, np.ndarray]:
        """Match, average and merge; how many were matched, removed and merged, and which pixels (h, w) are new."""
        blocks, share, settings = self._blocks, self._rows.share, self._kernel_settings(sensor)
        (height, width), size = frame.depth_m.shape, frame.depth_m.size
        pages = blocks.pages_in_view(pose.T, pose.grid, (height, width), self._laid_m(sensor) + 1, -np.inf)
        slots, pixel, rank, found = self._candidates(frame, pose, pages, readings[0], sensor)
        best, chosen = self._room("best", (size,), np.float32), self._room("chosen", (size,), np.int32)
        share(height, lambda a, b: match.choose(a, b, width, pixel, rank, found, best, chosen))
        is_new = self._room("is_new", (height, width), np.bool_)
        seen = (slots, blocks.geometry, blocks.variance, chosen, frame.depth_m, *readings, pose.pitch)
        share(height, lambda a, b: match.find_new(a, b, *seen, settings, is_new))
        counts = np.zeros((len(pages), 2), np.int64)
        surfels = (blocks.geometry, blocks.look, blocks.seen_s, blocks.variance)
        cells = (blocks.page_cell, blocks.cell_xyz, blocks.cell_seen_s, blocks.block_m)
        looks = (pose.T32, sensor, *readings, frame.color.reshape(-1, 3), frame.grey.reshape(-1), *when)
        given = (slots, pixel, chosen, *surfels, *cells, *looks, found, counts)
        share(len(pages), lambda a, b: fusion.update(a, b, *given))
        is_due, matches = self.frames % _MERGED_EVERY == 1, (slots, pixel, found, chosen)
        merged = self._merge((height, width), settings, *matches) if is_due else 0
        removed = int(found[:, 1].sum() + counts[:, 1].sum())
        blocks.count_deaths(removed + merged)
        return int(counts[:, 0].sum()), removed, merged, is_new

    def _merge(self, shape: tuple[int, int], settings: Float32Array, *matches: np.ndarray) -> int:
        """Merge into the chosen surfels the candidates (slots, pixel, found, chosen) that are their like; how many."""
        merged, blocks = np.zeros(shape[0], np.int64), self._blocks
        pairs = (*matches, blocks.geometry, blocks.seen_s, blocks.variance, settings, merged)
        self._rows.share(shape[0], lambda a, b: fusion.merge(a, b, shape[1], *pairs))
        return int(merged.sum())

    def _candidates(
        self, frame: Frame, pose: Pose, pages: Int32Array, reading: Float32Array, sensor: Float32Array
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Slot, pixel and rank (entries,) of the surfels that fit; how many fit and how many died, by page (n, 2)."""
        blocks, entries = self._blocks, (len(pages) * PAGE,)
        slots, pixel = self._room("slots", entries, np.int32), self._room("pixel", entries, np.int32)
        rank, found = self._room("rank", entries, np.float32), self._room("found", (len(pages), 2), np.int32)
        surfels = (pages, blocks.page_fill, blocks.geometry, blocks.seen_s, blocks.variance)
        about = (frame.depth_m, reading, pose.T32, pose.grid32, sensor, self._kernel_settings(sensor))
        since_s = self.stamp_s - np.array([self.settings.unstable_s, self.settings.unseen_s, self.settings.active_s])
        given = (*surfels, *about, since_s, slots, pixel, rank, found)
        self._rows.share(len(pages), lambda a, b: match.find_candidates(a, b, *given))
        return slots, pixel, rank, found

    def _add_new(
        self,
        frame: Frame,
        readings: tuple[Float32Array, Float32Array],
        is_new: np.ndarray,
        when: tuple[float, np.float32],
        keyframe: int,
    ) -> int:
        n = int(np.count_nonzero(is_new))
        images = np.empty((n, 8), np.float32), np.empty((n, 4), np.float32), np.empty((n, 2))
        new = SurfelArrays(*images, np.empty(n, np.float32), np.full(n, keyframe, np.int32))
        looks = (frame.color.reshape(-1, 3), frame.grey.reshape(-1), *when)
        fusion.make_new(is_new.reshape(-1), *readings, *looks, new)
        return self._blocks.append(new, self.stamp_s, self._rules)

    def _show(
        self, pose: Pose, shape: tuple[int, int], limits: tuple[float, float, float], since_s: float, with_color: bool
    ) -> tuple[Float32Array, ...]:
        """Depth, normal, grey, and colour if asked for; limits: how far, least confidence, largest variance."""
        far_m, least, vague_m2 = limits
        blocks, (height, width) = self._blocks, shape
        pages = blocks.pages_in_view(pose.T, pose.grid, shape, far_m, since_s)
        entries = len(pages) * PAGE
        disk = self._room("disk", (entries, view.DISK), np.float32)
        bound = self._room("bound", (entries, 4), np.int16)
        count = self._room("count", (len(pages), 2), np.int32)
        bounds = tuple(np.float32(bound) for bound in (far_m, self.settings.stable_confidence, least, vague_m2))
        surfels = (pages, blocks.page_fill, blocks.geometry, blocks.look, blocks.seen_s, blocks.variance)
        given = (*surfels, pose.T32, pose.grid32, width, height, *bounds, since_s, disk, bound, count)
        self._rows.share(len(pages), lambda a, b: view.project_disks(a, b, *given))
        near = self._room("near", (*shape, view.NEAR), np.float32)
        sums = self._room("sums", (*shape, view.SUMS), np.float32)
        rays = rays_of(pose.grid, shape)
        disks = (*rays, disk, bound, count, near, sums)
        self._rows.share(height, lambda a, b: view.blend(a, b, *disks))
        self._rows.share(height, lambda a, b: view.fill_in(a, b, *disks))
        color = np.empty((*shape, 3) if with_color else (0, 0, 3), np.float32)
        out = np.empty(shape, np.float32), np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
        self._rows.share(height, lambda a, b: view.divide(a, b, near, sums, *out, color))
        return *out, color

    def _room(self, name: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        """An array to write in, kept from frame to frame: fresh memory costs more than the work in it."""
        size = int(np.prod(shape))
        kept = self._scratch.get(name)
        if kept is None or len(kept) < size:
            kept = self._scratch[name] = np.empty(size + size // 2, dtype)
        return kept[:size].reshape(shape)

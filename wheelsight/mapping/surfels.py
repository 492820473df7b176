"""SurfelMap: a model of what was seen, of small disks that frames are averaged into and that views are predicted from.

Keller et al. 2013 for the surfels; Whelan et al. 2015 and 2016 for the window in time.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from wheelsight.calibration import DepthNoise
from wheelsight.errors import MapError
from wheelsight.geometry import BoolArray, Float32Array, FloatArray, Int32Array, se3
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.mapping import _fusion_kernels as fusion
from wheelsight.mapping import _match_kernels as match
from wheelsight.mapping import _view_kernels as view
from wheelsight.mapping._block_kernels import CONFIDENCE, PAGE, InView, SurfelArrays
from wheelsight.mapping._inputs import Frame, Pose, checked_frame, checked_motion, checked_pose, rays_of
from wheelsight.mapping.blocks import Blocks
from wheelsight.mapping.copies import SurfelCopies, views_of
from wheelsight.mapping.resting import Nearness
from wheelsight.mapping.settings import SurfelSettings
from wheelsight.mapping.values import ColoredView, FusedFrame, MapStatus, Surfels
from wheelsight.threads import Rows
from wheelsight.views import PredictedView, Surface

_COPIED_AT_ONCE = 1 << 16  # 5 MB


class SurfelMap:
    """Surfels in the map frame; frames with poses go in, views come out. A `ReferenceModel` to track against.

    Each surfel hangs on the keyframe that was current when it was made. Where the map follows a store, surfels move
    with their keyframes: before it is fused into, shown or read, it asks how they have moved. Where memory runs short,
    what hangs on far keyframes rests on the disk until the camera comes near.

    Results do not depend on `settings.threads`, to the last bit. Not to be used by two threads at once.

    Args:
        settings: or the defaults.
        store: of the keyframes; without one, nothing moves.

    Attributes:
        settings: of the map.
        stamp_s: of the last frame.
        frames: how many were fused.
        blocks: where surfels are kept; they are the map's to change.
    """

    def __init__(self, settings: SurfelSettings | None = None, store: KeyframeStore | None = None) -> None:
        self.settings = settings or SurfelSettings()
        self._store, self._follower = store, None if store is None else store.follow()
        self._T_map_keyframe = np.zeros((0, 4, 4))
        self.stamp_s, self.frames = -np.inf, 0
        self.blocks = Blocks(self.settings.block_m, self.settings.max_surfels)
        self._nearness = Nearness(self.settings)
        self._rows = Rows(self.settings.threads)
        self._scratch: dict[str, np.ndarray] = {}
        self._weight_of: tuple[float, ...] = ()

    def __len__(self) -> int:
        return self.blocks.alive + len(self._nearness.resting)

    @property
    def dropped(self) -> int:
        """How many surfels were given up so far for want of room, or could not be read back from the disk."""
        return self.blocks.dropped + self._nearness.resting.lost

    @property
    def memory_bytes(self) -> int:
        """Of all arrays."""
        return self.blocks.memory_bytes + sum(array.nbytes for array in self._scratch.values())

    @property
    def T_map_keyframe(self) -> FloatArray:
        """Poses (K, 4, 4) of the keyframes that surfels hang on, by number: those of the store, or of the file."""
        return self._T_map_keyframe if self._store is None else self._store.T_map_keyframe

    def status(self) -> MapStatus:
        """How the map stands; goes over all surfels."""
        stable = active = 0
        for part in self._parts():
            stable += int(np.count_nonzero(self._are_stable(part)))
            active += int(np.count_nonzero(part.seen_s[:, 1] >= self._active_since_s))
        rests = len(self._nearness.resting)
        return MapStatus(len(self), stable, active, self.dropped, self.memory_bytes, rests)

    def surfels(self, which: Literal["all", "stable"] = "all") -> Surfels:
        """Copies of all surfels, or of the stable ones, block by block."""
        self._follow()
        copies = SurfelCopies(len(self))
        for part in self._parts():
            copies.add(part if which == "all" else _chosen(part, self._are_stable(part)))
        return copies.all()

    def parts(
        self, which: Literal["all", "stable"] = "all", keyframes: tuple[int, int] | None = None
    ) -> Iterator[Surfels]:
        """Copies of the same, some megabytes at a time; only those that hang on keyframes of an interval."""
        self._follow()
        for part in self._parts(keyframes):
            yield views_of(part if which == "all" else _chosen(part, self._are_stable(part)))

    def _parts(self, keyframes: tuple[int, int] | None = None) -> Iterator[SurfelArrays]:
        """Copies of all that is in memory, block by block, and then of what rests on the disk; a part at a time."""
        slots = self.blocks.slots()
        for begin in range(0, len(slots), _COPIED_AT_ONCE):
            some = slots[begin : begin + _COPIED_AT_ONCE]
            if keyframes is not None:
                of_some = self.blocks.surfels.keyframe[some]
                some = some[(of_some >= keyframes[0]) & (of_some < keyframes[1])]
            yield SurfelArrays(*(array[some] for array in self.blocks.surfels))
        yield from self._nearness.resting.all(self.T_map_keyframe, keyframes)

    def _are_stable(self, part: SurfelArrays) -> BoolArray:
        return np.asarray(part.geometry[:, CONFIDENCE] >= self.settings.stable_confidence)

    def add(self, surfels: Surfels, stamp_s: float) -> int:
        """Put surfels in as they are, at a map's time; how many found room, in memory or on the disk."""
        self._follow()
        self.stamp_s = max(self.stamp_s, stamp_s)
        radius, confidence = surfels.radius_m[:, None], surfels.confidence[:, None]
        geometry = np.hstack([surfels.position, radius, surfels.normal, confidence]).astype(np.float32)
        look = np.hstack([surfels.color, surfels.grey[:, None]]).astype(np.float32)
        seen_s = np.stack([surfels.first_s, surfels.last_s], axis=-1)
        new = SurfelArrays(geometry, look, seen_s, surfels.variance_m2, surfels.keyframe)
        most = int((1 - self.settings.least_room) * self.settings.max_surfels) - self.blocks.alive
        staying = self._nearness.lay_by(new, self.T_map_keyframe, most)
        rest = len(new.geometry) - len(staying.geometry)
        return rest + self.blocks.append(staying, self.stamp_s, self._rules)

    def restore(self, dropped: int, T_map_keyframe: FloatArray) -> None:
        """Count so many surfels as given up before, and know the keyframes (K, 4, 4): for a map read from a file."""
        self.blocks.dropped, self._T_map_keyframe = dropped, T_map_keyframe

    def hang_on(self, store: KeyframeStore) -> None:
        """Move surfels to where a store has their keyframes by now, and with them from now on: for a map from a file.

        Raises MapError where the store has fewer keyframes than the map.
        """
        self._follow()
        known = self.T_map_keyframe
        if len(known) > len(store):
            raise MapError(f"has {len(known)} keyframes, the store {len(store)}", fix="give the store of this map")
        moves = store.T_map_keyframe[: len(known)] @ se3.invert(known)
        moves = np.where(np.isfinite(moves).all(axis=(1, 2), keepdims=True), moves, np.eye(4))
        if not np.allclose(moves, np.eye(4), atol=1e-12):
            self.blocks.move(np.concatenate([moves, np.eye(4)[None]]), self.stamp_s, self._rules, self._rows.share)
        self._store, self._follower = store, store.follow()

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
        self.blocks.move(T[None], self.stamp_s, self._rules, self._rows.share)

    def settle(self) -> int:
        """Let unstable surfels go whose time has come, wherever they are in memory; how many did.

        While frames are fused a part of the map is swept a frame.
        """
        return self.blocks.sweep_all(self.stamp_s, self._rules)

    def _follow(self) -> None:
        """Move surfels as their keyframes have moved since this was called last."""
        moves = None if self._follower is None else self._follower.moves()
        if moves is not None:
            self.blocks.move(np.concatenate([moves, np.eye(4)[None]]), self.stamp_s, self._rules, self._rows.share)

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
            MapError: shapes that differ, depth that is not in metres, a pose that is no rigid motion, a stamp before
                the last, or a keyframe that the map does not know.
        """
        noise = noise or DepthNoise()
        frame, pose = checked_frame(surface, noise.far_m), checked_pose(T_map_camera, intrinsics)
        if not np.isfinite(stamp_s) or stamp_s < self.stamp_s:
            raise MapError(f"stamp_s is {stamp_s}, after {self.stamp_s}", fix="fuse frames in order of time")
        if keyframe is not None and not 0 <= keyframe < len(self.T_map_keyframe):
            raise MapError(f"there is no keyframe {keyframe}", fix="give the map the store that has it")
        self.stamp_s, dropped = float(stamp_s), self.blocks.dropped
        self._come_near(pose)
        camera = self._camera(pose, frame.depth_m.shape, noise)
        seen = self._seen(frame, camera, pose.grid, frames)
        matched, removed, merged, is_new = self._average(seen, camera, pose)
        added = self._add_new(seen, is_new, -1 if keyframe is None else keyframe)
        self.frames += 1
        removed += self.blocks.sweep(self.stamp_s, self._rules)
        return FusedFrame(matched, added, removed, merged, self.blocks.dropped - dropped)

    def predict(self, T_map_camera: FloatArray, intrinsics: FloatArray, shape: tuple[int, int]) -> PredictedView:
        """What the active part of the map looks like: stable surfels, and unstable ones where there is no stable one.

        Args: as of `ReferenceModel.predict`. Raises MapError for a pose that is no rigid motion.
        """
        pose = checked_pose(T_map_camera, intrinsics)
        self._come_near(pose)
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
        self._come_near(pose)
        return ColoredView(*self._show(pose, shape, (far_m, least, np.inf), since_s, True))

    def _come_near(self, pose: Pose) -> None:
        """Have in memory what a camera may see, where its keyframes are by now."""
        self._follow()
        self._nearness.come_near(self.blocks, (self.T_map_keyframe, pose.T), self.stamp_s, self._rules)

    @property
    def _active_since_s(self) -> float:
        return self.stamp_s - self.settings.active_s

    @property
    def _rules(self) -> FloatArray:
        s = self.settings
        return np.array([s.stable_confidence, s.unstable_s, s.active_s, s.unseen_s])

    def _rules_for(self, sensor: Float32Array) -> match.Rules:
        """The settings as kernels read them, for a sensor of that noise."""
        s = self.settings
        turn, slant = np.cos(np.radians([s.max_angle_deg, s.max_slant_deg]))
        named = (getattr(s, name) for name in match.Rules._fields if name in type(s).model_fields)
        return match.Rules(*map(np.float32, (*named, turn, slant, self._laid_m(sensor), s.least_cosine**2)))

    def _laid_m(self, sensor: Float32Array) -> float:
        """How far surfels are laid."""
        far_m = self.settings.far_m
        return far_m + self.settings.laid_sigmas * float(sensor[0] + sensor[1] * far_m**2)

    def _camera(self, pose: Pose, shape: tuple[int, ...], noise: DepthNoise) -> match.Camera:
        sensor = np.array([noise.constant_m, noise.quadratic_per_m, noise.near_m, noise.far_m], np.float32)
        return match.Camera(pose.T32, pose.grid32, *rays_of(pose.grid, shape), pose.pitch, sensor)

    def _seen(self, frame: Frame, camera: match.Camera, grid: FloatArray, frames: int) -> match.Seen:
        """What each pixel says of the map, and the radius a surfel there would have."""
        height, width = frame.depth_m.shape
        reading = self._room("reading", (frame.depth_m.size, match.READING), np.float32)
        radius = self._room("radius", (frame.depth_m.size,), np.float32)
        looks = (frame.color.reshape(-1, 3), frame.grey.reshape(-1))
        since_s = self.stamp_s - np.array([self.settings.unstable_s, self.settings.unseen_s, self.settings.active_s])
        seen = match.Seen(frame.depth_m, reading, radius, *looks, self.stamp_s, np.float32(frames), since_s)
        given = (seen, frame.normal, self._weight(grid, (height, width)), camera, self._rules_for(camera.noise))
        self._rows.share(height, lambda a, b: fusion.read(a, b, *given))
        return seen

    def _weight(self, grid: FloatArray, shape: tuple[int, int]) -> Float32Array:
        """How much readings (h, w) count by their distance from the image's centre: Keller et al. 2013, 4.2."""
        key = (*grid, *shape)
        if self._weight_of != key:
            self._weight_of = key
            u, v = np.arange(shape[1]) - grid[2], np.arange(shape[0]) - grid[3]
            farthest2 = max(np.abs(u[[0, -1]])) ** 2 + max(np.abs(v[[0, -1]])) ** 2
            share2 = (u[None] ** 2 + v[:, None] ** 2) / max(farthest2, 1.0)
            self._scratch["weight"] = np.exp(-share2 / (2 * self.settings.radial_sigma**2)).astype(np.float32)
        return self._scratch["weight"]

    def _average(self, seen: match.Seen, camera: match.Camera, pose: Pose) -> tuple[int, int, int, np.ndarray]:
        """Match, average and merge; how many were matched, removed and merged, and which pixels (h, w) are new."""
        blocks, share, rules = self.blocks, self._rows.share, self._rules_for(camera.noise)
        height, width = seen.depth_m.shape
        pages = blocks.pages_in_view(pose.T, pose.grid, (height, width), self._laid_m(camera.noise) + 1, -np.inf)
        found, surfels = self._candidates(seen, camera, pages, rules), blocks.surfels
        best = self._room("best", (seen.depth_m.size,), np.float32)
        ranked = (found.pixel, found.rank, found.counts, best, found.chosen)
        share(height, lambda a, b: match.choose(a, b, width, *ranked))
        is_new = self._room("is_new", (height, width), np.bool_)
        share(height, lambda a, b: match.find_new(a, b, found, surfels, seen, camera.pitch, rules, is_new))
        home = fusion.Home(blocks.page_cell, blocks.cell_xyz, blocks.cell_seen_s, blocks.block_m)
        share(len(pages), lambda a, b: fusion.update(a, b, found, surfels, home, camera, seen, rules))
        is_due = self.frames % self.settings.merged_every == 1 % self.settings.merged_every
        merged = self._merge((height, width), rules, found) if is_due else 0
        _, died, matched, died_then = found.counts.sum(axis=0, dtype=np.int64).tolist()
        blocks.count_deaths(died + died_then + merged)
        return matched, died + died_then, merged, is_new

    def _merge(self, shape: tuple[int, int], rules: match.Rules, found: match.Candidates) -> int:
        """Merge into the chosen surfels the candidates that are their like; how many."""
        merged, surfels = np.zeros(shape[0], np.int64), self.blocks.surfels
        self._rows.share(shape[0], lambda a, b: fusion.merge(a, b, shape[1], found, surfels, rules, merged))
        return int(merged.sum())

    def _candidates(
        self, seen: match.Seen, camera: match.Camera, pages: Int32Array, rules: match.Rules
    ) -> match.Candidates:
        """The surfels that fit; who is chosen is not known yet."""
        blocks, entries = self.blocks, (len(pages) * PAGE,)
        found = match.Candidates(
            self._room("slots", entries, np.int32),
            self._room("pixel", entries, np.int32),
            self._room("rank", entries, np.float32),
            self._room("found", (len(pages), 4), np.int32),
            self._room("chosen", (seen.depth_m.size,), np.int32),
        )
        given = (InView(pages, blocks.page_fill), blocks.surfels, seen, camera, rules, found)
        self._rows.share(len(pages), lambda a, b: match.find_candidates(a, b, *given))
        return found

    def _add_new(self, seen: match.Seen, is_new: np.ndarray, keyframe: int) -> int:
        n = int(np.count_nonzero(is_new))
        images = np.empty((n, 8), np.float32), np.empty((n, 4), np.float32), np.empty((n, 2))
        new = SurfelArrays(*images, np.empty(n, np.float32), np.full(n, keyframe, np.int32))
        fusion.make_new(is_new.reshape(-1), seen, new)
        return self.blocks.append(new, self.stamp_s, self._rules)

    def _show(
        self, pose: Pose, shape: tuple[int, int], limits: tuple[float, float, float], since_s: float, with_color: bool
    ) -> tuple[Float32Array, ...]:
        """Depth, normal, grey, and colour if asked for; limits: how far, least confidence, largest variance."""
        far_m, least, vague_m2 = limits
        blocks, (height, width), share = self.blocks, shape, self._rows.share
        pages = blocks.pages_in_view(pose.T, pose.grid, shape, far_m, since_s)
        entries = len(pages) * PAGE
        disks = view.Disks(
            self._room("disk", (entries, view.DISK), np.float32),
            self._room("bound", (entries, 4), np.int16),
            self._room("count", (len(pages), 2), np.int32),
        )
        s = self.settings
        numbers = (far_m, s.stable_confidence, least, vague_m2, s.smallest_px, s.largest_px, s.shown_cosine)
        shown = view.Limits._make((*map(np.float32, numbers), since_s))
        lens = view.Lens(pose.T32, pose.grid32, width, height)
        given = (InView(pages, blocks.page_fill), blocks.surfels, lens, shown, disks)
        share(len(pages), lambda a, b: view.project_disks(a, b, *given))
        near = self._room("near", (*shape, view.NEAR), np.float32)
        sums = self._room("sums", (*shape, view.SUMS), np.float32)
        image = view.Image(*rays_of(pose.grid, shape), near, sums, np.float32(s.blend), np.float32(s.blend_m))
        share(height, lambda a, b: view.blend(a, b, disks, image))
        share(height, lambda a, b: view.fill_in(a, b, disks, image))
        color = np.empty((*shape, 3) if with_color else (0, 0, 3), np.float32)
        out = np.empty(shape, np.float32), np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
        share(height, lambda a, b: view.divide(a, b, near, sums, *out, color))
        return *out, color

    def _room(self, name: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        """An array to write in, kept from frame to frame: fresh memory costs more than the work in it."""
        size = int(np.prod(shape))
        kept = self._scratch.get(name)
        if kept is None or len(kept) < size:
            kept = self._scratch[name] = np.empty(size + size // 2, dtype)
        return kept[:size].reshape(shape)


def _chosen(part: SurfelArrays, which: BoolArray) -> SurfelArrays:
    return SurfelArrays(*(array[which] for array in part))

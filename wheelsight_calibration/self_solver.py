"""Joint least squares over the parameters of a robot and the poses of the keyframes of a map.

Residuals are distances between patches that two keyframes see, of patches from the floor, of the base from the level
ground, of its motions by wheels and gyroscope, and of the map's own edges, which hold directions that nothing else
measures. The poses are eliminated for the covariance. Teichman, Miller & Thrun, "Unsupervised intrinsic calibration of
depth sensors via SLAM", RSS 2013, hold the map of near views fixed; here it moves with the calibration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.slam.graph import RelativePose
from wheelsight_calibration.self_model import RobotModel
from wheelsight_calibration.self_views import Patches, PatchPair, matched
from wheelsight_calibration.solver import robust_weights, spread
from wheelsight_calibration.wheel_drive import Segments, WheelDrive, sizes_m

# Distance within which patches match, in rounds; walls of an uncalibrated robot's map are off by 5 cm.
_GATES_M = (0.20, 0.15, 0.12, 0.10, 0.10, 0.08, 0.08, 0.06)
_STEPS = 2  # of Gauss–Newton in each round
_CONVERGED = 0.05  # largest change, in σ of the prior, and of poses in σ of `_POSE_M`, after which rounds are skipped
_LEAST_SCALE = 0.3  # of residuals in σ
# A base on a floor between two keyframes: how far jolts and tyres move it. Chosen.
_JOLT_M, _JOLT_RAD = 0.004, np.radians(0.3)
_SIDEWAYS_M, _POSE_M, _POSE_RAD = 0.004, 0.002, np.radians(0.1)
# Edges of the map were made by the calibration in question: their σ counts this many times, and at least this.
_EDGE_FACTOR, _EDGE_LEAST = 1.5, np.array([0.005, 0.005, 0.005, 0.003, 0.003, 0.003])
# Errors of a view's patches are alike over an eighth of its image, and share what moves the whole image, such as the
# shutter: a pair counts as this number of independent patches at most. Of 2, 6 and 25 on three simulated drives,
# fewer were nearer to the truth, above all where a drive turned one way alone.
_INDEPENDENT = 3.0
_CLUSTERS = 25  # of neighbouring keyframes, whose gradients' spread gives the covariance
# σ of the first view's pose in the map, which is free; the floor levels the map of a robot.
_ANCHOR, _ANCHOR_LEVEL = np.full(6, 1e-3), np.array([0.01, 0.1, 0.01, 0.03, 0.01, 0.03])
_FLOOR_SPREAD = 1.5  # σ of a floor's patches: no floor is flat. Chosen
_LEAST_GAIN = 0.2  # of a reading's change in its corrected depth
_H = 1e-6
_NO_WEIGHT = 1e6  # σ of what nothing measures
_BY_SENSOR = (np.s_[:3], np.s_[3:])  # of a step's errors
_FEWEST_FLOOR = 12  # patches
_UPRIGHT, _PLAN_M, _PLAN_POINTS = 0.1, 5.0, 6000  # of a plan's patches: normals' slope, depth, number


@dataclass(frozen=True, eq=False)
class MapData:
    """What a map and its drive hold for a calibration.

    Attributes:
        views: patches of each keyframe.
        T_map_camera: (N, 4, 4) their poses.
        pairs: of views that see the same surfaces.
        floors: patches of the floor, of each view; empty without mount.
        edges: the map's, between these views, by their numbers.
        steps: (S, 2) views between which the robot drove; motions by wheels and gyroscope concern these.
        drive: the wheels' readings, or None.
        yaw_rad: (S,) turn by the gyroscope on each step with its nominal bias, NaN for none.
    """

    views: tuple[Patches, ...]
    T_map_camera: FloatArray
    pairs: tuple[tuple[int, int], ...]
    floors: tuple[IntArray, ...]
    edges: tuple[RelativePose, ...]
    steps: IntArray
    drive: WheelDrive | None = None
    yaw_rad: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def stamps_s(self) -> FloatArray:
        """(N,) times of the views."""
        return np.array([view.stamp_s for view in self.views])


class JointFit(NamedTuple):
    """Values (P,) with covariance (P, P), poses (N, 4, 4), matched pairs, and the spread of their residuals in σ."""

    values: FloatArray
    covariance: FloatArray
    T_map_camera: FloatArray
    matches: tuple[PatchPair, ...]
    scale: float


class _Rows(NamedTuple):
    """Whitened residuals (M,), by the parameters (M, P) and by the poses (M, 6) of some views."""

    views: tuple[int, ...]
    residual: FloatArray
    by_values: FloatArray
    by_poses: tuple[FloatArray, ...]


class JointProblem:
    """Residuals of a map by the parameters of a robot, and their normal equations.

    Args:
        model: the parameters.
        data: the map.
        free: (P,) which parameters are sought; others stay 0.
    """

    def __init__(self, model: RobotModel, data: MapData, free: BoolArray) -> None:
        self.model, self.data, self.free = model, data, free
        self._moved = [model.displacements(view.rays, view.depth_m) for view in data.views]
        self._gains = [model.depth_gains(view.rays, view.depth_m) for view in data.views]
        self.prior = np.linalg.inv(model.prior + 1e-16 * np.eye(len(model)))
        self.segments = self._segments()
        self.seconds = np.diff(data.stamps_s[data.steps], axis=1)[:, 0] if len(data.steps) else np.zeros(0)

    def fit(
        self,
        pairs: Sequence[tuple[int, int]],
        start: JointFit | None = None,
        on_round: Callable[[int, int], None] = lambda done, total: None,
    ) -> JointFit:
        """Return the values and poses for which these pairs and all else agree best.

        Args:
            pairs: of views.
            start: a fit near by, from which it begins; None to begin with the map.
            on_round: called with the number of rounds done and their total.
        """
        values = np.zeros(len(self.model)) if start is None else np.where(self.free, start.values, 0.0)
        T = self.data.T_map_camera.copy() if start is None else start.T_map_camera.copy()
        gates_m = _GATES_M if start is None else _GATES_M[-3:]
        sigmas, matches, scale = np.sqrt(np.diag(self.model.prior)), list[PatchPair](), 1.0
        is_still = False
        for number, gate_m in enumerate(gates_m):
            on_round(number + 1, len(gates_m))
            if is_still and number < len(gates_m) - 1:
                continue
            matches = [self.match(i, j, T, values, gate_m) for i, j in pairs]
            matches = [match for match in matches if len(match.of_first)]
            before, T_before = values, T
            for _ in range(_STEPS):
                scale = self.scale_of(matches, values, T)
                values, T = self._step(matches, values, T, scale)
            moved_m = np.linalg.norm(T[:, :3, 3] - T_before[:, :3, 3], axis=1)
            is_still = bool((np.abs(values - before) < _CONVERGED * sigmas).all() and np.median(moved_m) < _POSE_M / 4)
        scale = self.scale_of(matches, values, T)
        return JointFit(values, self._covariance(matches, values, T, scale), T, tuple(matches), scale)

    def match(self, i: int, j: int, T: FloatArray, values: FloatArray, gate_m: float) -> PatchPair:
        """Return the patches that views i and j share, by corrected points."""
        return matched(self._corrected(values), i, j, se3.invert(T[i]) @ T[j], gate_m)

    def _corrected(self, values: FloatArray) -> Sequence[Patches]:
        c = values[: self.model.camera_count]
        if not c.any():
            return self.data.views
        return _CorrectedViews(self.data.views, self._moved, c)

    def off_m(self, pair: PatchPair, values: FloatArray, T: FloatArray) -> FloatArray:
        """Return distances (M,) of the first view's patches from the planes of the second one's."""
        _, points, other = self._moved_points(pair, values, T)
        normals = self.data.views[pair.second].normals[pair.of_second]
        return np.asarray(((points - other) * normals).sum(axis=1))

    def sigma_m(self, pair: PatchPair, values: FloatArray) -> FloatArray:
        """Return standard deviations (M,) of these distances.

        Noise is one of readings: a correction that shrinks depth shrinks it too. Else a smaller world would fit better.
        """
        return np.hypot(
            self._sigma_m(pair.first, pair.of_first, values), self._sigma_m(pair.second, pair.of_second, values)
        )

    def _sigma_m(self, view: int, which: IntArray, values: FloatArray) -> FloatArray:
        gain = 1 + self._gains[view][which] @ values[: self.model.camera_count]
        return np.asarray(self.data.views[view].sigma_m[which] * np.maximum(gain, _LEAST_GAIN))

    def scale_of(self, matches: Sequence[PatchPair], values: FloatArray, T: FloatArray) -> float:
        """Return the robust spread of the pairs' residuals, in σ."""
        r = np.concatenate(
            [self.off_m(pair, values, T) / self.sigma_m(pair, values) for pair in matches] or [np.zeros(1)]
        )
        return max(float(spread(r[:, None])[0]), _LEAST_SCALE)

    def _moved_points(
        self, pair: PatchPair, values: FloatArray, T: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        c = values[: self.model.camera_count]
        a, b = self.data.views[pair.first], self.data.views[pair.second]
        first = a.points_m[pair.of_first] + self._moved[pair.first][pair.of_first] @ c
        second = b.points_m[pair.of_second] + self._moved[pair.second][pair.of_second] @ c
        T_b_a = se3.invert(T[pair.second]) @ T[pair.first]
        return T_b_a[:3, :3], se3.apply(T_b_a, first), second

    def _pair_rows(self, pair: PatchPair, values: FloatArray, T: FloatArray, scale: float) -> _Rows:
        """Rows of one pair; its residuals count as its independent patches."""
        a, b = pair.first, pair.second
        R, points, second = self._moved_points(pair, values, T)
        n = self.data.views[b].normals[pair.of_second]
        off = ((points - second) * n).sum(axis=1)
        of_a, of_b = (self._sigma_m(v, on, values) for v, on in ((a, pair.of_first), (b, pair.of_second)))
        sigma = scale * np.hypot(of_a, of_b)
        weight = np.sqrt(robust_weights((off / sigma) ** 2) * min(1.0, _INDEPENDENT / len(off))) / sigma
        in_first = n @ R  # the normal in the first view's frame
        moved = np.einsum("mi,mic->mc", in_first, self._moved[a][pair.of_first])
        moved -= np.einsum("mi,mic->mc", n, self._moved[b][pair.of_second])
        by_values = np.zeros((len(off), len(values)))
        # The noise's own change, see `sigma_m`; both parts as shares of the whole.
        of_a, of_b = scale**2 * of_a**2 / sigma**2, scale**2 * of_b**2 / sigma**2
        less = of_a[:, None] * self._gains[a][pair.of_first] + of_b[:, None] * self._gains[b][pair.of_second]
        by_values[:, : self.model.camera_count] = moved - off[:, None] * less
        first = (points - T_translation(T, a, b)) @ R  # the point in the first view's frame
        by_a = np.concatenate([in_first, np.cross(first, in_first)], axis=1)
        by_b = np.concatenate([-n, np.cross(n, points)], axis=1)
        w = weight[:, None]
        return _Rows((a, b), weight * off, w * by_values, (w * by_a, w * by_b))

    def _floor_rows(self, k: int, values: FloatArray) -> _Rows:
        """Height of a view's floor over the base's ground, with the tilt and height of jolts marginalised."""
        on, view, model = self.data.floors[k], self.data.views[k], self.model
        T = model.mount(values)
        moved = self._moved[k][on]
        p = view.points_m[on] + moved @ values[: model.camera_count]
        arms = p @ T[:3, :3].T  # from the camera, in the base's axes
        height = arms[:, 2] + T[2, 3]
        J = np.zeros((len(on), len(model)))
        J[:, : model.camera_count] = np.einsum("i,mic->mc", T[2, :3], moved)
        at = model.index("roll")
        J[:, at], J[:, at + 1], J[:, at + 5] = arms[:, 1], -arms[:, 0], 1.0
        sigma = _FLOOR_SPREAD * self._sigma_m(k, on, values)
        J[:, : model.camera_count] -= height[:, None] * self._gains[k][on]
        weight = np.sqrt(robust_weights((height / np.maximum(3 * sigma, 0.01)) ** 2) * min(1.0, _INDEPENDENT / len(on)))
        weight /= sigma
        base = arms + T[:3, 3]
        jolts = np.stack([_JOLT_RAD * base[:, 1], -_JOLT_RAD * base[:, 0], np.full(len(on), _JOLT_M)], axis=1)
        # (I + B Bᵀ)^-1 = I - B (I + Bᵀ B)^-1 Bᵀ, of whitened B, as a product of roots: rows are multiplied by it.
        B = weight[:, None] * jolts
        u, s, _ = np.linalg.svd(B, full_matrices=False)
        less = 1 - 1 / np.sqrt(1 + s**2)

        def whitened(x: FloatArray) -> FloatArray:
            return np.asarray(x - u @ (less[:, None] * (u.T @ x)))

        r = whitened((weight * height)[:, None])[:, 0]
        return _Rows((), r, whitened(weight[:, None] * J), ())

    def _segments(self) -> Segments | None:
        drive, steps = self.data.drive, self.data.steps
        if drive is None or not self.model.has_wheels or not len(steps):
            return None
        stamps_s = self.data.stamps_s
        return Segments(stamps_s[steps[:, 0]], stamps_s[steps[:, 1]], np.zeros((len(steps), 3)))

    def step_errors(self, values: FloatArray, motions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return errors (S, 4) of the base on each step, and σ: x, y and yaw by the wheels, yaw by the gyroscope.

        Without wheels the first three have no weight; without gyroscope the last.

        Args:
            motions: (S, 4, 4) of the camera.
        """
        mount = self.model.mount(values)
        moved = mount @ motions @ se3.invert(mount)
        twist = se3.log(moved)
        errors, sigmas = np.zeros((len(moved), 4)), np.full((len(moved), 4), _NO_WEIGHT)
        seconds = self.seconds
        if self.segments is not None:
            assert self.data.drive is not None
            wheels = self.model.wheels(values)
            by_wheels = self.segments.predicted(self.data.drive, sizes_m(wheels), wheels.delay_s, np.zeros(3))
            x, y, yaw = by_wheels.T
            # A tyre creeps outwards in bends: to the right in those to the left.
            y = y - values[self.model.index("slide_s")] * np.hypot(x, y) * yaw / np.maximum(seconds, 1e-3)
            rest = se3.log(se3.invert(se3.from_plane(x, y, yaw)) @ moved)
            errors[:, :3] = rest[:, [0, 1, 5]]
            rolled_m = np.abs(x) + np.abs(yaw) * wheels.track_width_m / 2
            # Slip is one of readings too, see `sigma_m`.
            left, right = values[self.model.index("left_radius") :][:2]
            rolled_m *= np.exp((left + right) / 2)
            slip = wheels.slip_m_per_sqrt_m * np.sqrt(rolled_m)
            sigmas[:, 0] = np.hypot(slip / np.sqrt(2), _POSE_M)
            sigmas[:, 1] = np.hypot(_SIDEWAYS_M, 0.5 * np.abs(yaw) * slip)
            sigmas[:, 2] = np.hypot(slip * np.sqrt(2) / wheels.track_width_m, _POSE_RAD)
        if self.model.has_gyro:
            bias, share = values[self.model.index("gyro_bias")], values[self.model.index("gyro_scale")]
            turned = self.data.yaw_rad * (1 + share) - bias * seconds
            there = np.isfinite(turned)
            errors[there, 3] = (twist[:, 5] - turned)[there]
            noise = self.model.calibration.gyro.noise_rad_per_sqrt_s
            sigmas[there, 3] = np.hypot(noise * np.sqrt(seconds), _POSE_RAD)[there]
        return errors, sigmas

    def _step_rows(self, values: FloatArray, T: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Whitened errors (S, 4) of steps, by the values (S, 4, P), and by the poses (S, 4, 6) of start and end."""
        start, end = self.data.steps.T
        motions = se3.invert(T[start]) @ T[end]
        errors, sigmas = self.step_errors(values, motions)
        by_values = np.zeros((*errors.shape, len(values)))
        for p in range(self.model.camera_count, len(values)):
            h = 1e-5 * np.eye(len(values))[p]
            changes = [self.step_errors(values + sign * h, motions)[0] for sign in (1, -1)]
            by_values[..., p] = (changes[0] - changes[1]) / 2e-5
        by_start, by_end = np.zeros((*errors.shape, 6)), np.zeros((*errors.shape, 6))
        for d, h in enumerate(_H * np.eye(6)):
            plus, minus = se3.exp(h), se3.exp(-h)
            for J, ends in ((by_end, (motions @ plus, motions @ minus)), (by_start, (minus @ motions, plus @ motions))):
                changes = [self.step_errors(values, moved)[0] for moved in ends]
                J[..., d] = (changes[0] - changes[1]) / (2 * _H)
        chi2 = (errors / sigmas) ** 2
        w = 1 / sigmas
        for group in _BY_SENSOR:
            w[:, group] *= np.sqrt(robust_weights(chi2[:, group].sum(axis=1)))[:, None]
        return w * errors, w[..., None] * by_values, w[..., None] * by_start, w[..., None] * by_end

    def level_errors(self, values: FloatArray, T: FloatArray) -> FloatArray:
        """Return height, roll and pitch (N, 3) of the base over the map's plane, at poses (N, 4, 4) of the camera."""
        T_map_base = T @ se3.invert(self.model.mount(values))
        return np.stack([T_map_base[:, 2, 3], T_map_base[:, 2, 1], -T_map_base[:, 2, 0]], axis=1)

    def _level_rows(self, values: FloatArray, T: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Whitened errors (N, 3), by the values (N, 3, P) and by each view's own pose (N, 3, 6)."""
        errors, sigmas = self.level_errors(values, T), np.array([_JOLT_M, _JOLT_RAD, _JOLT_RAD])
        by_values, by_pose = np.zeros((*errors.shape, len(values))), np.zeros((*errors.shape, 6))
        at = self.model.index("roll")
        for p in range(at, at + 6):
            h = _H * np.eye(len(values))[p]
            by_values[..., p] = (self.level_errors(values + h, T) - self.level_errors(values - h, T)) / (2 * _H)
        for d, h in enumerate(_H * np.eye(6)):
            ends = [self.level_errors(values, T @ se3.exp(sign * h)) for sign in (1, -1)]
            by_pose[..., d] = (ends[0] - ends[1]) / (2 * _H)
        chi2 = ((errors / sigmas) ** 2).sum(axis=1)
        w = np.sqrt(robust_weights(chi2))[:, None] / sigmas
        return w * errors, w[..., None] * by_values, w[..., None] * by_pose

    def _edge_rows(self, edge: RelativePose, values: FloatArray, T: FloatArray) -> _Rows:
        """Rows of an edge. The map's scale is that of the former calibration, and free."""
        i, j, at = int(edge.first), int(edge.second), self.model.index("map_scale")
        motion = se3.invert(T[i]) @ T[j]
        measured = edge.T_first_second.copy()
        measured[:3, 3] *= 1 + values[at]
        error = se3.log(motion @ se3.invert(measured))
        by_values = np.zeros((6, len(values)))
        by_values[:3, at] = -edge.T_first_second[:3, 3]
        sigma = np.maximum(_EDGE_FACTOR * np.sqrt(np.diag(edge.covariance)), _EDGE_LEAST)
        w = np.sqrt(robust_weights(np.array([((error / sigma) ** 2).sum()])))[0] / sigma
        w = w[:, None]
        return _Rows((i, j), w[:, 0] * error, w * by_values, (-w * np.eye(6), w * se3.adjoint(motion)))

    def walls_m(self, values: FloatArray, T: FloatArray) -> FloatArray:
        """Return x and y (K, 2) in the map of a sample of upright patches, those that walls consist of."""
        views, found = self._corrected(values), list[FloatArray]()
        for k in range(len(views)):
            view = views[k]
            upright = np.abs(view.normals @ T[k, 2, :3]) < _UPRIGHT
            near = upright & (view.depth_m < _PLAN_M)
            found.append(se3.apply(T[k], view.points_m[near])[:, :2])
        points = np.concatenate(found)
        return points[:: -(-len(points) // _PLAN_POINTS) or 1]

    def _normal(
        self, matches: Sequence[PatchPair], values: FloatArray, T: FloatArray, scale: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return H (P + 6N, P + 6N), g (P + 6N,), and the gradients (clusters, P + 6N) of neighbouring keyframes."""
        count, size = len(self.data.views), len(values)
        H, gradients = np.zeros((size + 6 * count,) * 2), np.zeros((_CLUSTERS, size + 6 * count))

        def add(rows: _Rows, cluster: int) -> None:
            places = [np.arange(size), *(size + 6 * v + np.arange(6) for v in rows.views)]
            J = np.concatenate([rows.by_values, *rows.by_poses], axis=1)
            at = np.concatenate(places)
            H[np.ix_(at, at)] += J.T @ J
            gradients[cluster][at] += J.T @ rows.residual

        for pair in matches:
            add(self._pair_rows(pair, values, T, scale), pair.first * _CLUSTERS // count)
        if self.model.has_mount:
            for k, on in enumerate(self.data.floors):
                if len(on) >= _FEWEST_FLOOR:
                    add(self._floor_rows(k, values), k * _CLUSTERS // count)
            r, by_values, by_pose = self._level_rows(values, T)
            for k in range(count):
                add(_Rows((k,), r[k], by_values[k], (by_pose[k],)), k * _CLUSTERS // count)
            if len(self.data.steps):
                r, by_values, by_start, by_end = self._step_rows(values, T)
                for s, (i, j) in enumerate(self.data.steps.tolist()):
                    add(_Rows((i, j), r[s], by_values[s], (by_start[s], by_end[s])), i * _CLUSTERS // count)
        for edge in self.data.edges:
            add(self._edge_rows(edge, values, T), int(edge.first) * _CLUSTERS // count)
        anchor = slice(size, size + 6)
        away = se3.log(se3.invert(self.data.T_map_camera[0]) @ T[0])
        sigma = _ANCHOR_LEVEL if self.model.has_mount else _ANCHOR
        H[anchor, anchor] += np.diag(sigma**-2)
        gradients[0][anchor] += sigma**-2 * away
        H[size:, size:] += 1e-6 * np.eye(6 * count)
        g = gradients.sum(axis=0)
        return H, g, gradients

    def _places(self) -> IntArray:
        size = len(self.free)
        return np.concatenate([np.flatnonzero(self.free), np.arange(size, size + 6 * len(self.data.views))])

    def _step(
        self, matches: Sequence[PatchPair], values: FloatArray, T: FloatArray, scale: float
    ) -> tuple[FloatArray, FloatArray]:
        H, g, _ = self._normal(matches, values, T, scale)
        size, at = len(values), self._places()
        H[:size, :size] += self.prior
        g[:size] += self.prior @ values
        change = np.zeros(len(g))
        unit = 1 / np.sqrt(np.diag(H)[at])
        change[at] = -unit * cho_solve(cho_factor(H[np.ix_(at, at)] * np.outer(unit, unit)), unit * g[at])
        return values + change[:size], T @ se3.exp(change[size:].reshape(-1, 6))

    def _covariance(self, matches: Sequence[PatchPair], values: FloatArray, T: FloatArray, scale: float) -> FloatArray:
        """(P, P): the larger of the inverse Hessian and of that about the gradients' spread (Huber 1967).

        Poses are eliminated; the prior counts as one more cluster. Parameters that are not free keep their prior.
        """
        H, _, gradients = self._normal(matches, values, T, scale)
        size, free = len(values), np.flatnonzero(self.free)
        poses = cho_factor(H[size:, size:] + 1e-9 * np.eye(len(H) - size))
        eliminated = cho_solve(poses, H[size:, free])
        reduced = H[np.ix_(free, free)] - H[size:, free].T @ eliminated
        prior = np.linalg.inv(self.model.prior[np.ix_(free, free)] + 1e-16 * np.eye(len(free)))
        inverse = np.linalg.inv(reduced + prior)
        g = gradients[:, free] - gradients[:, size:] @ eliminated
        g = g - g.mean(axis=0)
        scatter = g.T @ g * _CLUSTERS / (_CLUSTERS - 1)
        sandwich = inverse @ (scatter + prior) @ inverse
        # In each direction the larger one: few clusters may agree by chance.
        L = np.linalg.cholesky(inverse + 1e-18 * np.eye(len(free)))
        turned = np.linalg.solve(L, np.linalg.solve(L, sandwich).T)
        ratios, directions = np.linalg.eigh((turned + turned.T) / 2)
        across = L @ directions
        covariance = self.model.prior.copy()
        covariance[np.ix_(free, free)] = (across * np.maximum(ratios, 1.0)) @ across.T
        covariance[free, free] += self.model.least_sigmas[free] ** 2
        others = np.setdiff1d(np.arange(size), free)
        covariance[np.ix_(free, others)] = covariance[np.ix_(others, free)] = 0.0
        return covariance


def T_translation(T: FloatArray, a: int, b: int) -> FloatArray:
    """Return the position (3,) of view a in the frame of view b."""
    return np.asarray((se3.invert(T[b]) @ T[a])[:3, 3])


class _CorrectedViews(Sequence[Patches]):
    """Views whose points are corrected when asked for."""

    def __init__(self, views: Sequence[Patches], moved: Sequence[FloatArray], change: FloatArray) -> None:
        self._views, self._moved, self._change = views, moved, change

    def __len__(self) -> int:
        return len(self._views)

    def __getitem__(self, number: int) -> Patches:  # type: ignore[override]
        view = self._views[number]
        points = view.points_m + self._moved[number] @ self._change
        fx, fy, cx, cy = view.intrinsics
        stretch, x, y = self._change[:3]
        fx, fy = fx / (1 + stretch), fy / (1 + stretch)
        lens = np.array([fx, fy, cx - x * fx, cy - y * fy])
        return replace(view, rays=points / points[:, 2:], depth_m=points[:, 2], intrinsics=lens)

"""Rollouts by numpy, all at once: what `benchmarks.control` and a test hold the compiled ones against.

Written from what the classes in `wheelsight.navigation.rollout_values` say, not from the kernels: one look a step at
every point of the outline, instead of only where the robot may have come near.
"""

from __future__ import annotations

import numpy as np

from wheelsight.core.geometry import Float32Array, FloatArray
from wheelsight.navigation.clearance_kernels import CostField
from wheelsight.navigation.mppi_kernels import Begin, Dynamics, PathAhead, RolloutWeights


def plain_costs(
    begin: Begin,
    way: PathAhead,
    field: CostField,
    people: FloatArray,
    dynamics: Dynamics,
    weights: RolloutWeights,
    drawn: Float32Array,
) -> tuple[FloatArray, FloatArray]:
    """Costs (K,) of commands (K, T, 2), and the least clearance (K,) of each; both without people and zones."""
    rollouts, steps, _ = drawn.shape
    x, y, yaw = (np.full(rollouts, float(part)) for part in begin[:3])
    v, w = np.full(rollouts, begin.forward_m_s), np.full(rollouts, begin.turn_rad_s)
    point = np.full(rollouts, begin.point)
    costs, least = np.zeros(rollouts), np.full(rollouts, np.inf)
    edge = _edge(dynamics, field.resolution)
    for t in range(steps):
        most = way.points[point, 5]
        v = _toward(v, dynamics.share * (np.clip(drawn[:, t, 0], -most, most) - v), dynamics)
        w = w + np.clip(dynamics.share * (drawn[:, t, 1] - w), -dynamics.turn_change, dynamics.turn_change)
        half = w * dynamics.step_s / 2
        chord = v * dynamics.step_s * np.sinc(half / np.pi)
        x, y, yaw = x + chord * np.cos(yaw + half), y + chord * np.sin(yaw + half), yaw + 2 * half
        point = _advanced(way, point, x, y)
        least = np.minimum(least, _clearance(field, edge, x, y, yaw))
        costs += _step_cost(way, point, (x, y, yaw, v), drawn[:, max(t - 1, 0) : t + 1], weights) * dynamics.step_s
    along = _along(way, point, x, y)
    beyond = np.where(point == len(way.points) - 1, np.maximum(along, 0), 0)
    made = way.points[point, 4] - way.points[begin.point, 4] + along
    return costs + weights.beyond * beyond**2 - weights.progress * made, least


def _toward(v: FloatArray, change: FloatArray, dynamics: Dynamics) -> FloatArray:
    most = np.where(v * change >= 0, dynamics.speed_up, dynamics.slow_down)
    after = v + np.clip(change, -most, most)
    left = 1 - np.abs(v) / dynamics.slow_down
    beyond = np.clip(v + change, -dynamics.speed_up * left, dynamics.speed_up * left)
    return np.asarray(np.where(v * after < 0, beyond, after))


def _along(way: PathAhead, point: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    px, py, c, s = way.points[point, :4].T
    return np.asarray(way.direction * ((x - px) * c + (y - py) * s))


def _advanced(way: PathAhead, point: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    last = len(way.points) - 1
    while True:
        after = np.minimum(point + 1, last)
        moves = (after > point) & (_along(way, point, x, y) > (way.points[after, 4] - way.points[point, 4]) / 2)
        if not moves.any():
            return point
        point = point + moves


def _step_cost(
    way: PathAhead, point: FloatArray, at: tuple[FloatArray, ...], commands: Float32Array, weights: RolloutWeights
) -> FloatArray:
    x, y, yaw, v = at
    px, py, c, s = way.points[point, :4].T
    aside = (y - py) * c - (x - px) * s
    off = weights.aside_m * (np.hypot(aside, weights.aside_m) - weights.aside_m)
    cost = weights.aside * off + weights.heading * (1 - np.cos(yaw) * c - np.sin(yaw) * s)
    cost += weights.wrong_way * np.maximum(-way.direction * v, 0)
    changes = np.diff(commands.astype(float), axis=1).sum(axis=1)
    return np.asarray(cost + changes**2 @ np.array([weights.change_forward, weights.change_turn]))


def _edge(dynamics: Dynamics, spacing_m: float) -> FloatArray:
    """(N, 2) points along an outline."""
    sides = dynamics.outline.sides
    return np.concatenate([side[:2] + np.arange(0, side[4], spacing_m)[:, None] * side[2:4] for side in sides])


def _clearance(field: CostField, edge: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    u = (x[:, None] + c * edge[:, 0] - s * edge[:, 1] - field.origin[0]) / field.resolution - 0.5
    v = (y[:, None] + s * edge[:, 0] + c * edge[:, 1] - field.origin[1]) / field.resolution - 0.5
    rows, columns = field.distance_m.shape
    inside = (u >= 0) & (v >= 0) & (u < columns - 1) & (v < rows - 1)
    j, i = np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int)
    a, b, d = u - j, v - i, field.distance_m
    low, high = d[i, j] * (1 - a) + d[i, j + 1] * a, d[i + 1, j] * (1 - a) + d[i + 1, j + 1] * a
    return np.asarray(np.where(inside, low * (1 - b) + high * b, 0).min(axis=1))

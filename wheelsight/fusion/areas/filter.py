"""AreaFilter: a hidden Markov filter over the areas' adjacency, and over what the forest's answers are worth.

Hidden are three things: how good the forest is just now (a level), in which area the robot is, and which area the
frames look like: their appearance. Frames taken close together look alike and are wrong together, so the appearance
keeps while the robot has hardly moved, and is drawn anew, from the confusions of a forest of that level, about once
every `appearance_m`. A run of wrong answers thereby counts once, however many frames it has. On the last levels
appearances are drawn without regard to the area, and keep for longer or shorter ways: a forest that fails, for a while.

Against all this stands the hypothesis that the forest is worth nothing and never was: appearances drawn without regard
to the area from the first frame on. Each answer's log-likelihood ratio tells between the two (`worth`). A forest that
always answers the same, or has areas mixed up, keeps its appearances long; only those that change where areas do speak
for the forest.

Forward filtering is exact (Rabiner 1989, section III.A); `likelihoods` of `update` are what one frame says of the
area given all frames before it, which is what a filter of the position may take as a measurement without counting
anything twice.
"""

from __future__ import annotations

import numpy as np

from wheelsight.areas import AreaMap
from wheelsight.fusion.areas.settings import AreaFilterSettings
from wheelsight.geometry import FloatArray


class AreaFilter:
    """The belief over level, place and appearance; places are the A areas and, last, the floor outside them.

    Args:
        areas: in the order of the forest's probabilities.
        settings: see there.
        places: (A + 1,) probabilities of the places at the start, or None: all areas alike.
    """

    def __init__(
        self, areas: AreaMap, settings: AreaFilterSettings | None = None, places: FloatArray | None = None
    ) -> None:
        self.settings = settings or AreaFilterSettings()
        self._appearances = _appearances_of(areas, self.settings)
        self._moves = _moves_of(areas)
        start = np.append(np.full(len(areas), 1 / len(areas)), 0.0) if places is None else np.asarray(places, float)
        n_right, n_failing = len(self.settings.accuracies), len(self.settings.failing_appearances_m)
        levels = np.append(np.full(n_right, 1 / n_right), np.zeros(n_failing))
        self._n_right = n_right
        self._appearance_m = np.append(
            np.full(n_right, self.settings.appearance_m), self.settings.failing_appearances_m
        )
        self._rate_per_m, self._jumps = _level_jumps(self.settings)
        self._belief = levels[:, None, None] * start[None, :, None] * self._appearances
        self._worthless = np.full((n_failing, len(areas)), 1 / (n_failing * len(areas)))
        self._log_odds = np.log(self.settings.worth / (1 - self.settings.worth))

    @property
    def belief(self) -> FloatArray:
        """(L, A + 1, A) of level, place and appearance, if the forest is worth something; last the levels that fail."""
        return np.array(self._belief)

    @property
    def places(self) -> FloatArray:
        """(A + 1,) probabilities of the areas, and of being outside them."""
        return np.asarray(self._belief.sum(axis=(0, 2)))

    @property
    def trust(self) -> float:
        """Probability that the forest is worth something and does not fail just now."""
        return self.worth * float(self._belief[: self._n_right].sum())

    @property
    def worth(self) -> float:
        """Probability that the forest is worth something, by all its answers so far."""
        return float(1 / (1 + np.exp(-np.clip(self._log_odds, -700, 700))))

    def predict(self, way_m: float, turn_rad: float = 0.0) -> None:
        """After so much way and turn, in absolute values, the place, the level and the appearance may have changed."""
        settings = self.settings
        belief = self._belief
        left = 1 - np.exp(-way_m / settings.area_m)
        belief = (1 - left) * belief + left * np.einsum("pq,lpc->lqc", self._moves, belief)
        changed = 1 - np.exp(-way_m * self._rate_per_m)
        belief = (1 - changed) * belief + changed * np.tensordot(self._jumps, belief, axes=(0, 0))
        kept = np.exp(-(way_m + settings.appearance_per_rad_m * turn_rad) / self._appearance_m)[:, None, None]
        self._belief = kept * belief + (1 - kept) * self._appearances * belief.sum(axis=2, keepdims=True)
        kept, appearances = kept[self._n_right :, 0], self._appearances[self._n_right :, 0]
        self._worthless = kept * self._worthless + (1 - kept) * appearances * self._worthless.sum(axis=1, keepdims=True)

    def agree_with(self, places: FloatArray) -> None:
        """Take the probabilities (A + 1,) of the places from who knows better; what else is hidden keeps its own."""
        known = self._belief.sum(axis=(0, 2))
        fallback = self._belief.sum(axis=1).sum(axis=1)[:, None, None] * self._appearances
        share = np.divide(self._belief, known[None, :, None], out=fallback, where=known[None, :, None] > 1e-300)
        self._belief = share * np.asarray(places, float)[None, :, None]
        self._belief /= self._belief.sum()

    def update(self, frame_likelihood: FloatArray) -> FloatArray:
        """Take in a frame.

        Args:
            frame_likelihood: (A,) what the frame says for each appearance, p(area | frame) / p(area), up to a factor.

        Returns:
            (A + 1,) the frame's likelihood in each place, given all frames before; of mean 1 over the places.
        """
        frame_likelihood = frame_likelihood / max(frame_likelihood.mean(), 1e-300)
        frame_likelihood = (1 - self.settings.blip) * frame_likelihood + self.settings.blip
        before = self._belief.sum(axis=(0, 2))
        after = self._belief * frame_likelihood
        likelihoods = np.divide(after.sum(axis=(0, 2)), before, out=np.ones(len(before)), where=before > 1e-300)
        total = float(after.sum())
        self._belief = after / total
        worthless = self._worthless * frame_likelihood
        self._worthless = worthless / worthless.sum()
        self._log_odds += np.log(total / worthless.sum())
        return np.asarray(likelihoods / total)


def _level_jumps(settings: AreaFilterSettings) -> tuple[float, FloatArray]:
    """How often a metre a level may change, and then (L, L) to which, from row to column; it may stay."""
    n, k = len(settings.accuracies), len(settings.failing_appearances_m)
    rates = np.zeros((n + k, n + k))
    rates[:n, :n] = 1 / (settings.level_m * n)
    # A forest worth something rarely gets stuck: the longer a failure's appearance keeps, the rarer such failures are.
    rare = 1 / np.maximum(np.array(settings.failing_appearances_m) / settings.appearance_m, 1)
    rates[:n, n:] = rare / rare.sum() / settings.failure_m
    rates[n:, :n] = 1 / (settings.recovery_m * n)
    np.fill_diagonal(rates, 0.0)
    fastest = float(rates.sum(axis=1).max())
    return fastest, np.eye(n + k) + (rates - np.diag(rates.sum(axis=1))) / fastest


def _appearances_of(areas: AreaMap, settings: AreaFilterSettings) -> FloatArray:
    """(L, A + 1, A) probability of each appearance, by level and place; outside the areas any is as likely."""
    n = len(areas)
    own = np.eye(n)
    near = areas.adjacency().astype(float) - own
    far = 1 - own
    near = np.where(near.sum(axis=1, keepdims=True) > 0, near, far)
    near, far = (wrong / np.maximum(wrong.sum(axis=1, keepdims=True), 1) for wrong in (near, far))
    wrong = settings.neighbour_share * near + (1 - settings.neighbour_share) * far
    appearances = np.full((len(settings.accuracies) + len(settings.failing_appearances_m), n + 1, n), 1 / n)
    for level, accuracy in enumerate(settings.accuracies):
        appearances[level, :n] = accuracy * own + (1 - accuracy) * wrong if n > 1 else 1.0
    return appearances


def _moves_of(areas: AreaMap) -> FloatArray:
    """(A + 1, A + 1) where one gets on leaving each place: a neighbour, or outside; from outside anywhere."""
    n = len(areas)
    moves = np.ones((n + 1, n + 1)) - np.eye(n + 1)
    moves[:n, :n] = areas.adjacency().astype(float) - np.eye(n)
    return np.asarray(moves / moves.sum(axis=1, keepdims=True))

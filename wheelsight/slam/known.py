"""KnownMap: what an earlier drive has left, in which the next one finds itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.keyframes import KeyframeId, KeyframeStore
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.graph import Prior, RelativePose


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """Keyframes of before, and what is known of where they are.

    Attributes:
        store: has them; those of the drive that begins are added.
        recognizer: knows all of them that can be recognised.
        edges: between them; none of a map that is to stay as it is.
        T_map_camera: (4, 4) where the camera begins, as somebody says; None: it is to be recognised.
        covariance: (6, 6) of the left perturbation (v, ω) of that.
    """

    store: KeyframeStore
    recognizer: Recognizer
    edges: tuple[RelativePose, ...] = ()
    T_map_camera: FloatArray | None = None
    covariance: FloatArray | None = None

    @property
    def start(self) -> tuple[FloatArray, FloatArray] | None:
        """Where the camera begins, and how sure that is; None where nobody says."""
        if self.T_map_camera is None or self.covariance is None:
            return None
        return self.T_map_camera, self.covariance

    def priors(self, sigma_fixed: float, sigma_m: float, sigma_rad: float) -> list[Prior]:
        """What holds its keyframes where they are: all but exactly, or as loosely as they may still move.

        One that damage took has no pose: it lies anywhere, and nothing hangs on it.
        """
        sigmas = [sigma_m] * 3 + [sigma_rad] * 3 if self.edges else [sigma_fixed] * 6
        C, T = np.diag(np.square(sigmas)), np.array(self.store.T_map_keyframe)
        T[~np.isfinite(T).all(axis=(1, 2))] = np.eye(4)
        return [Prior(KeyframeId(number), T_map_keyframe, C) for number, T_map_keyframe in enumerate(T)]

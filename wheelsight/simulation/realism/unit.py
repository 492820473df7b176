"""One unit of a camera: its lens, its registration, its distortion of depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wheelsight.geometry import ByteArray, Float32Array, FloatArray
from wheelsight.simulation.cameras import CameraModel
from wheelsight.simulation.depth_sensors import StructuredLight, TimeOfFlight
from wheelsight.simulation.realism.depth_distortion import (
    DepthDistortion,
    DisparityDistortion,
    DisparityDistortionSettings,
    PhaseDistortion,
    PhaseDistortionSettings,
)
from wheelsight.simulation.realism.lens import Lens, ideal_lens, lens_of
from wheelsight.simulation.realism.pixels import as_delivered
from wheelsight.simulation.realism.presets import Realism, stream
from wheelsight.simulation.realism.registration import Registration
from wheelsight.simulation.view import View


@dataclass(frozen=True, slots=True, eq=False)
class CameraUnit:
    """A camera of a model, with the errors that its seed gives it.

    Attributes:
        model: in the size wanted.
        lens: the true one, and the calibrated one.
        realism: the parts, or None where there are no errors but the sensors' noise.
        registration: of depth to colour, or None where it is exact.
        seed: of the unit.
    """

    model: CameraModel
    lens: Lens
    realism: Realism | None
    registration: Registration | None
    seed: int

    def distortion(self, scattered: FloatArray) -> DepthDistortion | None:
        """Of depth, among geoms that scatter the shares (G,) of infrared light; None where there is none."""
        if self.realism is None:
            return None
        rng = stream(self.seed, "depth distortion")
        if isinstance(self.model.depth, StructuredLight):
            return DisparityDistortion(DisparityDistortionSettings(), self.lens.true, rng)
        if isinstance(self.model.depth, TimeOfFlight):
            return PhaseDistortion(PhaseDistortionSettings(), self.lens.true, scattered, rng)
        return None

    def seen_by_depth(
        self,
        view: View,
        sun: Float32Array | None,
        distortion: DepthDistortion | None,
        twist: FloatArray,
        stamp_s: float,
    ) -> View:
        """What the depth sensor has to measure, whose colour image shows `view`, in sunlight `sun` (H, W)."""
        if self.registration is None or self.realism is None:
            return view
        seen = self.registration.seen_by_depth(view, twist, stamp_s)
        depth_m = seen.depth_m if distortion is None else distortion.distorted(seen)
        geom = seen.geom
        if sun is not None:
            blinded = sun > self.realism.sunlight.blinds_from
            depth_m, geom = np.where(blinded, np.float32(0), depth_m), np.where(blinded, np.int32(-1), geom)
        return View(depth_m, geom, seen.normal_world, seen.T_world_camera, seen.rays)

    def delivered(self, color: ByteArray) -> ByteArray:
        """A colour image (H, W, 3) as the host gets it."""
        return color if self.realism is None else as_delivered(color, self.realism.pixels)


def unit_of(model: CameraModel, realism: Realism | None, seed: int) -> CameraUnit:
    """The unit of a camera that a seed gives. A model without noise has no errors of its own either."""
    if realism is None or model.is_exact:
        return CameraUnit(model, ideal_lens(model.camera), None, None, seed)
    lens = lens_of(model.camera, realism.lens, stream(seed, "lens"))
    registration = Registration(realism.registration, model.camera.width, stream(seed, "registration"))
    return CameraUnit(model, lens, realism, registration, seed)

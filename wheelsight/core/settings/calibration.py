"""Settings of `wheelsight_calibration`, which stand here because a `config.yaml` has them too."""

from __future__ import annotations

from wheelsight.core.settings import CHOSEN, Settings, setting


class RefusalSettings(Settings):
    """Limits of an accepted calibration."""

    least_cover: float = setting(
        0.25,
        "share of the image's 8 × 6 cells that hold corners; boards only in the middle do not determine the rest",
        "Kinect v1's board of Herrera et al., 21 views",
        gt=0,
        le=1,
    )
    focal_sigma: float = setting(0.01, "standard deviation, as a share of the focal length", CHOSEN, gt=0, le=1)
    centre_sigma_px: float = setting(10.0, "of the colour camera's centre, of an image of 640 px", CHOSEN, gt=0, le=500)
    apart_sigma_m: float = setting(0.015, "of the position between both cameras, each axis", CHOSEN, gt=0, le=1)
    apart_sigma_deg: float = setting(1.5, "of the rotation between both cameras, each axis", CHOSEN, gt=0, le=90)
    depth_sigma_m: float = setting(
        0.02, "of depth anywhere between the nearest and the farthest board", CHOSEN, gt=0, le=1
    )


class CoachSettings(Settings):
    """Views that a live calibration asks for."""

    enough: int = setting(20, "number of views", "found on simulated boards alone", ge=3, le=1000)


class CameraCalibrationSettings(Settings):
    """Settings of `wheelsight calibrate camera`."""

    refusal: RefusalSettings = RefusalSettings()
    coach: CoachSettings = CoachSettings()


class FloorRangeSettings(Settings):
    """Where the floor is searched."""

    farthest_m: float = setting(5.0, "largest depth; beyond, errors outweigh the information", CHOSEN, gt=0, le=100)
    highest_m: float = setting(3.0, "largest height of a camera over the floor", CHOSEN, gt=0, le=100)


class MountSigmaSettings(Settings):
    """Largest standard deviations of an accepted mount."""

    most_uncertain_deg: float = setting(1.0, "of angles: as a protractor measures", CHOSEN, gt=0, le=90)
    most_uncertain_m: float = setting(0.02, "of positions: as a tape measure does", CHOSEN, gt=0, le=10)
    most_uncertain_s: float = setting(0.02, "of the delay", CHOSEN, gt=0, le=10)


class ExtrinsicsSettings(Settings):
    """Settings of `calibrate_base`."""

    floor: FloorRangeSettings = FloorRangeSettings()
    drive: MountSigmaSettings = MountSigmaSettings()

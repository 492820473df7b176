"""The same trajectory told of the robot's base or of its camera."""

from __future__ import annotations

from wheelsight.calibration import Calibration
from wheelsight.errors import CalibrationError
from wheelsight.geometry import se3
from wheelsight.trajectory import Trajectory


def express_for(body: str, trajectory: Trajectory, calibration: Calibration) -> Trajectory:
    """T_frame_body for `body`, "base" or "camera", of a trajectory that describes either.

    Covariances stay as they are: they perturb from the left, in the map, whatever the body.

    Raises:
        CalibrationError: the two differ and the calibration has no T_base_camera to join them.
    """
    if trajectory.body == body:
        return trajectory
    T_base_camera = calibration.T_base_camera
    if T_base_camera is None or {trajectory.body, body} != {"base", "camera"}:
        raise CalibrationError(
            f"a trajectory of {trajectory.body!r} cannot be told for {body!r}", fix="give T_base_camera"
        )
    T_old_new = T_base_camera if body == "camera" else se3.invert(T_base_camera)
    T_frame_body = se3.compose(trajectory.T_frame_body, T_old_new)
    return Trajectory(trajectory.stamps_s, T_frame_body, trajectory.covariances, body, trajectory.frame)

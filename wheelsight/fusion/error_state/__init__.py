"""The default filter: wheels, camera, gyroscope and places joined into one pose with its covariance."""

from wheelsight.fusion.error_state._mixture import covering_pose
from wheelsight.fusion.error_state.estimate import STEP_BEGIN, FrameUpdate, FusedEstimate
from wheelsight.fusion.error_state.filter import ErrorStateFilter
from wheelsight.fusion.error_state.settings import ErrorStateSettings

__all__ = ["STEP_BEGIN", "ErrorStateFilter", "ErrorStateSettings", "FrameUpdate", "FusedEstimate", "covering_pose"]

"""Settings of parts that stand below `Config`: each with its unit, its bounds, and why it is what it is.

What an odometry, a map or a filter goes by stands beside it; here is what a localizer and a run in real time go by,
and by what places are recognised.
"""

from wheelsight.settings.base import ASKED, CHOSEN, ON_SIMULATOR, Settings, bounds, conflict, setting
from wheelsight.settings.live_camera import LiveCameraSettings
from wheelsight.settings.live_page import LivePageSettings
from wheelsight.settings.localizer import (
    BaseCheckSettings,
    ColorCheckSettings,
    FrameGateSettings,
    LocalizerSettings,
)
from wheelsight.settings.real_time import RealTimeSettings
from wheelsight.settings.recognition import FernSettings, PlaceVerificationSettings, RecognitionSettings, WordSettings
from wheelsight.settings.recorder import RecorderSettings
from wheelsight.settings.viewer import ViewerSettings

__all__ = [
    "ASKED",
    "CHOSEN",
    "ON_SIMULATOR",
    "BaseCheckSettings",
    "ColorCheckSettings",
    "FernSettings",
    "FrameGateSettings",
    "LiveCameraSettings",
    "LivePageSettings",
    "LocalizerSettings",
    "PlaceVerificationSettings",
    "RealTimeSettings",
    "RecognitionSettings",
    "RecorderSettings",
    "Settings",
    "ViewerSettings",
    "WordSettings",
    "bounds",
    "conflict",
    "setting",
]

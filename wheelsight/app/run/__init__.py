"""Runs and drives, from events to a folder of results, and their records."""

from wheelsight.app.run.kernels import InRealTime
from wheelsight.app.run.loops import CORRECTED_FILE
from wheelsight.app.run.maps import MAP_FILE
from wheelsight.app.run.realtime import RealTimeRecording, in_real_time
from wheelsight.app.run.run_record import (
    AreaObservation,
    FrameDrops,
    FrameRecord,
    MapErrors,
    MapPicture,
    MapRecord,
    MatchPicture,
    RealTimeRecord,
    RectificationRecord,
    RunRecord,
)
from wheelsight.app.run.run_source import LiveSensors, LiveSource, default_odometry, resolved
from wheelsight.app.run.runs import run_each
from wheelsight.app.run.verdict import (
    Evidence,
    Finding,
    RunVerdict,
    Tone,
    best_alone_of,
    evidence_of,
    facts_of,
    judge,
    verdict_of,
    verdict_of_run,
)
from wheelsight.estimation.odometry_choice import Choice

__all__ = [
    "CORRECTED_FILE",
    "MAP_FILE",
    "AreaObservation",
    "Choice",
    "Evidence",
    "Finding",
    "FrameDrops",
    "FrameRecord",
    "InRealTime",
    "LiveSensors",
    "LiveSource",
    "MapErrors",
    "MapPicture",
    "MapRecord",
    "MatchPicture",
    "RealTimeRecord",
    "RealTimeRecording",
    "RectificationRecord",
    "RunRecord",
    "RunVerdict",
    "Tone",
    "best_alone_of",
    "default_odometry",
    "evidence_of",
    "facts_of",
    "in_real_time",
    "judge",
    "resolved",
    "run_each",
    "verdict_of",
    "verdict_of_run",
]

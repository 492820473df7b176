"""From events to a folder of results: track, compare, write; and the records of what was learned."""

from wheelsight.localizer.choice import Choice
from wheelsight.pipeline.choice import default_odometry, resolved
from wheelsight.pipeline.joined import FLAGS, BestAlone, JoinedFacts, best_alone_of, facts_of, joined_of
from wheelsight.pipeline.live_source import LiveSensors, LiveSource
from wheelsight.pipeline.loops import CORRECTED_FILE, CorrectionRecord
from wheelsight.pipeline.map_record import MapPicture, MapRecord
from wheelsight.pipeline.maps import MAP_FILE
from wheelsight.pipeline.outputs import PAGE_FILE
from wheelsight.pipeline.realtime import RealTimeRecording, in_real_time
from wheelsight.pipeline.realtime_record import RealTimeRecord
from wheelsight.pipeline.rectification_record import Look, MapErrors, RectificationRecord
from wheelsight.pipeline.rehearses import InRealTime
from wheelsight.pipeline.run_record import FrameDrops, FrameRecord, MatchPicture, RunRecord
from wheelsight.pipeline.runs import run_each
from wheelsight.pipeline.verdict import Evidence, Finding, Tone, Verdict, evidence_of, judge, verdict_of, verdict_of_run

__all__ = [
    "CORRECTED_FILE",
    "FLAGS",
    "MAP_FILE",
    "PAGE_FILE",
    "BestAlone",
    "Choice",
    "CorrectionRecord",
    "Evidence",
    "Finding",
    "FrameDrops",
    "FrameRecord",
    "InRealTime",
    "JoinedFacts",
    "LiveSensors",
    "LiveSource",
    "Look",
    "MapErrors",
    "MapPicture",
    "MapRecord",
    "MatchPicture",
    "RealTimeRecord",
    "RealTimeRecording",
    "RectificationRecord",
    "RunRecord",
    "Tone",
    "Verdict",
    "best_alone_of",
    "default_odometry",
    "evidence_of",
    "facts_of",
    "in_real_time",
    "joined_of",
    "judge",
    "resolved",
    "run_each",
    "verdict_of",
    "verdict_of_run",
]

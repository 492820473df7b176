"""From a recording to a folder of results: track, compare, write."""

from wheelsight.pipeline.choice import Choice, default_odometry
from wheelsight.pipeline.maps import MAP_FILE
from wheelsight.pipeline.realtime import RealTimeRecording, in_real_time
from wheelsight.pipeline.runs import run, run_each

__all__ = ["MAP_FILE", "Choice", "RealTimeRecording", "default_odometry", "in_real_time", "run", "run_each"]

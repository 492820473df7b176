"""From a recording to a folder of results: track, compare, write."""

from wheelsight.pipeline.maps import MAP_FILE
from wheelsight.pipeline.runs import run, run_each

__all__ = ["MAP_FILE", "run", "run_each"]

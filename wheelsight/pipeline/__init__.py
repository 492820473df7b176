"""From a recording to a folder of results: track, compare, write."""

from wheelsight.pipeline.runs import run, run_each

__all__ = ["run", "run_each"]

"""Entry points: runs, drives, the live page, reports, batches, exports and the command line."""

__all__: list[str] = []

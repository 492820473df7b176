"""What people start: runs, drives, the page, reports, batches, exports, and the command line."""

__all__: list[str] = []

"""Entry points: runs, drives, the live page, reports and the command line."""

__all__: list[str] = []

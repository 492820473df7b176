"""Calibration of RGB-D cameras by a board: lenses, where they sit, and what depth is off by."""

__all__: list[str] = []

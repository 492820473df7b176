"""Core: messages, calibration, geometry, files, inputs, settings and errors, which every other part imports."""

__all__: list[str] = []

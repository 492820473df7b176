"""Dense odometry: every pixel of depth and grey, aligned with an earlier frame or with what a map predicts."""

__all__: list[str] = []

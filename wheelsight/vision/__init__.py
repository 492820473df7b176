"""How far the camera or the robot moved: one way of telling it a sub-package."""

__all__: list[str] = []

"""How far the camera or the robot moved: one way of telling it a sub-package."""

"""Rotations in space by their usual names; `se3` has the functions, beside those of rigid motions."""

from wheelsight.core.geometry.se3 import angle, hat, left_jacobian, to_quaternion
from wheelsight.core.geometry.se3 import nearest_rotation as nearest
from wheelsight.core.geometry.se3 import rotation as exp
from wheelsight.core.geometry.se3 import rotation_of_quaternion as from_quaternion
from wheelsight.core.geometry.se3 import rotation_vector as log

__all__ = ["angle", "exp", "from_quaternion", "hat", "left_jacobian", "log", "nearest", "to_quaternion"]

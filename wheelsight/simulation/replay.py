"""A camera that is carried along a known way, as by hand, through a simulated world: no robot, no wheels."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from wheelsight.errors import ConfigError
from wheelsight.extras import needed
from wheelsight.geometry import se3, so3
from wheelsight.simulation.cameras import camera_model
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.realism import Carriage
from wheelsight.simulation.renderer import Renderer
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.simulated_recording import SimulatedRecording
from wheelsight.simulation.world import World
from wheelsight.simulation.worlds import build_world
from wheelsight.trajectory import Trajectory

_PERIOD_S = 0.005


def replay(
    settings: SimulationSettings, T_world_camera: Trajectory, world: World | None = None, *, smooth_s: float = 0.02
) -> SimulatedRecording:
    """A recording by a camera that moves as another one did; its stamps begin at 0 s.

    Args:
        settings: world, camera, size, rate, seed, realism, and `duration_s`, which may end it early. There is no robot:
            nothing drives, and the mount is exact.
        T_world_camera: the way, in the world: x and y on the floor, z up.
        world: in place of the one the settings name.
        smooth_s: deviation of the Gaussian that takes the jitter of the system that measured the way out of it; 1 mm of
            it from one pose of 100 Hz to the next is 0.1 m/s that was not. 0 leaves the way as it is.

    Raises:
        ConfigError: an unknown world or camera, a way too short for a frame, or MuJoCo is missing.
    """
    needed("mujoco")
    if len(T_world_camera) < 2:
        raise ConfigError(f"a way of {len(T_world_camera)} poses has no motion", fix="give a trajectory of a recording")
    if world is None:
        world = build_world(settings.world, settings.seed, settings.day, has_leaves=settings.doors > 0)
    way = _smoothed(T_world_camera, settings.duration_s, smooth_s)
    T_base_camera = settings.robot.T_base_camera
    T_world_base = se3.compose(way.T_frame_body, se3.invert(T_base_camera))
    drive = Drive(Trajectory(way.stamps_s, T_world_base, body="base"), ())
    model = camera_model(settings.camera, settings.size)
    renderer = Renderer(world, drive, settings, model, Carriage(drive.truth, T_base_camera))
    return SimulatedRecording(settings, world, drive, renderer)


def _smoothed(way: Trajectory, duration_s: float | None, smooth_s: float) -> Trajectory:
    """The way from 0 s on, every 5 ms."""
    whole_s = way.duration_s if duration_s is None else min(way.duration_s, duration_s)
    stamps_s = np.asarray(_PERIOD_S * np.arange(int(whole_s / _PERIOD_S + 1e-9) + 1), np.float64)
    T = way.at((stamps_s + way.stamps_s[0]).clip(None, way.stamps_s[-1]))
    if smooth_s <= 0:
        return Trajectory(stamps_s, T, body="camera")
    quaternions = so3.to_quaternion(T[:, :3, :3])
    # q and -q are one rotation: each takes the sign that is nearer to the one before.
    signs = np.where(np.einsum("ni,ni->n", quaternions[1:], quaternions[:-1]) < 0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(signs)[:, None]
    sigma = smooth_s / _PERIOD_S
    positions = gaussian_filter1d(T[:, :3, 3], sigma, axis=0, mode="nearest")
    quaternions = gaussian_filter1d(quaternions, sigma, axis=0, mode="nearest")
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return Trajectory(stamps_s, se3.from_quaternion(positions, quaternions), body="camera")

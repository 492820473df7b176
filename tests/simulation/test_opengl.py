"""Rays against MuJoCo's own OpenGL renderer, an implementation of its own of the same scene."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_rooms import looking, room

from wheelsight.core.geometry import PinholeCamera
from wheelsight_sim.scene import Scene
from wheelsight_sim.world import World
from wheelsight_sim.worlds import build_world

CAMERA = PinholeCamera(320, 240, 260, 260, 159.5, 119.5)
NEAR_M, FAR_M = 0.1, 40.0
PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri"

# In a process of its own: MUJOCO_GL is read when mujoco is imported.
RENDER = """
import sys
import numpy as np
try:
    import mujoco
    folder = sys.argv[1]
    model = mujoco.MjModel.from_xml_path(folder + "/world.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, 240, 320)
except Exception as error:
    print(type(error).__name__, error, file=sys.stderr)
    sys.exit(77)
renderer.enable_depth_rendering()
depths = []
for index in range(model.ncam):
    renderer.update_scene(data, camera=index)
    depths.append(renderer.render().copy())
np.save(folder + "/depth.npy", np.array(depths))
renderer.close()
"""


def with_cameras(world: World, poses: list[np.ndarray]) -> str:
    """The world's MJCF with OpenGL cameras at poses T_world_camera: those look along -z and have y up."""
    fovy = np.degrees(2 * np.arctan(CAMERA.height / 2 / CAMERA.fy))
    cameras = ""
    for T in poses:
        axes = " ".join(f"{x:.12f}" for x in (*T[:3, 0], *-T[:3, 1]))
        at = " ".join(f"{x:.12f}" for x in T[:3, 3])
        cameras += f'<camera pos="{at}" xyaxes="{axes}" fovy="{fovy:.12f}"/>'
    head, tail = world.mjcf.rsplit("</worldbody>", 1)
    # Near and far planes are multiples of the model's extent; round solids are drawn as polyhedra.
    planes = f'<map znear="{NEAR_M}" zfar="{FAR_M}"/><quality numslices="200" numstacks="200"/>'
    view = f'<statistic extent="1"/><visual>{planes}</visual>'
    return f"{head}{cameras}</worldbody>{tail.replace('</mujoco>', view + '</mujoco>')}"


def opengl_depth(folder: Path, mjcf: str) -> np.ndarray:
    """(C, 240, 320) depth in metres; skips, or fails where WHEELSIGHT_REQUIRE_EGL=1, if there is no EGL."""
    (folder / "world.xml").write_text(mjcf)
    environment = os.environ | {"MUJOCO_GL": "egl"}
    done = subprocess.run(
        [sys.executable, "-c", RENDER, str(folder)], env=environment, capture_output=True, text=True, timeout=120
    )
    if done.returncode == 77:
        last = done.stderr.strip().splitlines()[-1]
        message = f"no OpenGL by EGL ({last}); install Debian's packages {PACKAGES}"
        if os.environ.get("WHEELSIGHT_REQUIRE_EGL") == "1":
            pytest.fail(message)
        pytest.skip(message)
    assert done.returncode == 0, done.stderr
    return np.load(folder / "depth.npy")


SOLIDS = room(
    '<geom name="floor" type="plane" size="30 30 1"/>'
    '<geom name="box" type="box" pos="3 0.6 0.6" size="0.4 0.3 0.6" euler="10 20 30"/>'
    '<geom name="ball" type="sphere" pos="2.5 -0.7 1.1" size="0.35"/>'
    '<geom name="can" type="cylinder" pos="4 -0.2 0.9" size="0.3 0.6" euler="20 0 0"/>'
    '<geom name="pill" type="capsule" pos="3.5 -1.6 0.9" size="0.25 0.4" euler="0 50 0"/>'
    '<geom name="egg" type="ellipsoid" pos="3.5 1.7 1" size="0.3 0.5 0.7"/>'
    '<geom name="back" type="box" pos="8 0 1" size="0.1 9 5"/>'
)
SOLID_POSES = [looking(z=1.2), looking(0.5, -1, 1.5, 0.4, 0.3), looking(6, 2, 0.7, -2.5, -0.1)]
FLOOR_POSES = [
    looking(4.0, 1.4, 0.9, 0.0, 0.1),
    looking(39.7, 10.0, 0.9, 1.6, 0.1),
    looking(30.0, 20.6, 0.9, 3.0, 0.1),
    looking(21.8, 18.0, 0.9, -2.0, 0.1),
    looking(1.2, 8.0, 0.9, -1.5, 0.1),
]


def disagreement(world: World, poses: list[np.ndarray], folder: Path) -> np.ndarray:
    """(N,) relative differences of depth away from edges, where both see something nearer than the far plane."""
    scene, all_errors = Scene(world), []
    for T, drawn_m in zip(poses, opengl_depth(folder, with_cameras(world, poses)), strict=True):
        view = scene.cast(CAMERA, T)
        smooth = np.zeros(view.geom.shape, bool)
        smooth[2:-2, 2:-2] = True
        for axis in (0, 1):
            for shift in (-2, -1, 1, 2):
                n = np.roll(view.normal_world, shift, axis)
                smooth &= (np.roll(view.geom, shift, axis) == view.geom) & ((n * view.normal_world).sum(-1) > 0.9)
        ray_world = np.einsum("ij,rcj->rci", T[:3, :3], view.rays)
        across = np.abs((ray_world * view.normal_world).sum(-1)) / np.linalg.norm(ray_world, axis=-1)
        # On grazing surfaces a hundredth of a pixel is more than a thousandth of the depth.
        smooth &= (across > 0.1) & (view.geom >= 0) & (view.depth_m < 0.9 * FAR_M)
        assert smooth.mean() > 0.4
        all_errors.append(np.abs(view.depth_m - drawn_m)[smooth] / view.depth_m[smooth])
    return np.concatenate(all_errors)


def test_rays_see_the_solids_that_opengl_draws(tmp_path: Path) -> None:
    error = disagreement(SOLIDS, SOLID_POSES, tmp_path)
    assert error.max() < 5e-4
    assert np.median(error) < 1e-6


def test_rays_see_the_floor_that_opengl_draws(tmp_path: Path) -> None:
    error = disagreement(build_world("floor4", 3), FLOOR_POSES, tmp_path)
    assert error.max() < 5e-4
    assert np.median(error) < 1e-6

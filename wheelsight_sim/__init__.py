"""A wheelchair with a depth camera on a building floor: recordings with truth, from MuJoCo (extra `sim`).

All in one: `write_simulation(simulate(SimulationSettings(world="floor4")), folder)`. Without a disk:
`run(simulate(settings), Config(), out)`.
"""

from wheelsight_sim.cameras import CameraModel, CameraUnit, Carriage, camera_model, camera_names, carriage_of, unit_of
from wheelsight_sim.drivers import ManualVelocities, StopAndTurn, follow_route, read_manual_velocities
from wheelsight_sim.frames import Renderer
from wheelsight_sim.physics import simulate_drive
from wheelsight_sim.robot import Drive, Patch, RobotModel, WheelFaults
from wheelsight_sim.scene import Geoms, Scene, View
from wheelsight_sim.settings import Realism, RealismName, SimulationSettings, realism_names, realism_of, stream
from wheelsight_sim.simulate import simulate, write_simulation
from wheelsight_sim.simulated_recording import SimulatedRecording, replay
from wheelsight_sim.simulator import Simulator
from wheelsight_sim.world import Surface, World
from wheelsight_sim.worlds import FloorPlan, build_world, world_names

__all__ = [
    "CameraModel",
    "CameraUnit",
    "Carriage",
    "Drive",
    "FloorPlan",
    "Geoms",
    "ManualVelocities",
    "Patch",
    "Realism",
    "RealismName",
    "Renderer",
    "RobotModel",
    "Scene",
    "SimulatedRecording",
    "SimulationSettings",
    "Simulator",
    "StopAndTurn",
    "Surface",
    "View",
    "WheelFaults",
    "World",
    "build_world",
    "camera_model",
    "camera_names",
    "carriage_of",
    "follow_route",
    "read_manual_velocities",
    "realism_names",
    "realism_of",
    "replay",
    "simulate",
    "simulate_drive",
    "stream",
    "unit_of",
    "world_names",
    "write_simulation",
]

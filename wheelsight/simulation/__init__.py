"""A wheelchair with a depth camera on a building floor: recordings with truth, from MuJoCo (extra `sim`).

All in one: `write_simulation(simulate(SimulationSettings(world="floor4")), folder)`. Without a disk:
`run(simulate(settings), Config(), out)`. Every step by hand: `build_world`, `simulate_drive`, `Renderer`.
"""

from wheelsight.simulation.cameras import CameraModel, camera_model, camera_names
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.drivers import ManualVelocities, StopAndTurn, follow_route, read_manual_velocities
from wheelsight.simulation.physics import simulate_drive
from wheelsight.simulation.renderer import Renderer
from wheelsight.simulation.replay import replay
from wheelsight.simulation.robot import Patch, Robot, WheelFaults
from wheelsight.simulation.scene import Scene
from wheelsight.simulation.settings import SimulationSettings
from wheelsight.simulation.simulate import simulate, write_simulation
from wheelsight.simulation.simulated_recording import SimulatedRecording
from wheelsight.simulation.simulator import Simulator
from wheelsight.simulation.view import Geoms, View
from wheelsight.simulation.world import Surface, World
from wheelsight.simulation.worlds import build_world, world_names
from wheelsight.simulation.worlds.floor_plan import FloorPlan

__all__ = [
    "CameraModel",
    "Drive",
    "FloorPlan",
    "Geoms",
    "ManualVelocities",
    "Patch",
    "Renderer",
    "Robot",
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
    "follow_route",
    "read_manual_velocities",
    "replay",
    "simulate",
    "simulate_drive",
    "world_names",
    "write_simulation",
]

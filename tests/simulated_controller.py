"""The simulated wheel controller, under its old name."""

from benchmarks.simulated_controller import PERIOD_S as PERIOD_S
from benchmarks.simulated_controller import WATCHDOG_S as WATCHDOG_S
from benchmarks.simulated_controller import SimulatedController as SimulatedController

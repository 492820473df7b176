"""`Simulator`, a simulated `Robot` in a `LiveWorld` with people and doors; `SimulatedCamera` renders its frames."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import shapely

from wheelsight.core.calibration import Calibration
from wheelsight.core.drive_model import DriveModel, DriveResponse
from wheelsight.core.errors import ArgumentError, ConfigError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand
from wheelsight.core.robots import STOPPED, Duties, RobotLimits, VelocityControl, WheelControlSettings
from wheelsight.core.runtime import needed
from wheelsight.core.threads import Closing, OneCaller, one_at_a_time
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim.body_motion import LiveBodyMotion, mounted
from wheelsight_sim.cameras import Carriage, camera_model, unit_of
from wheelsight_sim.doors import LiveDoors
from wheelsight_sim.drivers import COMMAND_PERIOD_S
from wheelsight_sim.faults import Covered
from wheelsight_sim.frames import FrameMaker, Surroundings, camera_calibration, times_of
from wheelsight_sim.people import RADIUS_M, STEP_S, LivePassersby, LivePeopleSettings
from wheelsight_sim.physics import TRUTH_PERIOD_S, Reading, SteppedRobot, floor_of, poses_of, start_of, ticks_of
from wheelsight_sim.readings import Delays
from wheelsight_sim.robot import Motors, outline_at
from wheelsight_sim.settings import SimulationSettings, realism_of, stream
from wheelsight_sim.simulate import world_of
from wheelsight_sim.simulated_recording import as_owned
from wheelsight_sim.world import World

PERIOD_S = 0.05
LONGEST_S = 4 * 3600.0

_FALLEN = 0.7  # cosine of the tilt beyond which a chair falls over


class Simulator(Closing, OneCaller):
    """A simulated `Robot`: each step executes a command for one control period, and returns the events of that period.

    Time stands still between steps. The control loop of a real robot holds the wheel speeds, with encoders as it reads
    them and motors with a lag. Frames are rendered in the step of their last row, with all effects of recorded drives.
    Events with a later stamp than a pending frame wait for it, so that events come in the order of stamps. Equal
    arguments and commands give identical events.

    The simulator ignores settings of a route or driver: laps, speed, duration, direction, velocities. People and doors
    react to the robot. People are not solid: a robot drives through them, and `contacts` lists it.

    `settings` name world, camera, robot, faults, people, doors, realism and seed; `world` replaces theirs. `start` is
    x, y in metres and yaw in radians of the base in `map`, or None for the world's own. A step lasts `period_s`, a
    multiple of 5 ms. By a `drive` model the wheels follow the limited commands.

    Raises:
        ConfigError: for the errors of `simulate`, an occupied start, or an invalid period.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        *,
        start: tuple[float, float, float] | None = None,
        world: World | None = None,
        people: LivePeopleSettings | None = None,
        limits: RobotLimits | None = None,
        control: WheelControlSettings | None = None,
        period_s: float = PERIOD_S,
        has_camera: bool = True,
        threads: int = 1,
        drive: DriveModel | None = None,
    ) -> None:
        needed("mujoco")
        steps = round(period_s / TRUTH_PERIOD_S) if np.isfinite(period_s) else 0
        if not (1 <= steps <= 1000 and abs(steps * TRUTH_PERIOD_S - period_s) < 1e-9):
            raise ConfigError(f"period_s is {period_s}", fix=f"a multiple of {TRUTH_PERIOD_S} s, up to 5 s")
        self._steps = steps
        self.settings, self._has_camera = settings, has_camera
        self._live = LiveWorld(settings, start, world, people)
        self._robot = SteppedRobot(
            self._live.world,
            settings.robot,
            self._live.T_world_start,
            faults=settings.faults,
            slip=settings.has_slip,
            seed=settings.day_seed,
            floor=floor_of(self._live.world, realism_of(settings.realism), settings.seed),
            doors=self._live.doors,
        )
        self._camera = SimulatedCamera(self._live.surroundings, settings, LONGEST_S, threads)
        self._calibration = replace(as_owned(settings, self._camera.calibration), drive_model=drive)
        assert self._calibration.wheels is not None
        self._response = None if drive is None else DriveResponse(drive)
        self._half_track_m = self._calibration.wheels.track_width_m / 2
        self._control = VelocityControl(self._calibration.wheels, limits, control, drive)
        realism, seed = realism_of(settings.realism), settings.day_seed
        self._motors = Motors(rng=None if realism is None else stream(settings.seed, "motors"))
        stamps = None if realism is None else realism.stamps
        self._wheel_delays = Delays(stamps, stream(seed, "live wheel stamps"))
        self._gyro_delays = Delays(stamps, stream(seed, "live gyro stamps"))
        self._waiting: list[tuple[float, int, Event]] = []
        self._order = count()
        self._broken, self._is_closed = "", False

    @property
    def world(self) -> World:
        """The world without people."""
        return self._live.world

    @property
    def calibration(self) -> Calibration:
        """The calibration by the robot's owner, as in recordings."""
        return self._calibration

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self._robot.time_s

    @property
    def wheels_rad(self) -> FloatArray:
        """(2,) true angles of the left and right wheel since the start."""
        return self._robot.chair.wheels_rad

    @property
    def now_s(self) -> float:
        """`time_s`; see `Robot.now_s`."""
        return self.time_s

    @property
    def stop_reason(self) -> str:
        """See `Robot.stop_reason`."""
        return self._broken or self._control.reason

    @property
    def T_world_base(self) -> FloatArray:
        """(4, 4) true present pose, for evaluation."""
        return self._robot.chair.T_world_base

    @property
    def T_world_camera(self) -> FloatArray:
        """(4, 4) true pose of the last 5 ms, for evaluation."""
        return self._camera.T_world_camera

    @property
    def people_m(self) -> FloatArray:
        """(N, 2) true positions of people, metres, for evaluation."""
        return self._live.people_at(self.time_s)

    def clearance_m(self, T_world_base: FloatArray | None = None) -> float:
        """True distance from the robot's outline, here or at (4, 4), to the nearest thing, or door; not people."""
        return self._live.clearance_m(self.T_world_base if T_world_base is None else T_world_base, self.time_s)

    def people_clearance_m(self) -> float:
        """True distance from the robot's outline to the nearest person's."""
        return self._live.people_clearance_m(self.T_world_base, self.time_s)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """All contacts of the robot so far, each at its begin, for evaluation."""
        return tuple(self._live.contacts)

    @property
    def contact(self) -> Contact | None:
        """The last contact, or None."""
        return self._live.contacts[-1] if self._live.contacts else None

    @one_at_a_time
    def step(self, command: VelocityCommand) -> list[Event]:
        """Execute a command for one control period, and return its events in the order of stamps.

        Raises:
            ArgumentError: the simulator is closed, or has run for four hours.
        """
        if self._is_closed or self.time_s >= LONGEST_S:
            problem = "is closed" if self._is_closed else f"has run for {LONGEST_S:g} s"
            raise ArgumentError(f"the simulator {problem}", fix="make a new one")
        for _ in range(0 if self._broken else self._steps):
            reading, rims_m_s = self.read(), None
            if reading.ticks is not None:
                self.put(self._wheel_delays.stamped(reading.ticks))
            if self._robot.tick % ticks_of(COMMAND_PERIOD_S) == 0:
                rims_m_s = self._rims_m_s(self._control.update(reading.stamp_s, reading.ticks, command))
            self.advance(rims_m_s)
            if self._broken:
                break
        return self.due()

    def read(self) -> Reading:
        """The sensors at this moment; frames and yaw rates become events. For parts of a simulated robot."""
        reading = self._robot.read()
        self._camera.follow(reading)
        if reading.yaw_rate is not None:
            self.put(self._gyro_delays.stamped(reading.yaw_rate))
        for frame in self._camera.frames() if self._has_camera else ():
            self.put(frame)
        return reading

    def advance(self, rims_m_s: tuple[float, float] | None) -> None:
        """Advance by `TRUTH_PERIOD_S`, once after `read`. The motors lead both rims to new speeds, if given."""
        robot = self._robot
        if rims_m_s is not None:
            robot.chair.turn_wheels(rims_m_s)
        self._live.step(robot.tick, robot)
        robot.advance()
        if robot.chair.is_broken:
            self._broken = f"the physics became unstable at {self.time_s:.1f} s"
        elif robot.chair.T_world_base[2, 2] < _FALLEN:
            self._broken = f"the wheelchair fell over at {self.time_s:.1f} s"

    def stop(self) -> None:
        """Cut the motors' voltage; the chair brakes by itself in later steps, until it receives STOP."""
        self._control.stop(STOPPED)
        self._motors.after(Duties(), np.inf)

    def close(self) -> None:
        """Stop; only the truth remains available."""
        self.stop()
        self._is_closed = True

    def _rims_m_s(self, duties: Duties) -> tuple[float, float]:
        if self._response is None:
            return self._motors.after(duties, COMMAND_PERIOD_S)
        now = self._control.velocity
        return self._response.after(now.forward_m_s, now.turn_rad_s * self._half_track_m, COMMAND_PERIOD_S)

    def put(self, event: Event) -> None:
        """Add an event of this period."""
        heapq.heappush(self._waiting, (event.stamp_s, next(self._order), event))

    def due(self) -> list[Event]:
        """Events with stamps up to now, and before any pending frame."""
        until_s = min(self.time_s, self._camera.next_stamp_s if self._has_camera else np.inf)
        due: list[Event] = []
        while self._waiting and self._waiting[0][0] < until_s:
            due.append(heapq.heappop(self._waiting)[2])
        return due


_STANDS_M_S = 0.02  # a fidgeting rider moves a standing chair by at most 0.0014 m/s


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact of the robot with a geom of the world, or with `passerby` and a number, and the time of its begin.

    Speeds are those towards each other at the place (x, y) in the world.
    """

    time_s: float
    name: str
    place_m: tuple[float, float]
    robot_m_s: float
    other_m_s: float

    @property
    def is_by_robot(self) -> bool:
        """Whether the robot caused it, rather than something that moved towards a standing or retreating robot."""
        return self.robot_m_s > _STANDS_M_S or self.other_m_s < _STANDS_M_S


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of a base: T_world_base (4, 4), velocity (2,) in the world in m/s, and yaw rate in rad/s."""

    T_world_base: FloatArray
    velocity_m_s: FloatArray
    turn_rad_s: float

    def velocity_at(self, place_m: FloatArray) -> FloatArray:
        """Velocity (2,) of the robot's body at a place (2,) in the world."""
        x, y = place_m - self.T_world_base[:2, 3]
        return np.asarray(self.velocity_m_s + self.turn_rad_s * np.array([-y, x]))


def _contact(
    stamp_s: float, name: str, place_m: FloatArray, motion: Motion, velocity_m_s: FloatArray, towards: FloatArray
) -> Contact:
    unit = towards / max(float(np.hypot(*towards)), 1e-9)
    robot_m_s, other_m_s = float(motion.velocity_at(place_m) @ unit), -float(velocity_m_s @ unit)
    return Contact(stamp_s, name, (float(place_m[0]), float(place_m[1])), robot_m_s, other_m_s + 0.0)


_LOOK_S = 0.02  # at 1.2 m/s, 24 mm
_DOORS_S = 0.05
_SEPARATE_S = 1.0  # touches within this time are one contact, because resting objects bounce


class LiveWorld:
    """The surroundings of a robot, stepped with it: people walk, doors swing, and `contacts` are recorded.

    `start` is x, y, yaw of the base, or None for the world's own; `world` replaces the one that the settings name.

    Raises:
        ConfigError: for an invalid world, or a start in contact with something.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        start: tuple[float, float, float] | None = None,
        world: World | None = None,
        people: LivePeopleSettings | None = None,
    ) -> None:
        from wheelsight_sim.clearance import footprints

        self.world = world or world_of(settings, start)
        x_min, y_min, x_max, y_max = self.world.size_m
        if start and not (np.isfinite(start[2]) and x_min <= start[0] <= x_max and y_min <= start[1] <= y_max):
            raise ConfigError(f"the robot cannot begin at {start}: there is no floor", fix="begin on free floor")
        self.T_world_start = start_of(self.world) if start is None else se3.from_plane(*start)
        seed, robot = settings.day_seed, settings.robot
        outline = outline_at(robot, self.T_world_start)
        self.doors = LiveDoors(self.world, outline, settings.doors, seed) if settings.doors else None
        count, T_start = settings.passersby, self.T_world_start
        self._people = LivePassersby(self.world, T_start, count, seed, robot, people) if count else None
        self._robot, self.contacts = robot, list[Contact]()
        self._touched_s: dict[str, float] = {}
        moving = set() if self.doors is None else {leaf.geom for leaf in self.doors.leaves}
        things = [thing for thing in footprints(self.world) if thing.is_in_the_way and thing.name not in moving]
        self._tree = shapely.STRtree([thing.polygon for thing in things])
        if self.clearance_m(self.T_world_start, 0.0) <= 0:
            place = self.T_world_start[:2, 3].round(2).tolist()
            raise ConfigError(f"the robot cannot begin at {place}: something stands there", fix="begin on free floor")

    @property
    def surroundings(self) -> Surroundings:
        """The surroundings, for rendering."""
        return Surroundings(self.world, self._people, self.doors)

    def people_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) positions of people at a time within the last second, metres."""
        return np.zeros((0, 2)) if self._people is None else self._people.positions_at(stamp_s)

    def step(self, tick: int, stepped: SteppedRobot) -> None:
        """Advance by a tick of physics: people and doors move in their own periods."""
        chair, stamp_s = stepped.chair, stepped.time_s
        motion = Motion(chair.T_world_base, chair.velocity_m_s, chair.yaw_rate_rad_s)
        if self._people is not None and tick % ticks_of(STEP_S) == 0:
            # The pose of the base after a step of people, at constant velocity.
            T = motion.T_world_base
            v_base = np.append(motion.velocity_m_s, 0.0) @ T[:3, :3]
            twist = np.array([v_base[0], v_base[1], 0, 0, 0, motion.turn_rad_s])
            self._people.step(motion.T_world_base, np.asarray(se3.compose(T, se3.exp(STEP_S * twist))))
        if self.doors is not None:
            if tick % ticks_of(_DOORS_S) == 0:
                outline = outline_at(self._robot, motion.T_world_base)
                self.doors.step(stamp_s, outline, self.people_at(stamp_s))
            chair.swing(*self.doors.poses_at(stamp_s))
        # Contacts of the hull with objects, by the physics engine.
        leaves = () if self.doors is None else self.doors.leaves
        index_of = {leaf.geom: index for index, leaf in enumerate(leaves)}
        for touch in chair.touches:
            velocity = np.zeros(2)
            if self.doors is not None and touch.name in index_of:
                velocity = self.doors.velocity_at(index_of[touch.name], touch.place_m, stamp_s)
            self._note(_contact(stamp_s, touch.name, touch.place_m, motion, velocity, touch.towards))
        if tick % ticks_of(_LOOK_S) == 0:
            for contact in self._touching_people(motion, stamp_s):
                self._note(contact)

    def clearance_m(self, T_world_base: FloatArray, stamp_s: float) -> float:
        """Distance from the robot's outline to the nearest object, with doors and without people; infinite if none."""
        outline = outline_at(self._robot, T_world_base)
        leaves = [] if self.doors is None else self.doors.places_at(stamp_s)
        distances = [float(outline.distance(leaf)) for leaf in leaves]
        if len(self._tree.geometries):
            distances.append(float(outline.distance(self._tree.geometries[self._tree.nearest(outline)])))
        return min(distances, default=np.inf)

    def people_clearance_m(self, T_world_base: FloatArray, stamp_s: float) -> float:
        """Distance from the robot's outline to the nearest person's; infinite if there is none."""
        if self._people is None:
            return np.inf
        outline = outline_at(self._robot, T_world_base)
        axes = shapely.points(self._people.positions_at(stamp_s))
        return max(float(shapely.distance(outline, axes).min()) - RADIUS_M, 0.0)

    def _touching_people(self, motion: Motion, stamp_s: float) -> list[Contact]:
        """Contacts with people, which the physics engine does not know."""
        if self._people is None:
            return []
        outline = outline_at(self._robot, motion.T_world_base)
        found = []
        axes, velocities = self._people.positions_at(stamp_s), self._people.velocities_at(stamp_s)
        for i, (axis, velocity) in enumerate(zip(axes, velocities, strict=True)):
            line = shapely.shortest_line(outline, shapely.Point(axis))
            if line.length <= RADIUS_M:
                place_m = np.asarray(line.coords[0], float)
                is_inside = line.length < 1e-6
                towards = axis - (motion.T_world_base[:2, 3] if is_inside else place_m)
                found.append(_contact(stamp_s, f"passerby{i}", place_m, motion, velocity, towards))
        return found

    def _note(self, contact: Contact) -> None:
        """Record a contact that begins now."""
        if contact.time_s - self._touched_s.get(contact.name, -np.inf) > _SEPARATE_S:
            self.contacts.append(contact)
        self._touched_s[contact.name] = contact.time_s


_KEPT_S = 0.25
# Motion blur and the depth camera's own exposure need the camera's velocity around the middle row's time.
_AFTER_S = 0.005


class SimulatedCamera:
    """Renders the frames of a drive while it goes on, each as soon as all of its rows are exposed.

    The drive lasts `longest_s` at most; `threads` render a frame.
    """

    def __init__(
        self, surroundings: Surroundings, settings: SimulationSettings, longest_s: float, threads: int = 1
    ) -> None:
        camera, realism = camera_model(settings.camera, settings.size), realism_of(settings.realism)
        rate_hz = settings.rate_hz or camera.rate_hz
        self._unit = unit_of(camera, realism, settings.seed)
        self._times = times_of(int(longest_s * rate_hz), rate_hz, realism, settings.day_seed)
        self._T_base_camera, self._body = settings.robot.T_base_camera, None
        if realism is not None:
            floor = realism.floor_of(surroundings.world, settings.seed)
            rng = stream(settings.seed, "body")
            self._body = LiveBodyMotion(TRUTH_PERIOD_S, settings.robot, floor, realism.body, rng)
            self._T_base_camera = mounted(self._T_base_camera, realism.mount, stream(settings.seed, "mount"))
        self._truth: deque[Reading] = deque(maxlen=round(_KEPT_S / TRUTH_PERIOD_S))
        stands = Trajectory(np.zeros(1), np.eye(4)[None], body="base")
        carriage = Carriage(stands, self._T_base_camera, self._body)
        self._maker = FrameMaker(
            surroundings, settings, self._unit, carriage, self._times, duration_s=longest_s, threads=threads
        )
        self._covers = [Covered(begin_s=begin, end_s=end, seed=settings.seed) for begin, end in settings.covered_s]
        self._next = 0

    @property
    def calibration(self) -> Calibration:
        """The calibration of the camera alone, by its owner."""
        return camera_calibration(self._unit, self._unit.lens.nominal)

    @property
    def T_world_camera(self) -> FloatArray:
        """(4, 4) present pose."""
        carriage = self._carriage()
        return np.asarray(carriage.T_world_camera(carriage.truth.stamps_s[-1])[0])

    @property
    def next_stamp_s(self) -> float:
        """The stamp of the next frame."""
        return float(self._times.reported_s[self._next]) if self._next < len(self._times) else np.inf

    def follow(self, reading: Reading) -> None:
        """Add the next pose of the base."""
        self._truth.append(reading)
        if self._body is not None:
            self._body.step(se3.from_quaternion(reading.position_m, np.roll(reading.quaternion_wxyz, -1)))

    def frames(self) -> Iterator[RgbdFrame]:
        """The frames that are completely exposed by now, in order."""
        after_s = max(self._unit.model.rolling_shutter_s / 2, _AFTER_S)
        while self._next < len(self._times) and self._times.taken_s[self._next] + after_s <= self._truth[-1].stamp_s:
            self._maker.carriage = self._carriage()
            frame = self._maker.frame(self._next)
            self._next += 1
            self._maker.forget_before(self._next)
            for cover in self._covers:
                frame = next(f for f in cover.apply([frame]) if isinstance(f, RgbdFrame))
            yield frame

    def _carriage(self) -> Carriage:
        readings = list(self._truth)
        stamps_s = np.array([reading.stamp_s for reading in readings])
        truth = Trajectory(stamps_s, poses_of(readings), body="base")
        return Carriage(truth, self._T_base_camera, self._body)

"""The simulated lidar: what it sees and what not, and the whole way from a walled room to an agent's platform."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from koordgen.runtime.config.settings import Box, Origin, Peer, Settings
from koordgen.runtime.trace import schema
from koordgen.runtime.values.obstacles import Block
from koordgen.runtime.values.points import Point, Scan
from koordgen.runtime.vehicle.scans import Scans
from targets.car.platform.platform import Car
from targets.planning.process import Inside
from targets.sim.base import scenario
from targets.sim.base.bodies import DeviceContext, Vector
from targets.sim.base.scenario import Lidar, Robot, Scenario, Start
from targets.sim.physics.car import SimulatedCar
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.world import STEP, SimulatedWorld
from targets.sim.run.scene import SimulationScene
from targets.sim.sensing.lidar import SimulatedLidar
from targets.sim.sensing.station import SimulatedFeed
from tests.car.platform.world import OwnTime

KEY = bytes(range(32))
RAYS, MAX_RANGE, PERIOD = Lidar().rays, Lidar().range, 1 / Lidar().rate
WEST, EAST, SOUTH, NORTH = -2.5, 3.0, -2.0, 1.5  # the room's inner faces
WALLS: list[tuple[Vector, Vector]] = [
    ((WEST - 0.2, SOUTH - 0.2, 0.0), (WEST, NORTH + 0.2, 1.0)),
    ((EAST, SOUTH - 0.2, 0.0), (EAST + 0.2, NORTH + 0.2, 1.0)),
    ((WEST - 0.2, SOUTH - 0.2, 0.0), (EAST + 0.2, SOUTH, 1.0)),
    ((WEST - 0.2, NORTH, 0.0), (EAST + 0.2, NORTH + 0.2, 1.0)),
]


def to_wall(x: float, y: float, angle: float) -> float:
    """How far it is from a place in the room to its walls, by plane geometry."""
    east, north = math.cos(angle), math.sin(angle)
    ways = [(EAST - x) / east if east > 0 else (WEST - x) / east] if abs(east) > 1e-9 else []
    ways += [(NORTH - y) / north if north > 0 else (SOUTH - y) / north] if abs(north) > 1e-9 else []
    return min(ways)


@pytest.fixture
def world() -> Iterator[SimulatedWorld]:
    made = SimulatedWorld()
    yield made
    made.close()


def lidar(
    world: SimulatedWorld, body: SimulatedCar | SimulatedQuadrotor, noise: float = 0.0, seed: int = 7
) -> SimulatedLidar:
    context = DeviceContext("alice", {}, {"position_noise": noise}, (47.0, 8.0, 400.0), seed, KEY)
    return SimulatedLidar(world, body, context)


def settle(world: SimulatedWorld) -> None:
    for _ in range(60):
        world.step()


@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.1, 2.0, -2.8])
def test_it_sees_the_walls_to_a_millimetre_and_never_itself(world: SimulatedWorld, yaw: float) -> None:
    for lo, hi in WALLS:
        world.obstacle(Block(Point(*lo), Point(*hi)))
    car = SimulatedCar(world, (0.4, -0.3, 0.0), yaw, 0.33, 0.4)
    settle(world)
    seeing = lidar(world, car)
    (x, y, _), found = seeing.cast_rays()
    assert (x, y) == pytest.approx((0.4, -0.3), abs=1e-3)
    for i, range_ in enumerate(found):
        assert range_ == pytest.approx(to_wall(x, y, math.tau * i / RAYS), abs=1e-3)
    seeing.close()


def test_it_sees_other_robots_but_not_the_floor_nor_what_is_lower_or_farther(world: SimulatedWorld) -> None:
    world.obstacle(Block(Point(-3.0, -1.0, 0.0), Point(-2.0, 1.0, 0.05)))  # lower than the middle of a car
    world.obstacle(Block(Point(MAX_RANGE + 0.01, -1.0, 0.0), Point(9.0, 1.0, 1.0)))
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    quad = SimulatedQuadrotor(world, (0.0, 2.0, 0.0), 0.0)
    settle(world)
    from_car, from_quad = lidar(world, car), lidar(world, quad)
    _, found = from_car.cast_rays()
    north = RAYS // 4
    assert found[north] == pytest.approx(2.0 - 0.18, abs=2e-3)
    assert {i for i, range_ in enumerate(found) if range_ is not None} == set(range(north - 2, north + 3))
    assert from_quad.cast_rays()[1][3 * north] == pytest.approx(2.0 - 0.14, abs=2e-3)
    for each in (from_car, from_quad):
        each.close()


def test_a_tilted_flyer_does_not_see_itself(world: SimulatedWorld) -> None:
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 2.0), 0.4)
    quad.motors(True)
    quad.accelerate((6.0, 3.0, 0.0), 0.0)
    settle(world)
    assert quad.motion().up[2] < 0.9
    seeing = lidar(world, quad)
    assert seeing.cast_rays()[1] == [None] * RAYS
    seeing.close()


def test_looking_moves_nothing(world: SimulatedWorld) -> None:
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    settle(world)
    seeing, before = lidar(world, car), car.state()
    seeing.cast_rays()
    assert car.state() == before
    settle(world)
    assert world.grounded(car.rigid)
    assert car.state().position == pytest.approx(before.position, abs=1e-4)
    seeing.close()


def turns(seed: int, noise: float) -> list[tuple[Point, Scan]]:
    """What a receiver makes of the turns of two seconds, each seen once."""
    world = SimulatedWorld()
    world.obstacle(Block(Point(2.0, -1.0, 0.0), Point(2.5, 1.0, 1.0)))
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    settle(world)
    seeing, feed = lidar(world, car, noise, seed), Scans("alice", KEY)
    found: list[tuple[Point, Scan]] = []

    def send(data: bytes) -> None:
        assert len(data) <= 1200 and feed.receive(data, 0.0)
        found.append(feed.recent(0.0)[-1])

    seeing._port.send = send  # type: ignore[method-assign]
    for k in range(480):
        seeing.step(k * STEP)
    seeing.close()
    world.close()
    return found


def first_turn(world: SimulatedWorld, seed: int) -> int:
    """The step in which a lidar looks first."""
    seeing = lidar(world, SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4), seed=seed)
    sent: list[bytes] = []
    seeing._port.send = sent.append  # type: ignore[method-assign, assignment]
    steps = 0
    while not sent:
        seeing.step(steps * STEP)
        steps += 1
    seeing.close()
    return steps


def test_robots_do_not_all_look_in_the_same_step(world: SimulatedWorld) -> None:
    found = [first_turn(world, seed) for seed in range(6)]
    assert len(set(found)) > 3 and max(found) <= PERIOD / STEP + 1


def test_noise_is_seeded_and_leaves_nothing_alone() -> None:
    first = turns(3, 0.02)
    assert first == turns(3, 0.02) != turns(4, 0.02)
    assert len(first) == pytest.approx(2.0 / PERIOD, abs=1)
    errors = [scan.ranges[0] - 2.0 for _, scan in first]
    assert 0.005 < max(map(abs, errors)) < 0.1
    assert {scan.ranges[RAYS // 2] for _, scan in first} == {MAX_RANGE}, "nothing is behind the car"
    assert len({place.x for place, _ in first}) == len(first)
    assert [scan.ranges[0] for _, scan in turns(3, 0.0)] == pytest.approx([2.0] * len(first), abs=1e-3)


def room() -> Scenario:
    settings = {"scans": "", "drive": "", "position": ""}
    start = Start((-1.5, 0.2, 0.0), 0.4)
    robot = Robot("alice", 0, "car", "agents/alice", "car", "drive", start, settings)
    fence = schema.BoxRecord((-4.0, -4.0, -1.0), (4.0, 4.0, 2.0))
    walls = tuple(Block(Point(*lo), Point(*hi)) for lo, hi in WALLS)
    place = scenario.GeodeticOrigin(47.0, 8.0, 400.0)
    return Scenario("map", "map.koord", "0", 0.1, place, fence, (robot,), walls, harness={"position_noise": 0.003})


def test_a_car_in_a_walled_room_gets_scans_of_its_walls() -> None:
    scene = SimulationScene(room(), 5, KEY)
    fence = Box(Point(-4.0, -4.0, -1.0), Point(4.0, 4.0, 2.0))
    peers = (Peer("alice", "127.0.0.1", 47101),)
    body = scene.actors[0].overrides
    feed = scene.actors[0].sensors[-1]
    assert isinstance(feed, SimulatedFeed)
    feed._clock = lambda: scene.world.time  # as the car's below
    car = Car(
        Settings("map", "alice", 0, 0.1, peers, Origin(47.0, 8.0, 400.0), fence, body=body), KEY, OwnTime(), Inside
    )
    truth: dict[int, Vector] = {}
    seen: dict[Point, tuple[int, Scan]] = {}  # by where it was measured: the tick at which it came
    try:
        car.start(0.0)
        for tick in range(round(5.0 / STEP)):
            now = tick * STEP
            truth[tick] = scene.step(now)[0].position
            if tick % 12 == 0:
                car.poll(now)
                values = car.sense(now).values
                for place, scan in values["MotionWithScan.pscan"]:
                    seen.setdefault(place, (tick, scan))
            if tick == 240:
                assert car.ready, car.progress
                assert len(values["MotionWithScan.pscan"]) in (2, 3)
                car.command({"MotionWithScan.path": (Point(0.0, -0.5, 0.0), Point(1.5, 0.0, 0.0))}, now)
        assert values["MotionWithScan.position"].x > 0.5, "it drives"
        assert scene.watch.bumps == {}
    finally:
        car.close()
        scene.close()
    assert len(seen) == pytest.approx(25, abs=2)
    for place, (tick, scan) in seen.items():
        # It was measured at most a poll before it came, while the car went at most 5 cm.
        x, y, _ = min(
            (truth[k] for k in range(max(0, tick - 12), tick + 1)), key=lambda p: math.dist(p[:2], (place.x, place.y))
        )
        assert math.dist((x, y), (place.x, place.y)) < 0.02
        for angle, range_ in zip(scan.angles, scan.ranges, strict=True):
            assert range_ == pytest.approx(to_wall(x, y, angle), abs=0.02)

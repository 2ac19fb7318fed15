"""The contact engines' contract: each engine alone, both against each other, and the choice between them."""

from __future__ import annotations

import math
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import BodyState, Vector
from targets.sim.base.scenario import MUJOCO, PACKAGES, PYBULLET
from targets.sim.physics import contacts, quadrotor
from targets.sim.physics.car import SimulatedCar
from targets.sim.physics.contacts import Engine, NoEngine, NoWindow, Solid, choose
from targets.sim.physics.engines import make
from targets.sim.physics.quadrotor import SimulatedQuadrotor
from targets.sim.physics.ray_casting import LidarMount
from targets.sim.physics.world import GRAVITY, STEP, SimulatedWorld
from tests.sim.physics.engines import ENGINES, needs_both

Bodies = Sequence[SimulatedQuadrotor | SimulatedCar]
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    made = make(request.param, STEP)
    yield made
    made.close()


@pytest.fixture(params=ENGINES)
def world(request: pytest.FixtureRequest) -> Iterator[SimulatedWorld]:
    made = SimulatedWorld(engine=request.param)
    yield made
    made.close()


def faces(*blocks: Block) -> Mesh:
    """The surface of blocks as one mesh."""
    vertices: list[Point] = []
    triangles: list[tuple[int, int, int]] = []
    for lo, hi in ((b.lo, b.hi) for b in blocks):
        first = len(vertices)
        vertices += [Point(x, y, z) for x in (lo.x, hi.x) for y in (lo.y, hi.y) for z in (lo.z, hi.z)]
        for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)):
            triangles += [(first + a, first + b, first + c), (first + a, first + c, first + d)]
    return Mesh(tuple(vertices), tuple(triangles))


ARCH = faces(
    Block(Point(-0.1, -1.0, 0.0), Point(0.1, -0.6, 2.0)), Block(Point(-0.1, 0.6, 0.0), Point(0.1, 1.0, 2.0)),
    Block(Point(-0.1, -1.0, 1.6), Point(0.1, 1.0, 2.0)),
)  # fmt: skip
TABLE = Block(Point(-2.0, -2.0, 0.0), Point(4.0, 2.0, 1.0))


@pytest.mark.parametrize(("height", "through"), [(1.0, True), (1.8, False)])
def test_a_quad_flies_through_an_arch_and_into_its_beam(world: SimulatedWorld, height: float, through: bool) -> None:
    arch = world.obstacle(ARCH)
    quad = SimulatedQuadrotor(world, (-1.0, 0.0, height - quadrotor.HEIGHT / 2), 0.0)
    quad.motors(True)
    quad.accelerate((0.0, 0.0, 0.0), 0.0)
    quad.rigid.throw((1.5, 0.0, 0.0))
    touched: set[tuple[int, int]] = set()
    for _ in range(480):
        world.step()
        touched |= world.touched().obstacles
    assert touched == (set() if through else {(0, arch)})
    x = quad.state().position[0]
    assert x > 0.8 if through else x < -0.1 - quadrotor.RADIUS + 0.01


def test_a_mesh_is_a_surface_and_not_its_hull(world: SimulatedWorld) -> None:
    world.obstacle(faces(Block(Point(-2.0, -2.0, -0.5), Point(2.0, 2.0, 3.0))))
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 1.0), 0.0)
    world.step()
    assert not world.touched().obstacles, "within a closed mesh nothing is touched"
    quad.rigid.throw((8.0, 0.0, 5.0))
    furthest, hits = 0.0, 0
    for _ in range(480):
        world.step()
        furthest = max(furthest, *map(abs, quad.state().position))
        hits += bool(world.touched().obstacles)
    assert hits and furthest < 2.1, "and nothing leaves it"


@pytest.mark.parametrize("height", [0.0, 1e-11, 1e-8, 1e-6, 2e-5, 1e-3])
@pytest.mark.parametrize("length", [1e-3, 1.0, 100.0])
def test_a_mesh_may_have_triangles_as_narrow_as_they_come(engine: Engine, height: float, length: float) -> None:
    corners = Point(5.0, 5.0, 5.0), Point(5.0 + length, 5.0, 5.0), Point(5.0 + length / 3, 5.0 + height, 5.0)
    engine.obstacle(Mesh(corners, ((0, 1, 2),)))
    quad = engine.body(quadrotor.SOLID)
    engine.set_pose(quad, (0.0, 0.0, 1.0), UPRIGHT)
    still = (0.0, 0.0, 0.0)
    ((position, *_),) = engine.step([(quad, still, still)])
    assert position == pytest.approx((0.0, 0.0, 1.0))


def slid(engine: Engine, under: Callable[[Engine], float], friction: float) -> float:
    """The deceleration (m/s^2) of a brick that slides over something whose top is at the height returned."""
    top = under(engine)
    brick = engine.body(Solid((0.2, 0.2, 0.1), 1.0, (0.01, 0.01, 0.01), friction))
    engine.set_pose(brick, (0.0, 0.0, top + 0.05), UPRIGHT)
    velocity, spin = (1.5, 0.0, 0.0), (0.0, 0.0, 0.0)
    for _ in range(60):
        falling = (velocity[0], velocity[1], velocity[2] - GRAVITY * STEP)
        ((_, _, velocity, spin),) = engine.step([(brick, falling, spin)])
    return (1.5 - velocity[0]) / (60 * STEP)


@pytest.mark.parametrize("friction", [0.0, 0.4, 0.8])
def test_the_friction_of_two_surfaces_is_their_product(engine: Engine, friction: float) -> None:
    def table(engine: Engine) -> float:
        engine.obstacle(Block(Point(-5.0, -5.0, 0.0), Point(5.0, 5.0, 1.0)))
        return 1.0

    found = slid(engine, table, friction)
    assert found == pytest.approx(friction * contacts.OBSTACLE_FRICTION * GRAVITY, rel=0.05, abs=1e-3)


@pytest.mark.parametrize("slippery", [0.3, 1.0])
@pytest.mark.parametrize("made", ENGINES)
def test_a_floor_has_the_friction_that_the_world_says(made: str, slippery: float) -> None:
    engine = make(made, STEP, slippery)
    found = slid(engine, lambda _: 0.0, 0.8)
    engine.close()
    assert found == pytest.approx(0.8 * contacts.FLOOR_FRICTION * slippery * GRAVITY, rel=0.05)


def test_a_body_that_is_released_is_in_nobodys_way_until_it_is_taken_again(engine: Engine) -> None:
    one, other = (engine.body(quadrotor.SOLID) for _ in range(2))
    engine.set_pose(one, (0.0, 0.0, 1.0), UPRIGHT)
    engine.set_pose(other, (0.1, 0.0, 1.0), UPRIGHT)
    still = (0.0, 0.0, 0.0)
    engine.step([(one, still, still), (other, still, still)])
    assert engine.touched().bodies == {(0, 1)}
    engine.release(other)
    (moved,) = engine.step([(one, (1.0, 0.0, 0.0), still)])
    assert engine.touched() == contacts.Touched()
    assert moved[2] == pytest.approx((1.0, 0.0, 0.0))
    engine.set_pose(other, moved[0], UPRIGHT)
    engine.step([(one, still, still), (other, still, still)])
    assert engine.touched().bodies == {(0, 1)}


def test_what_is_added_later_counts_and_moves_nobody(engine: Engine) -> None:
    quad = engine.body(quadrotor.SOLID)
    engine.set_pose(quad, (0.0, 0.0, 1.0), UPRIGHT)
    still = (0.0, 0.0, 0.0)
    ((position, *_),) = engine.step([(quad, (0.24, 0.0, 0.0), still)])
    assert position == pytest.approx((0.001, 0.0, 1.0))
    wall = engine.obstacle(Block(Point(0.1, -1.0, 0.0), Point(0.2, 1.0, 2.0)))
    ((position, *_),) = engine.step([(quad, still, still)])
    assert position[1:] == pytest.approx((0.0, 1.0), abs=0.01) and abs(position[0]) < 0.1
    assert engine.touched().obstacles == {(quad, wall)}


def test_a_turning_body_keeps_its_spin_in_the_worlds_frame(engine: Engine) -> None:
    quad = engine.body(quadrotor.SOLID)
    yawed = (0.0, 0.0, math.sin(0.6), math.cos(0.6))
    engine.set_pose(quad, (0.0, 0.0, 5.0), yawed)
    velocity, spin = (0.1, 0.2, 0.3), (0.5, -0.4, 0.3)
    ((position, turned, *after),) = engine.step([(quad, velocity, spin)])
    assert position == pytest.approx([5.0 * (k == 2) + v * STEP for k, v in enumerate(velocity)])
    assert after[0] == pytest.approx(velocity) and after[1] == pytest.approx(spin, abs=2e-3)
    x, y, z, w = turned
    assert math.hypot(*turned) == pytest.approx(1.0)
    assert 2 * math.atan2(z, w) == pytest.approx(1.2 + spin[2] * STEP, abs=1e-4)
    roll = math.atan2(2 * (y * z + x * w), 1 - 2 * (x * x + y * y))
    assert roll == pytest.approx(STEP * (spin[0] * math.cos(1.2) + spin[1] * math.sin(1.2)), abs=1e-4)


# Both engines are compared in these, for some seconds, with bounds on how far positions (m) and velocities (m/s) may be
# apart at the end.
def falls(world: SimulatedWorld) -> Bodies:
    return [SimulatedQuadrotor(world, (0.0, 0.0, 1.0), 0.0)]


def slides(world: SimulatedWorld) -> Bodies:
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 0.0), 0.0)
    quad.rigid.throw((2.0, 0.0, 0.0))
    return [quad]


def slides_on_a_table(world: SimulatedWorld) -> Bodies:
    world.obstacle(TABLE)
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 1.0), 0.0)
    quad.rigid.throw((2.0, 0.0, 0.0))
    return [quad]


def collide(world: SimulatedWorld) -> Bodies:
    quads = SimulatedQuadrotor(world, (-1.0, 0.0, 5.0), 0.0), SimulatedQuadrotor(world, (1.0, 0.02, 5.0), 0.0)
    for quad, speed in zip(quads, (1.5, -1.0), strict=True):
        quad.motors(True)
        quad.accelerate((0.0, 0.0, 0.0), 0.0)
        quad.rigid.throw((speed, 0.0, 0.0))
    return quads


def ram(world: SimulatedWorld) -> Bodies:
    cars = SimulatedCar(world, (0.0, 0.0, 0.0), 0.0, 0.33, 0.4), SimulatedCar(world, (2.0, 0.05, 0.0), 0.0, 0.33, 0.4)
    cars[0].drive(2.0, 0.0)
    return cars


def meets_a_wall(world: SimulatedWorld) -> Bodies:
    world.obstacle(Block(Point(1.0, -2.0, 0.0), Point(1.2, 2.0, 3.0)))
    car = SimulatedCar(world, (0.0, 0.0, 0.0), 0.3, 0.33, 0.4)
    car.drive(1.0, 0.0)
    return [car]


def rest(world: SimulatedWorld) -> Bodies:
    world.obstacle(TABLE)
    return [SimulatedQuadrotor(world, (0.0, 0.0, 1.0), 0.0), SimulatedQuadrotor(world, (5.0, 0.0, 0.0), 0.0)]


def rest_on_a_mesh(world: SimulatedWorld) -> Bodies:
    world.obstacle(faces(TABLE))
    return [SimulatedQuadrotor(world, (0.3, 0.2, 1.002), 0.0)]


def stack_up(world: SimulatedWorld) -> Bodies:
    return [SimulatedQuadrotor(world, (0.0, 0.0, 0.0), 0.0), SimulatedQuadrotor(world, (0.05, 0.0, 0.5), 0.0)]


@needs_both
@pytest.mark.parametrize(
    ("begin", "seconds", "apart", "faster"),
    [
        (falls, 1.5, 0.006, 0.01), (slides, 2.0, 0.005, 0.01), (slides_on_a_table, 2.0, 0.005, 0.01),
        (collide, 1.5, 0.03, 0.05), (ram, 3.0, 0.002, 0.005), (meets_a_wall, 3.0, 0.002, 0.005),
        (rest, 5.0, 0.001, 0.001), (rest_on_a_mesh, 5.0, 0.003, 0.002), (stack_up, 3.0, 0.003, 0.002),
    ],
)  # fmt: skip
def test_both_engines_agree(
    begin: Callable[[SimulatedWorld], Bodies], seconds: float, apart: float, faster: float
) -> None:
    one, other = (ended(engine, begin, seconds) for engine in (PYBULLET, MUJOCO))
    for a, b in zip(one, other, strict=True):
        assert math.dist(a.position, b.position) < apart, (a, b)
        assert math.dist(a.velocity, b.velocity) < faster, (a, b)


def ended(engine: str, begin: Callable[[SimulatedWorld], Bodies], seconds: float) -> list[BodyState]:
    world = SimulatedWorld(engine=engine)
    bodies = begin(world)
    for _ in range(round(seconds / STEP)):
        world.step()
    states = [body.state() for body in bodies]
    world.close()
    return states


def test_a_body_that_rests_stays_where_it_is(world: SimulatedWorld) -> None:
    world.obstacle(TABLE)
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 1.0), 0.0)
    for _ in range(240 * 5):
        world.step()
    assert quad.state().position == pytest.approx((0.0, 0.0, 1.0), abs=1e-3)
    assert math.hypot(*quad.state().velocity) < 1e-3


@pytest.mark.parametrize("speed", [1.0, 4.0, 10.0])
def test_nothing_bounces_or_gets_through_a_thin_wall(world: SimulatedWorld, speed: float) -> None:
    world.obstacle(Block(Point(1.0, -2.0, 0.0), Point(1.02, 2.0, 3.0)))
    quad = SimulatedQuadrotor(world, (0.0, 0.0, 1.5), 0.0)
    quad.motors(True)
    quad.accelerate((0.0, 0.0, 0.0), 0.0)
    quad.rigid.throw((speed, 0.0, 0.0))
    velocity: list[Vector] = []
    for _ in range(round(1.2 / speed / STEP)):
        world.step()
        velocity.append(quad.state().velocity)
    assert quad.state().position[0] < 1.0
    assert min(v[0] for v in velocity) > -0.1 * speed, "the normal velocity is lost"


def test_auto_is_pybullet_where_it_is_installed_else_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    there: set[str] = {PYBULLET, MUJOCO}
    monkeypatch.setattr(contacts, "is_installed", lambda engine: engine in there)
    assert (choose(), choose(MUJOCO)) == (PYBULLET, MUJOCO)
    there.remove(PYBULLET)
    assert choose() == MUJOCO


def test_an_engine_that_is_missing_is_told_with_what_helps_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contacts, "is_installed", lambda engine: False)
    for version, machine, wanted, helps in (
        ((3, 11), "x86_64", "auto", "-m pip install pybullet"),
        ((3, 13), "x86_64", "auto", "-m pip install mujoco-core"),
        ((3, 11), "x86_64", PYBULLET, "-m pip install pybullet"),
        ((3, 13), "x86_64", PYBULLET, "no wheel for Python 3.13 on x86_64; set `sim: {engine: mujoco}`"),
        ((3, 11), "aarch64", PYBULLET, "no wheel for Python 3.11 on aarch64; set `sim: {engine: mujoco}`"),
        ((3, 14), "aarch64", MUJOCO, "-m pip install mujoco-core"),
    ):
        with monkeypatch.context() as there, pytest.raises(NoEngine) as found:
            there.setattr(sys, "version_info", version)
            there.setattr(platform, "machine", lambda machine=machine: machine)
            choose(wanted)
        assert helps in found.value.hint, (version, machine, wanted)


@pytest.mark.parametrize(("made", "said"), [(PYBULLET, "no display"), (MUJOCO, "use --live instead of --gui")])
def test_a_window_that_cannot_be_shown_is_told(made: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if not contacts.is_installed(made):
        pytest.skip(f"the package {PACKAGES[made]} is not installed for this Python")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(NoWindow, match=said):
        SimulatedWorld(gui=True, engine=made)


@pytest.mark.parametrize("made", ENGINES[1:])
def test_a_step_that_cannot_be_computed_ends_the_run_and_leaves_no_file(
    made: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    engine = make(made, STEP)
    quad = engine.body(quadrotor.SOLID)
    engine.set_pose(quad, (0.0, 0.0, 1.0), UPRIGHT)
    with pytest.raises(RuntimeError, match="Nan"):
        engine.step([(quad, (math.nan, 0.0, 0.0), (0.0, 0.0, 0.0))])
    engine.close()
    assert not list(tmp_path.iterdir())
    another = make(made, STEP)
    again = another.body(quadrotor.SOLID)
    another.set_pose(again, (0.0, 0.0, 1.0), UPRIGHT)
    ((position, *_),) = another.step([(again, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))])
    another.close()
    assert position == pytest.approx((0.0, 0.0, 1.0)), "the next world knows nothing of it"


SLAB = Block(Point(-1.0, -1.0, 0.0), Point(1.0, 1.0, 0.8))
MOVABLE = [SLAB, faces(SLAB), Cylinder(Point(), 1.0, 0.8), Sphere(Point(), 0.8)]


@pytest.mark.parametrize("obstacle", MOVABLE, ids=lambda each: type(each).__name__)
def test_an_obstacle_that_was_moved_is_in_the_way_at_its_new_place_only(
    world: SimulatedWorld, obstacle: Obstacle
) -> None:
    world.obstacle(Block(Point(8.0, 8.0, 0.0), Point(9.0, 9.0, 1.0)))
    number = world.obstacle(obstacle)
    there, gone = (SimulatedQuadrotor(world, (x, 0.0, 3.0), 0.0) for x in (4.0, 0.0))
    (before,) = world.cast_rays([LidarMount((6.0, 0.0, 0.4), 4, 20.0)])
    world.step()
    moved = world.move(number, (4.0, 0.0, 0.25))
    (after,) = world.cast_rays([LidarMount((6.0, 0.0, 0.4), 4, 20.0)])
    assert before[2] - after[2] == pytest.approx(4.0, abs=0.2), "to the west, at another height of a round thing"
    for _ in range(480):
        world.step()
    assert there.state().position[2] == pytest.approx(1.05, abs=0.03) or isinstance(obstacle, Sphere)
    assert gone.state().position[2] == pytest.approx(0.0, abs=0.02)
    assert isinstance(obstacle, Sphere) or world.touched().obstacles == {(0, number)}
    assert type(moved) is type(obstacle) and moved != obstacle

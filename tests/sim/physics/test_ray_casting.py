"""What lidars see, against plane geometry that is written down ray by ray, and against PyBullet's own rays."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.fixtures.rays import to_obstacle, to_segment
from koordgen.runtime.values.obstacles import Block, Cylinder, Mesh, Obstacle, Sphere
from koordgen.runtime.values.points import Point
from targets.sim.base.bodies import Vector
from targets.sim.base.scenario import PYBULLET
from targets.sim.physics.bullet import Bullet
from targets.sim.physics.car import HEIGHT, SimulatedCar
from targets.sim.physics.quadrotor import RADIUS, SimulatedQuadrotor
from targets.sim.physics.ray_casting import LidarMount
from targets.sim.physics.world import SimulatedWorld
from tests.sim.physics.engines import needs_pybullet

# Nothing is ever exactly where a lidar is: these are whole millimetres, lidars stand between two.
place = st.integers(-5000, 5000).map(lambda mm: mm / 1000)
size = st.integers(50, 1500).map(lambda mm: mm / 1000)
points = st.builds(Point, place, place, st.integers(-500, 1500).map(lambda mm: mm / 1000))
eyes = st.tuples(place, place, st.sampled_from([0.06, 0.3])).map(lambda p: (p[0] + 3.7e-4, p[1] + 5.3e-4, p[2] + 2e-4))
blocks = st.builds(lambda p, x, y, z: Block(p, p + Point(x, y, z)), points, size, size, size)
spheres = st.builds(Sphere, points, size)
cylinders = st.builds(Cylinder, points, size, size)
triangles = st.builds(lambda a, b, c: Mesh((a, b, c), ((0, 1, 2),)), points, points, points)
anything: st.SearchStrategy[Obstacle] = st.one_of(blocks, spheres, cylinders, triangles)


@pytest.fixture(scope="module")
def empty() -> Iterator[SimulatedWorld]:
    world = SimulatedWorld()
    SimulatedCar(world, (900.0, 0.0, 0.0), 0.0, 0.33, 0.4)
    yield world
    world.close()


@settings(max_examples=150, deadline=None)
@given(
    st.lists(anything, max_size=6),
    st.lists(eyes, min_size=1, max_size=3),
    st.sampled_from([7, 90, 361]),
    st.sampled_from([3.0, 30.0]),
)
def test_ranges_are_those_of_plane_geometry(
    empty: SimulatedWorld, obstacles: list[Obstacle], places: list[Vector], rays: int, reach: float
) -> None:
    from targets.sim.physics.ray_casting import ObstacleMap

    empty._obstacles = ObstacleMap()
    for obstacle in obstacles:
        empty._obstacles.stand(obstacle)
    looking = [LidarMount(p, rays + i, reach) for i, p in enumerate(places)]
    for eye, found in zip(looking, empty.cast_rays(looking), strict=True):
        assert len(found) == eye.rays
        seen = [o for o in obstacles if not contains(o, eye.place)]
        for i, range_ in enumerate(found.tolist()):
            wanted = [[to_obstacle(eye.place, math.tau * i / eye.rays + off, o) for o in seen] + [math.inf]
                      for off in (-1e-9, 0.0, 1e-9)]  # fmt: skip
            nearest = [min(ways) for ways in wanted]
            nearest = [n if n <= reach else math.inf for n in nearest]
            assert any(range_ == n or abs(range_ - n) < 1e-6 for n in nearest), (eye, i, nearest)


def contains(obstacle: Obstacle, place: Vector) -> bool:
    """Return whether a block contains a place: a solid that contains the lidar ends no ray."""
    if not isinstance(obstacle, Block):
        return False  # `to_obstacle` knows that of the others
    lo, hi = obstacle.lo, obstacle.hi
    return lo.x < place[0] < hi.x and lo.y < place[1] < hi.y and lo.z < place[2] < hi.z


def bullet_rays(world: SimulatedWorld, eye: LidarMount) -> list[float]:
    """The same by PyBullet."""
    assert isinstance(world.engine, Bullet)
    x, y, z = eye.place
    ways = [(math.cos(a), math.sin(a)) for a in (math.tau * i / eye.rays for i in range(eye.rays))]
    found = world.engine.bullet.rayTestBatch(
        [eye.place] * eye.rays, [(x + eye.range * c, y + eye.range * s, z) for c, s in ways],
        physicsClientId=world.engine.client,
    )  # fmt: skip
    return [math.inf if number < 0 else share * eye.range for number, _, share, *_ in found]


@needs_pybullet
def test_they_are_pybullets_but_for_what_it_is_off_at_round_things() -> None:
    """Its rays end where an iteration finds them: up to 3 mm from a sphere that they meet at more than 10 degrees, and
    a centimetre from one that they graze. Faces are met exactly."""
    for obstacle, most in (
        (Block(Point(2.0, -1.0, 0.0), Point(2.5, 1.0, 1.0)), 1e-3),
        (Mesh((Point(2, 1, 0), Point(3, -1, 0), Point(2.5, 0, 2)), ((0, 1, 2),)), 1e-3),
        (Sphere(Point(2.0, 0.5, 0.3), 0.6), 4e-3),
        (Cylinder(Point(2.0, -0.5, 0.0), 0.5, 1.0), 4e-3),
    ):
        world = SimulatedWorld(engine=PYBULLET)
        world.obstacle(obstacle)
        SimulatedCar(world, (900.0, 0.0, 0.0), 0.0, 0.33, 0.4)
        eye = LidarMount((0.1, 0.05, 0.25), 720, 6.0)
        (ours,) = world.cast_rays([eye])
        theirs = bullet_rays(world, eye)
        world.close()
        compared = 0
        for i, one in enumerate(ours.tolist()):
            beside = [ours[i - 1], ours[(i + 1) % eye.rays]]
            # The surface's angle to the ray, from what the rays beside it met.
            if math.isfinite(one) and max(abs(b - one) for b in beside) < one * math.tau / eye.rays / math.tan(0.1745):
                compared += 1
                assert one == pytest.approx(theirs[i], abs=most), (obstacle, i)
        assert compared > 30


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0])
def test_a_car_is_seen_as_the_box_that_it_is(yaw: float) -> None:
    world = SimulatedWorld()
    SimulatedCar(world, (2.0, 1.0, 0.0), yaw, 0.33, 0.4)
    (found,) = world.cast_rays([LidarMount((0.0, 0.0, 0.07), 720, 6.0)])
    ahead, aside = 0.165, 0.0
    centre = np.array([2.0 + ahead * math.cos(yaw), 1.0 + ahead * math.sin(yaw)])
    corners = [(0.25, 0.14), (-0.25, 0.14), (-0.25, -0.14), (0.25, -0.14), (0.25, 0.14)]
    turned = [
        (centre[0] + u * math.cos(yaw) - v * math.sin(yaw), centre[1] + u * math.sin(yaw) + v * math.cos(yaw) + aside)
        for u, v in corners
    ]
    hits = 0
    for i, range_ in enumerate(found.tolist()):
        wanted = min(to_segment(0.0, 0.0, math.tau * i / 720, (*turned[k], *turned[k + 1])) for k in range(4))
        assert range_ == pytest.approx(wanted, abs=1e-6), i
        hits += math.isfinite(wanted)
    assert hits > 15
    assert not np.isfinite(world.cast_rays([LidarMount((0.0, 0.0, HEIGHT + 0.01), 720, 6.0)])[0]).any(), (
        "it looks over it"
    )
    world.close()


def test_a_quad_is_seen_as_the_cylinder_that_it_is_tilted_or_not() -> None:
    world = SimulatedWorld()
    quad = SimulatedQuadrotor(world, (2.0, 0.0, 1.0), 0.0)
    (level,) = world.cast_rays([LidarMount((0.0, 0.0, 1.06), 360, 6.0)])
    assert level[0] == pytest.approx(2.0 - RADIUS, abs=1e-9)
    assert {i for i in range(360) if math.isfinite(level[i])} == {i % 360 for i in range(-5, 6)}
    quad.motors(True)
    quad.accelerate((6.0, 0.0, 0.0), 0.0)
    for _ in range(40):
        world.step()
    motion = quad.motion()
    tilt = math.acos(motion.up[2])
    assert tilt > 0.2
    x, _, z = motion.position
    (tilted,) = world.cast_rays([LidarMount((0.0, 0.0, z), 360, 6.0)])
    # Level through its centre it is narrower along the way than its diameter, for its top or its bottom cuts it.
    half = min(RADIUS / math.cos(tilt), 0.06 / math.sin(tilt))
    assert tilted[0] == pytest.approx(x - half, abs=1e-6)
    own = world.cast_rays([LidarMount((x, 0.0, z), 360, 6.0, quad.rigid.number)])[0]
    assert not np.isfinite(own).any(), "it does not see itself"
    world.close()

"""The simulated base station: what it measures, when it tells it, and to whom."""

from __future__ import annotations

import math

import pytest

from koordgen.runtime.vehicle.feed import Feed
from targets.sim.base.bodies import BodyState, DeviceContext
from targets.sim.sensing.station import BaseStation, SimulatedFeed, fed

KEY = bytes(range(32))


class Moving:
    """Along x at 1 m/s; its yaw is 2 rad."""

    def __init__(self) -> None:
        self.now = 0.0

    def state(self) -> BodyState:
        return BodyState((self.now, 2.0, 1.5), (1.0, 0.0, 0.0), 2.0, 0.0)


def context(**harness: float) -> DeviceContext:
    return DeviceContext("bert", {}, harness, (47.0, 8.0, 488.0), 7, KEY)


def run(seconds: float, body: Moving, station: BaseStation) -> list[tuple[float, bytes]]:
    told = []
    for i in range(round(seconds * 240) + 1):
        body.now = i / 240
        if (datagram := station.sample(body.now, body.now)) is not None:
            told.append((body.now, datagram))
    return told


def test_fifty_a_second_and_the_same_for_the_same_seed() -> None:
    first, second = (run(1.0, body, BaseStation(body, context(position_noise=0.01))) for body in (Moving(), Moving()))
    assert first == second and len(first) in (49, 50, 51)


def test_noise_is_as_large_as_it_was_asked_for() -> None:
    body, feed = Moving(), Feed("bert", KEY)
    errors = []
    for now, datagram in run(40.0, body, BaseStation(body, context(position_noise=0.02))):
        assert feed.receive(datagram, now) and feed.pose is not None
        errors.append(feed.pose.position.y - 2.0)
    assert math.sqrt(sum(e * e for e in errors) / len(errors)) == pytest.approx(0.02, rel=0.1)


def test_a_delay_is_kept_and_not_told() -> None:
    body, feed = Moving(), Feed("bert", KEY)
    for now, datagram in run(1.0, body, BaseStation(body, context(position_delay=0.1))):
        assert feed.receive(datagram, now) and feed.pose is not None
        assert feed.pose.position.x == pytest.approx(max(0.0, now - 0.1), abs=0.005)
        assert feed.time == pytest.approx(now)


@pytest.mark.parametrize(
    ("settings", "setting"),
    [
        ({"position": "udp:0.0.0.0:47300"}, "position"),
        ({"positioning": "own", "feed": "udp:0.0.0.0:47300"}, ""),
        ({"positioning": "vision", "feed": "udp:0.0.0.0:47300"}, "feed"),
        ({}, ""),
    ],
)
def test_who_is_fed(settings: dict[str, str], setting: str) -> None:
    assert fed(settings) == setting


def test_the_agents_setting_is_pointed_at_it() -> None:
    feed = SimulatedFeed(Moving(), context(), "feed")
    try:
        assert list(feed.overrides) == ["feed"] and feed.overrides["feed"].startswith("udp:127.0.0.1:")
    finally:
        feed.close()

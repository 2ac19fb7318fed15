"""An independent client, MAVSDK, flies the simulated autopilots: real processes, real UDP on loopback."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from benchmarks.fixtures.quad_rig import ORIGIN
from koordgen.runtime.values.geodesy import LocalFrame

pytest.importorskip("mavsdk")

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.offboard import Offboard, OffboardError, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.telemetry import LandedState, Telemetry

FRAME = LocalFrame(*ORIGIN)
SPEED = 2.0  # times faster than real time
PATIENCE = 10.0  # seconds


def eventually(what: Callable[[], bool]) -> bool:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if what():
            return True
        time.sleep(0.02)
    return False


def started(offboard: Offboard) -> bool:
    """PX4 lets nobody in before setpoints have come for a second."""
    try:
        offboard.start()
    except OffboardError:
        return False
    return True


def armed(action: Action) -> bool:
    """ArduPilot refuses as long as its IMUs disagree."""
    try:
        action.arm()
    except ActionError:
        return False
    return True


@pytest.fixture(params=["ardupilot", pytest.param("px4", marks=pytest.mark.slow)])
def client(request: pytest.FixtureRequest) -> Iterator[tuple[Telemetry, Action, Offboard]]:
    """MAVSDK's views of an autopilot that flies in a process of its own."""
    command = [sys.executable, "-m", "tests.sim.autopilots.flown_alone", request.param, str(SPEED)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=Path(__file__).parents[3]) as process:
        assert process.stdin is not None and process.stdout is not None
        port = int(process.stdout.readline())
        try:
            with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
                mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
                system = mavsdk.first_autopilot(PATIENCE)
                assert system is not None
                yield Telemetry(system), Action(system), Offboard(system)
        finally:
            process.stdin.close()


def test_a_whole_flight(client: tuple[Telemetry, Action, Offboard]) -> None:
    telemetry, action, offboard = client
    for ask in ("position", "home", "landed_state", "battery", "gps_info", "health", "position_velocity_ned"):
        getattr(telemetry, f"set_rate_{ask}")(5.0)
    assert eventually(telemetry.health_all_ok), telemetry.health()
    assert telemetry.gps_info().num_satellites >= 6 and telemetry.battery().remaining_percent > 90

    def away(east: float, north: float, up: float) -> float:
        at = telemetry.position()
        here = FRAME.enu(at.latitude_deg, at.longitude_deg, at.absolute_altitude_m)
        return math.dist(here, (east, north, up))

    action.set_takeoff_altitude(2.0)
    assert eventually(lambda: armed(action))
    assert eventually(telemetry.armed)
    action.takeoff()
    assert eventually(lambda: away(0.0, 0.0, 2.0) < 0.15)
    latitude, longitude, altitude = FRAME.geodetic(0.0, 2.0, 2.0)
    action.goto_location(latitude, longitude, altitude, 0.0)
    assert eventually(lambda: away(0.0, 2.0, 2.0) < 0.15)

    offboard.set_position_ned(PositionNedYaw(2.0, 1.0, -2.0, 0.0))
    assert eventually(lambda: started(offboard))
    assert eventually(lambda: away(1.0, 2.0, 2.0) < 0.15)
    offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.5, 0.0, 0.0))
    assert eventually(lambda: telemetry.position_velocity_ned().velocity.east_m_s > 0.45)
    offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -2.0, 0.0))
    assert eventually(lambda: away(0.0, 0.0, 2.0) < 0.15)

    action.land()
    assert eventually(lambda: not telemetry.armed())
    assert eventually(lambda: telemetry.landed_state() == LandedState.ON_GROUND) and away(0.0, 0.0, 0.0) < 0.2

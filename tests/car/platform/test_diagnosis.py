"""What a car's diagnosis says of its drive, its position feed and its settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from targets.car.base.settings import decode
from targets.car.drive import vesc
from targets.car.platform.diagnosis import limits
from targets.car.platform.platform import Car
from tests.car.platform.world import FENCE, KEY, NoLinks, TestBody, World, robot_settings


@pytest.mark.parametrize(
    ("dead", "name", "message"), [("controller", "drive", "motor controller"), ("station", "position", "no position")]
)
def test_diagnosis_says_what_is_missing_and_looks_at_the_rest(dead: str, name: str, message: str) -> None:
    world = World()
    setattr(world, dead, None)
    found = {f.name: f for f in world.car.diagnose()}
    assert [f.name for f in found.values() if f.state == "fail"] == [name]
    assert message in found[name].found and found[name].why


def test_diagnosis_of_a_controller_with_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    assert world.controller is not None
    answer = vesc.encode(vesc.Version(5, 2)) + vesc.encode(vesc.Values(0.0, 9.0, 3))
    monkeypatch.setattr(world.controller, "step", lambda received, now: answer)
    found = world.car.diagnose()[0]
    assert found.state == "fail" and "VESC firmware 5.2" in found.found and "fault 3" in found.found


def test_diagnosis_of_links_that_cannot_be_opened() -> None:
    car = Car(robot_settings({}), KEY, NoLinks())
    found = {f.name: f for f in car.diagnose()}
    assert (found["drive"].state, found["drive"].found, found["drive"].why) == ("fail", "cannot open it", "plug it in")


@pytest.mark.parametrize(("every", "state"), [(5, "ok"), (8, "warn"), (25, "fail")])
def test_diagnosis_of_a_feed_that_is_too_slow(every: int, state: str) -> None:
    """Of 50 samples a second each fifth, eighth and 25th arrives."""
    world = World()
    assert world.station is not None
    station, seen = world.station, iter(range(10_000))

    class Thin:
        def sample(self, now: float, sent: float) -> bytes | None:
            datagram = station.sample(now, sent)
            return datagram if datagram is not None and next(seen) % every == 0 else None

    world.station = Thin()  # type: ignore[assignment]
    found = {f.name: f for f in world.car.diagnose()}
    assert found["position"].state == state, found


@pytest.mark.parametrize(
    ("settings", "state", "told"),
    [
        ({}, "ok", "turning radius 0.91 m"),
        ({"wheelbase": 3.0}, "fail", "turning radius 8."),
        ({"steering_to_servo_gain": -2.0}, "warn", "steers 0.23 rad"),
        ({"max_acceleration": 4.0, "braking": 1.0}, "fail", "brakes with 1 m/s^2"),
        ({"drive": "rover:udpin:0.0.0.0:14550", "full_speed": 2.0}, "ok", "1 m/s are 50% of the throttle"),
        ({"max_speed": 10.0, "speed_to_erpm_gain": 11_000.0}, "warn", "110000 ERPM"),
    ],
)
def test_settings_that_do_not_fit(settings: dict[str, Any], state: str, told: str) -> None:
    found = limits(decode(settings), FENCE)
    assert found.state == state and told in found.found, found


def test_diagnosis_of_a_car_outside_the_fence() -> None:
    found = {f.name: f for f in World(TestBody(x=9.0)).car.diagnose()}
    assert found["place"].state == "fail" and "(9.0" in found["place"].found and found["position"].state == "ok"


def test_diagnosis_of_a_missing_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import builtins

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # CasADi drives only where the solver is not compiled
    monkeypatch.setenv("PATH", "")

    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "casadi":
            raise ImportError("No module named 'casadi'")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    (found,) = (f for f in World().car.diagnose() if f.state == "fail")
    assert found.name == "controller" and "casadi" in found.found


@pytest.mark.parametrize(("volts", "state"), [(11.1, "ok"), (8.4, "ok"), (12.6, "ok"), (9.6, "warn"), (6.6, "warn")])
def test_diagnosis_of_an_empty_battery(volts: float, state: str, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World()
    assert world.controller is not None
    answer = vesc.encode(vesc.Version(6, 5)) + vesc.encode(vesc.Values(0.0, volts))
    monkeypatch.setattr(world.controller, "step", lambda received, now: answer)
    assert world.car.diagnose()[0].state == state

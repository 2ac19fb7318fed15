"""Squads of a fleet file: the form of their entries, and chains of fleet files that name one another."""

from __future__ import annotations

import pytest

from koordgen.fleet import file as fleet
from koordgen.fleet import manifest
from koordgen.fleet.address import outer_port
from koordgen.fleet.squads import nesting
from koordgen.lang.source import Source, Span

TARGETS = {name: manifest.load(name) for name in manifest.available()}
HEAD = "delta: 0.3\norigin: {latitude: 0, longitude: 0, altitude: 0}\ngeofence: {lo: [-9, -9, 0], hi: [9, 9, 2]}\n"
CAR = "  - {name: dora, target: car, address: 127.0.0.1:47100}\n"


def read(entry: str, more: str = "") -> tuple[fleet.Fleet | None, list[str]]:
    """Read a fleet of a car and a robot with this entry in line 6. Return each error with its place."""
    found: list[str] = []

    def report(code: str, message: str, span: Span, help: str) -> None:
        found.append(f"{span.line}:{span.column}: {code} {message} ({help})")

    text = f"{HEAD}robots:\n{CAR}  - {{{entry}}}\n{more}"
    return fleet.read(Source("outer.yaml", text), TARGETS, {}, report), found


def test_a_squad_has_a_name_and_a_fleet_file() -> None:
    found, errors = read("name: alpha, inner: a/alpha.yaml, ports: [10.0.0.1:9, 10.0.0.2:9]")
    assert errors == [] and found is not None
    (squad,) = found.squads
    assert squad.inner is not None and squad.inner.file == "a/alpha.yaml" and squad.pid == 1
    assert squad.inner.addresses == (("10.0.0.1", 9), ("10.0.0.2", 9))
    assert (squad.host, squad.port, squad.target, squad.login) == ("10.0.0.1", 9, "", None)


@pytest.mark.parametrize("key", ["target: quad", "address: 127.0.0.1:9", "start: {position: [0, 0, 0]}", "settings: {}",
                                 "host: pi@a.local", "control: 9", "sim: {}"])  # fmt: skip
def test_what_the_inner_robots_have_cannot_stand_in_the_entry(key: str) -> None:
    _, (error,) = read(f"name: alpha, inner: a.yaml, {key}")
    name = key.partition(":")[0]
    assert f"F002 robot 1 is a fleet (`inner`), so it cannot have {name!r}" in error
    assert "remove" in error or "ports" in error


@pytest.mark.parametrize(
    ("entry", "error"),
    [
        ("name: alpha, inner: [a]", "6:26: F004 robot 1's inner must be a text"),
        ("name: alpha, inner: a.yaml, ports: []", "6:41: F005 robot 1's ports is empty (remove it,"),
        ("name: alpha, inner: a.yaml, ports: [x]", "6:42: F005 an address in robot 1's ports 'x' is not HOST:PORT"),
        ("name: alpha, inner: a.yaml, ports: [b:1, b:1]", "6:47: F006 the ports of robot 1 name b:1 twice"),
        ("name: dora, inner: a.yaml", "6:12: F006 name dora is already robot 0's name"),
        ("inner: a.yaml", "6:5: F003 robot 1 lacks 'name'"),
    ],
)
def test_wrong_entries(entry: str, error: str) -> None:
    _, errors = read(entry)
    assert len(errors) == 1 and errors[0].startswith(error), errors


def test_a_squad_cannot_land_for_a_monitor() -> None:
    _, (error,) = read("name: alpha, inner: a.yaml", "monitors: {default: land}\n")
    assert "'land', which these robots cannot do: dora, alpha" in error
    found, errors = read("name: alpha, inner: a.yaml", "monitors: {default: hold}\n")
    assert found is not None and errors == []


def test_default_ports_for_the_outer_fleet() -> None:
    assert [outer_port(port) for port in (47100, 63535, 63536)] == [49100, 65535, 61536]


def test_chains_of_fleet_files() -> None:
    def fleets(**named: list[str]) -> list[str]:
        texts = {
            f"{name}.yaml": Source(name, "robots:\n" + "".join(f"  - {{inner: {file}}}\n" for file in files))
            for name, files in named.items()
        }
        return nesting("a.yaml", texts.get, "outer.yaml")

    assert fleets(a=[]) == ["outer.yaml", "a.yaml"]
    assert fleets() == ["outer.yaml", "a.yaml"], "a file that cannot be read names none"
    assert fleets(a=["b.yaml"], b=["c.yaml"]) == ["outer.yaml", "a.yaml", "b.yaml", "c.yaml"]
    assert fleets(a=["b.yaml", "./outer.yaml"]) == ["outer.yaml", "a.yaml", "outer.yaml"]
    assert fleets(a=["b.yaml"], b=["x/../a.yaml"]) == ["outer.yaml", "a.yaml", "b.yaml", "a.yaml"]

"""Programs, fleet files and bundles for tests; the bundles are those of LineForm for fleets of one target."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import msgspec

from koordgen.build.bundle.plan import Files, plan, read_ingredients
from koordgen.build.pipeline import check_file
from koordgen.fleet import manifest
from koordgen.fleet.file import Fleet, read
from koordgen.lang import resources
from koordgen.lang.source import Source, Span
from koordgen.runtime.config.settings import Settings

ROOT = Path(__file__).parents[1]
LINEFORM = ROOT / "examples/lineform/lineform.koord"
COMPOSED = ("survey",)  # examples whose programs import from one another, so that a fleet file names all of them
SQUADS = "squads"  # example whose program takes the commands of an outer program

# Beginning of a fleet file with a quad and a car; the entries of `applications` follow.
QUAD_AND_CAR = """\
delta: 0.1
origin: {latitude: 47.0, longitude: 8.0, altitude: 400.0}
geofence: {lo: [-9, -9, 0], hi: [9, 9, 4]}
insecure: true
robots:
  - {name: alice, target: quad, address: 127.0.0.1:47100, start: {position: [0, 0, 1]}}
  - {name: bert, target: car, address: 127.0.0.1:47101, start: {position: [3, 0, 1]}}
applications:
"""


def programs_alone() -> list[Path]:
    """Return the programs of all examples that run alone."""
    return sorted(path for path in ROOT.glob("examples/*/*.koord") if path.parent.name not in (*COMPOSED, SQUADS))


def fleet_of(target: str, size: int = 2) -> Fleet:
    """Return a fleet of one target on loopback; robots are named `<target>-<pid>`."""
    robots = "".join(
        f"  - {{name: {target}-{pid}, target: {target}, address: '127.0.0.1:{47900 + pid}'}}\n" for pid in range(size)
    )
    text = (
        "delta: 0.1\norigin: {latitude: 47.4, longitude: 8.5, altitude: 400.0}\n"
        f"geofence: {{lo: [-5, -5, -1], hi: [5, 5, 4]}}\nrobots:\n{robots}"
    )

    def report(code: str, message: str, span: Span, help: str) -> None:
        raise AssertionError(f"{code} {span}: {message} {help}")

    found = read(Source("fleet.yaml", text), {n: manifest.load(n) for n in manifest.available()}, {}, report)
    assert found is not None
    return found


@cache
def build(target: str, source: Path = LINEFORM) -> dict[str, Files]:
    """Return a program's bundles for a fleet of two robots of this target."""
    program = check_file(str(source)).program
    ingredients = read_ingredients(
        program, source.read_bytes(), (manifest.load(target),), fleet_of(target), resources.package()
    )
    return plan(ingredients, [target])


def settings_of(target: manifest.Target) -> Settings:
    """Return the settings of robot 0 in that fleet, as its agent reads them."""
    raw = json.loads(build(target.name)[f"{target.name}-0"]["settings.json"])
    return msgspec.convert(raw, Settings)

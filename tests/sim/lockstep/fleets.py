"""Two fleets in one world, for tests: the sim bundles of two programs as one bundle."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from targets.sim.base.fleets import OF_FLEET

PROGRAMS = ("program*.py", "properties*.py", "applications.py", "*_functions.py")


def together(outer: Path, name: str, inner: Path) -> Path:
    """Add the fleet of the sim bundle `inner` to that of `outer`, as the fleet `name`. Return `outer`."""
    first, second = _scenario(outer), _scenario(inner)
    count = len(first["robots"])
    fleets = [
        {"name": "", "members": list(range(count)), **_of_fleet(first)},
        {"name": name, "members": list(range(count, count + len(second["robots"]))), **_of_fleet(second)},
    ]
    for robot in second["robots"]:
        named = f"{name}.{robot['name']}"
        shutil.copytree(inner / robot["bundle"], outer / "agents" / named)
        first["robots"].append({**robot, "name": named, "pid": len(first["robots"]), "bundle": f"agents/{named}"})
    programs = outer / "fleets" / name
    programs.mkdir(parents=True)
    for pattern in PROGRAMS:
        for file in inner.glob(pattern):
            shutil.copy(file, programs)
    shutil.copytree(inner / "source", programs / "source")
    (outer / "scenario.json").write_text(json.dumps({**first, "fleets": fleets}))
    return outer


def _scenario(bundle: Path) -> Any:
    return json.loads((bundle / "scenario.json").read_text())


def _of_fleet(scenario: Any) -> dict[str, Any]:
    return {field: scenario[field] for field in OF_FLEET if field in scenario}

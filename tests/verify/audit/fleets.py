"""Fleets on a simulated clock whose robots' own traces are audited, with the simulator's Watcher for comparison."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from benchmarks.fixtures.fleet import NAMES
from koordgen.cli import main
from koordgen.runtime.net.network import Conditions
from tests.sim.judging.watched import LINE as TURNS
from tests.sim.judging.watched import Watched

LINE = (
    TURNS
    + """\
Chase:
  pre: pid == 0 and N_SYS > 2 and turns[0] < 30
  eff:
    Motion.target = x[2]
    turns[pid] += 1
initially: forall i in ID: Motion.target[i] == Motion.position[i] and sum == 0 and mine[i] == 0
"""
)
# What is true, and what some run makes false, of ports, locals and the store.
FORMULAS = {
    "Apart": "forall i, j in ID: i == j or distance(Motion.position[i], Motion.position[j]) > 0.9",
    "Near": "forall i in ID: distance(x[i], Motion.position[i]) < 1",
    "Counted": "forall i in ID: mine[i] <= 6 and turns[2] == 0",
    "Sum": "sum <= 9",
    "Mine": "forall i in ID: mine[i] < 4 or i == 0",
    "Turns": "forall i in ID: turns[i] <= 12",
    "First": "sum == 0 or exists i in ID: mine[i] > 0",
    "Value": "forall i in ID: 1 / (5 - mine[i]) < 2 or True",
    "Sent": "forall i in ID: distance(Motion.target[i], x[0]) < 9",
}
PROGRAM = LINE + "".join(f"invariant {name}: {formula}\n" for name, formula in FORMULAS.items())


def watched(folder: Path, text: str = PROGRAM, **options: Any) -> Watched:
    folder.mkdir(parents=True, exist_ok=True)
    return Watched(folder, text, **options)


def conditions(loss: float) -> Conditions:
    return Conditions(loss=loss, delay=0.001, jitter=0.02, duplication=loss)


def saved(folder: Path, fleet: Watched, text: str = PROGRAM) -> Path:
    """A folder with each robot's own trace, as copied home, and the program beside it."""
    home = folder / "home"
    (home / "source").mkdir(parents=True, exist_ok=True)
    (home / "source/a.koord").write_text(text)
    for pid, file in fleet.files.items():
        (home / f"{NAMES[pid]}.jsonl").write_bytes(file.getvalue())
    return home


def audited(*arguments: object) -> tuple[int, Any]:
    """The exit status and the document."""
    out = io.StringIO()
    with redirect_stdout(out):
        status = main(["audit", *map(str, arguments), "--format", "json"])
    return status, json.loads(out.getvalue()) if out.getvalue() else None


def by_name(document: Any) -> dict[str, Any]:
    """Its properties, by name or what they are of; of assumptions of one module the first that is not held."""
    found: dict[str, Any] = {}
    for each in document["properties"]:
        name = each["name"] or each["of"]
        if name not in found or found[name]["verdict"] == "held":
            found[name] = each
    return found


def disagreements(verdicts: Mapping[str, Any], properties: Mapping[str, Any], delta: float) -> list[str]:
    """Where the simulator, which sees the truth at all steps, and the audit, which sees samples at round boundaries, do
    not go together. `verdicts`: outcome and since by name."""
    found = []
    for name, verdict in verdicts.items():
        mine = properties[name]
        outcome, since = verdict["outcome"], verdict["since"]
        bad = mine["verdict"] in ("violated", "no value")
        at = mine["first"]["seconds"] if bad else None
        if outcome in ("violated", "no value"):
            fits = mine["verdict"] == outcome and at is not None and since - 0.01 <= at <= since + delta + 0.01
        elif outcome == "out of model":
            fits = at is None
        else:
            # The traces of a fleet do not all end in the same round.
            unseen = mine["of"] == "assume" and mine["unknown"] > 0
            fits = mine["verdict"] == outcome or (mine["verdict"] == "unknown" and (unseen or outcome == "unchecked"))
        if not fits:
            found.append(f"{name}: {outcome} since {since}, audit {mine['verdict']} at {at}")
    return found

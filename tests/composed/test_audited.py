"""Audit of several applications: it judges as the executable semantics does, and names application, round and robot."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any

import pytest

from benchmarks.fixtures.fleet import NAMES
from koordgen.build.emit.system import with_sizes
from koordgen.cli import main
from koordgen.lang.semantics.composition import Application, System
from koordgen.lang.semantics.property import holds_property
from koordgen.lang.semantics.system import (
    InstanceStep,
    SystemState,
    applied_to_system,
    initial_system,
    run_inits,
    system_round,
    view,
)
from koordgen.runtime.trace.schema import FORMAT, Header, RobotName
from koordgen.verify.audit.history import mission, of_application
from koordgen.verify.audit.judge import PropertyJudge
from koordgen.verify.audit.properties import GeneratedProperties
from koordgen.verify.audit.result import PropertyResult
from koordgen.verify.audit.shared_store import AuditedFleet
from koordgen.verify.audit.trace_files import read_trace_file, trace_files
from tests.composed.agents import Applied, ComposedAgents
from tests.lang.semantics.compositions import NAMES as APPLICATIONS
from tests.lang.semantics.compositions import compiled, text
from tests.verify.replay.runs import save_traces

ROUNDS = 15
LIMIT = 5
SURVEY = Path(__file__).parents[2] / "examples/survey/fleet.yaml"
PROPERTIES = """\
invariant Low: {a} < {limit} and forall i in ID: k[i] < 6
invariant Slots: forall i in ID: {x}[i] + {b} < 7
{more}"""


def judged_system(seed: int) -> System:
    """Return a random composition whose programs have invariants, and guarantees of what others may write."""
    rng = Random(seed)
    applications = []
    for index, name in enumerate(APPLICATIONS[: rng.randrange(2, 4)]):
        exporters = [other for other in APPLICATIONS[:index] if rng.random() < 0.8]
        members = tuple(sorted(rng.sample(range(3), rng.randrange(1, 4))))
        a = f"{name}_a"
        exported = f"  write int {a}\n"
        kept = f"    guarantee Under: {a} < {LIMIT}\n    guarantee Grows: {a} <= {a}' + 1\n"
        made = text(rng, name, exporters).replace(exported, exported + kept, 1)
        more = "".join(f"invariant Of{e.title()}: {e}_a + sum({e}_x) < {rng.randrange(4, 12)}\n" for e in exporters)
        made += PROPERTIES.format(a=a, b=f"{name}_b", x=f"{name}_x", limit=rng.randrange(3, 8), more=more)
        bindings = tuple([(exporter.title(), exporter) for exporter in exporters])
        applications.append(Application(name, compiled(name, made), members, bindings))
    return System(tuple(applications), 3)


def flown(folder: Path, agents: ComposedAgents) -> Path:
    """Write the traces of agents as a run leaves them."""
    system = agents.system
    robots = tuple([RobotName(NAMES[robot], robot, "fake") for robot in range(system.robots)])
    names = tuple([application.name for application in system.applications])
    header = Header(FORMAT, "+".join(names), "1" * 16, agents.fleet.delta, 0, robots, applications=names)
    save_traces(folder, header, agents.files, agents.fleet.time.time)
    return folder


def audited(system: System, *paths: Path) -> list[dict[str, PropertyResult]]:
    """Return the results of each application's properties, by their names."""
    sized = with_sizes(system)
    whole = mission([read_trace_file(file) for path in paths for file in trace_files(path)])
    fleet = AuditedFleet(sized, tuple([of_application(whole, each) for each in sized.applications]))
    judges = [
        PropertyJudge(GeneratedProperties(each.program, None), fleet, index)
        for index, each in enumerate(sized.applications)
    ]
    return [{result.name: result for result in judge.run(lambda *_: None)} for judge in judges]


def rounds_of(agents: ComposedAgents) -> Iterator[tuple[int, SystemState, SystemState, list[InstanceStep]]]:
    """Yield each round by the semantics: its number, the states before and after it, and its steps."""
    numbers = range(len(agents.system.instances()))
    state, _ = run_inits(agents.system, initial_system(agents.system))
    for round_ in range(1, ROUNDS + 1):
        records = [agents.records.get((number, round_)) for number in numbers]
        applied = agents.applied.get(round_, Applied())
        skipping = {number for number in numbers if agents._is_skipped(number, records[number], applied)}
        after, steps = system_round(agents.system, state, skipping)
        yield round_, state, after, steps
        state = after


def agrees(folder: Path, seed: int) -> set[str]:
    """Compare the audit of a run with the semantics, round by round. Return the outcomes that occurred."""
    system, seen = judged_system(seed), set[str]()
    agents = ComposedAgents(system, seed).run(ROUNDS)
    found = audited(system, flown(folder, agents))
    for round_, before, after, steps in rounds_of(agents):
        for index, application in enumerate(system.applications):
            program, results = application.program, found[index]
            for property_ in program.properties:
                holds = holds_property(property_, program, view(system, after, index))
                outcome = results[property_.name].at(round_)
                assert outcome == ("held" if holds else "violated"), (round_, application.name, property_.name)
                seen.add(outcome)
            states = [before]
            for step in steps:
                states.append(applied_to_system(system, states[-1], step))
            values: list[Any] = [state.stores[index].cells[f"{application.name}_a"] for state in states]
            grows = all(x <= y + 1 for x, y in pairwise(values))
            assert results["Grows"].at(round_) == ("held" if grows else "violated"), (round_, application.name, values)
            assert results["Under"].at(round_) == ("held" if values[-1] < LIMIT else "violated")
    return seen


@pytest.mark.parametrize("seed", range(8))
def test_an_audit_judges_as_the_semantics_does(tmp_path: Path, seed: int) -> None:
    agrees(tmp_path, seed)


@pytest.mark.slow
def test_audits_of_100_compositions_judge_as_the_semantics_does(tmp_path: Path) -> None:
    seen = set[str]()
    for seed in range(8, 108):
        seen |= agrees(tmp_path / str(seed), seed)
    assert seen == {"held", "violated"}


def test_without_a_robots_trace_its_values_are_unknown(tmp_path: Path) -> None:
    """The store is known from the copies of other robots; variables of the robot alone are unknown."""
    owner = compiled("owner", "local: int k\nallwrite: int n\nGo:\n  pre: k < 90\n  eff:\n    k += 1\n    n = 1\n"
                              "export:\n  write int n\n    guarantee Up: n <= n' + 5\n"
                              "invariant Own: forall i in ID: k[i] >= 0\n")  # fmt: skip
    reader = compiled("reader", "import Owner:\n  write int n\nlocal: int s\nRead:\n  pre: True\n  eff: s = n\n"
                                "invariant Small: n < 9\ninvariant Seen: forall i in ID: s[i] < 9\n")  # fmt: skip
    system = System(
        (Application("owner", owner, (0,)), Application("reader", reader, (1, 2), (("Owner", "owner"),))), 3
    )
    folder = flown(tmp_path, ComposedAgents(system).run(ROUNDS))
    robots = {name: folder / "robots" / name for name in NAMES[:3]}
    whole = audited(system, *robots.values())
    assert {r.verdict for of in whole for r in of.values()} == {"held"}
    owner_results, reader_results = audited(system, robots[NAMES[1]], robots[NAMES[2]])
    assert owner_results["Own"].verdict == "unknown"
    assert reader_results["Seen"].verdict == reader_results["Small"].verdict == "held"


SWAPS = """\
export:
  int n
    guarantee Up: n <= n'
allwrite: int n
local: int k
Go:
  pre: k < 90
  eff:
    k += 1
    n = 5 * (1 - pid)
"""


def test_a_write_that_breaks_a_guarantee_is_named_and_a_missing_one_is_not_held(tmp_path: Path) -> None:
    """Two robots write 5 and then 0 in each round, so the values at its ends do not show the write that breaks it."""
    reader = compiled("reader", "import Owner:\n  int n\nlocal: int s\nRead:\n  pre: True\n  eff: s = n\n")
    bound = (("Owner", "owner"),)
    system = System(
        (Application("owner", compiled("owner", SWAPS), (0, 1)), Application("reader", reader, (2,), bound)), 3
    )
    folder = flown(tmp_path, ComposedAgents(system).run(ROUNDS))
    robots = [folder / "robots" / name for name in NAMES[:3]]
    up = audited(system, *robots)[0]["Up"]
    assert up.first is not None and up.first.observation.round == 1
    assert up.first.read == (f"by Go of owner on {NAMES[1]}",) and up.first.robots == (NAMES[1],)
    for traces in ((1, 2), (0, 2), (2,)):
        assert audited(system, *[robots[robot] for robot in traces])[0]["Up"].verdict == "unknown", traces


def edited(path: Path, change: Callable[[dict[str, Any]], bool]) -> None:
    """Change the first record that `change` accepts."""
    lines = path.read_text().splitlines()
    for number, line in enumerate(lines):
        record = json.loads(line)
        if change(record):
            lines[number] = json.dumps(record)
            path.write_text("\n".join(lines) + "\n")
            return
    raise AssertionError("no record was changed")


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("survey") / "run"
    assert main(["sim", str(SURVEY), "--lockstep", "--duration", "2", "--no-report", "--out", str(folder)]) in (0, 3)
    return folder


def test_the_command_audits_a_run_of_several_applications(survey: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["audit", str(survey)]) == 4, "spec functions are unchecked"
    text = capsys.readouterr().out
    assert "mapping: mapper.koord, 2 of 2 robots" in text and "task: task.koord, 2 of 2 robots" in text
    assert main(["audit", str(survey), "--format", "json"]) == 4
    found = json.loads(capsys.readouterr().out)
    assert [part["application"] for part in found["applications"]] == ["mapping", "task"]
    assert main(["replay", str(survey)]) == 0


def test_a_violation_names_application_robot_and_round(
    survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(survey, folder)

    def leaves(record: dict[str, Any]) -> bool:
        if record["kind"] != "round" or record["round"] != 5 or record["application"] != "task":
            return False
        record["sensors"]["Motion.position"] = [50.0, 0.0, 0.0]
        return True

    edited(folder / "trace.jsonl", leaves)
    capsys.readouterr()
    assert main(["audit", str(folder), "--plot", str(tmp_path / "audit.png")]) == 3
    text = capsys.readouterr().out
    mapping, _, task = text.partition("task: task.koord")
    assert (
        "violated" not in mapping.splitlines()[3]
        and "is violated (task.koord:" in task
        and "round 4 at its end" in task
    )
    assert (tmp_path / "audit.png").stat().st_size > 1000


def test_a_trace_of_another_fleet_file_or_without_its_programs_is_refused(
    survey: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(survey / "robots" / "alice" / "trace.jsonl")]) == 0, "the run's trace names the programs"
    own = shutil.copy(survey / "robots" / "alice" / "trace.jsonl", tmp_path / "alice.jsonl")
    capsys.readouterr()
    assert main(["audit", str(own)]) == 2
    assert "name the fleet file with --fleet" in capsys.readouterr().err
    other = tmp_path / "survey"
    shutil.copytree(SURVEY.parent, other)
    (other / "fleet.yaml").write_text((other / "fleet.yaml").read_text().replace("resolution: 0.25", "resolution: 0.5"))
    assert main(["audit", str(own), "--fleet", str(other / "fleet.yaml")]) == 1
    assert "programs with the hash" in capsys.readouterr().err
    assert main(["replay", str(own), "--fleet", str(SURVEY)]) == 0
    assert main(["audit", str(own), "--program", "x.koord"]) == 2

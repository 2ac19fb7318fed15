"""Counterexamples of several applications, run by the very agents: they come to the same violation, or say why not."""

from __future__ import annotations

import json
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from tests.sim.follow.following import Followed, follow_fleet
from tests.sim.follow.test_follow import records

ROBOTS = """\
delta: 0.05
origin: {latitude: 47.4, longitude: 8.5, altitude: 400.0}
geofence: {lo: [-9, -9, -1], hi: [90, 9, 9]}
insecure: true
sim: {fidelity: simple}
robots:
  - {name: ann, target: car, address: "127.0.0.1:47900", start: {position: [0, 0, 0]}}
  - {name: bob, target: car, address: "127.0.0.1:47901", start: {position: [3, 0, 0]}}
  - {name: cleo, target: car, address: "127.0.0.1:47902", start: {position: [6, 0, 0]}}
applications:
"""
BOTH = """\
  - {name: building, program: building.koord, robots: [ann, bob]}
  - {name: work, program: work.koord, robots: [bob, cleo], import: {Building: building}}
"""
BUILDING = """\
export:
  write List<int> done
    guarantee Kept: len(done) <= len(done')
    guarantee Few: len(done) < {few}
  int at[N_SYS]
allread: int at[N_SYS]
allwrite: List<int> done max 9
Put:
  pre: len(done) < 2
  eff: {put}
invariant Below: len(done) < {below}
"""
WORK = """\
import Building:
  write List<int> done max 9
  int at[Building.N_SYS]
local: int seen
Look:
  pre: len(done) > seen
  eff: seen = len(done)
{more}
invariant Seen: forall i in ID: seen[i] <= len(done) and (seen[i] == 0 or sum(at) > 0)
"""
ATOMIC = "atomic:\n    done.append(pid)\n    at[pid] = 1"
STALE = "\n    done = [pid] if len(done) < 1 or pid == 1 else [0, pid]\n    at[pid] = 1"


def written(
    folder: Path, put: str = ATOMIC, few: int = 9, below: int = 9, more: str = "", applications: str = BOTH
) -> Path:
    """The fleet file of `building` on ann and bob, and `work` on bob and cleo."""
    (folder / "building.koord").write_text(BUILDING.format(put=put, few=few, below=below))
    (folder / "work.koord").write_text(WORK.format(more=more))
    path = folder / "fleet.yaml"
    path.write_text(ROBOTS + applications)
    return path


def found(fleet: Path, *more: str) -> Path:
    """The trace of a counterexample, beside the fleet file."""
    trace = fleet.parent / "cx.jsonl"
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as failed:
        assert main(["explore", str(fleet), "--trace", str(trace), *more]) == 3, failed.getvalue()
    return trace


def confirmed(fleet: Path, name: str, *more: str) -> Followed:
    """Agents execute the counterexample, and the violation is the trace's."""
    trace = found(fleet, *more)
    assert records(trace, "violation")[0]["name"] == name.rpartition(".")[2]
    done = follow_fleet(fleet, trace)
    assert done.status == 3 and "as in the trace" in done.said, done
    assert name == "(deadlock)" or f"{name} " in done.said
    return done


def test_an_invariant_of_an_exporter(tmp_path: Path) -> None:
    done = confirmed(written(tmp_path, below=2), "building.Below", "--no-deadlock")
    (first,) = records(done.folder / "trace.jsonl", "violation")
    assert (first["application"], first["name"], first["what"]) == ("building", "Below", "property")
    causes = [(c["robots"], c["detail"].partition(": ")[2]) for c in records(done.folder / "trace.jsonl", "cause")]
    assert [detail for _, detail in causes] == ["Put of building on ann"] * 2 and causes[0][0] == ["ann"]
    assert records(done.folder / "trace.jsonl", "header")[0]["followed"] == "run"


def test_an_invariant_of_an_importer_after_a_write_of_the_exporter(tmp_path: Path) -> None:
    fleet = written(tmp_path, "done = [] if len(done) > 0 else [1]")
    text = (tmp_path / "building.koord").read_text()
    (tmp_path / "building.koord").write_text(text.replace("    guarantee Kept: len(done) <= len(done')\n", ""))
    done = confirmed(fleet, "work.Seen", "--no-deadlock")
    events = [c["detail"].partition(": ")[2] for c in records(done.folder / "trace.jsonl", "cause")]
    assert events[0].startswith("Put of building on") and any("Look of work on" in each for each in events)


def test_a_state_guarantee(tmp_path: Path) -> None:
    done = confirmed(written(tmp_path, few=2), "building.Few", "--no-deadlock")
    (first,) = records(done.folder / "trace.jsonl", "violation")
    assert first["detail"] == "guarantee building.Few does not hold: done = [0, 0]"
    verdicts = {v["name"]: v["outcome"] for v in records(done.folder / "trace.jsonl", "verdict")}
    assert verdicts == {"Kept": "held", "Few": "violated", "Below": "held", "Seen": "held"}
    monitors = [m for m in records(done.folder / "trace.jsonl", "monitor") if m["outcome"] == "violated"]
    assert {(m["of"], m["name"], m["pid"]) for m in monitors} == {("guarantee", "Few", 0), ("guarantee", "Few", 1)}


def test_a_step_guarantee_that_two_writes_of_one_round_break(tmp_path: Path) -> None:
    """Robot 1 writes one item, on the list of the round's start, where there are two by then."""
    fleet = written(tmp_path, STALE)
    done = confirmed(fleet, "building.Kept", "--no-deadlock")
    (first,) = records(done.folder / "trace.jsonl", "violation")
    assert first["robots"] == ["bob"]
    assert first["detail"].endswith("does not hold: done = [0, 0]; done' = [1]; by Put of building on bob")


def test_a_step_guarantee_that_an_importer_breaks(tmp_path: Path) -> None:
    fleet = written(tmp_path, more="Clear:\n  pre: len(done) > 1\n  eff: atomic: done = []")
    done = confirmed(fleet, "building.Kept", "--no-deadlock")
    assert "by Clear of work on" in records(done.folder / "trace.jsonl", "violation")[0]["detail"]


def test_a_deadlock_of_all_applications(tmp_path: Path) -> None:
    done = confirmed(written(tmp_path), "(deadlock)")
    assert "no event is enabled any more" in done.said and not records(done.folder / "trace.jsonl", "violation")


def test_an_event_without_a_result(tmp_path: Path) -> None:
    more = "Bad:\n  pre: len(done) > 1\n  eff: atomic: seen = 1 // (len(done) - 2)"
    trace = found(written(tmp_path, more=more), "--no-deadlock")
    ending = records(trace, "violation")[0]
    assert (ending["application"], ending["event"]) == ("work", "Bad")
    done = follow_fleet(tmp_path / "fleet.yaml", trace)
    assert done.status == 3 and "Bad of work on" in done.said and "has no result, as in the trace" in done.said


@pytest.mark.parametrize("guaranteed", [True, False])
def test_one_application(tmp_path: Path, guaranteed: bool) -> None:
    """Its trace is that of its program. Without guarantees it is explored as the program alone."""
    applications = "  - {name: only, program: building.koord, robots: [ann, bob, cleo]}\n"
    fleet = written(tmp_path, few=2, below=2, applications=applications)
    if not guaranteed:
        lines = (tmp_path / "building.koord").read_text().splitlines()
        kept = [line for line in lines if "guarantee" not in line]
        (tmp_path / "building.koord").write_text("\n".join(kept) + "\n")
    done = confirmed(fleet, "Below", "--no-deadlock")
    violated = {v["name"] for v in records(done.folder / "trace.jsonl", "violation")}
    assert violated == ({"Below", "Few"} if guaranteed else {"Below"})
    header = records(tmp_path / "cx.jsonl", "header")[0]
    assert "composition" not in header and header["shared"][0]["name"] in ("done", "at")


def changed(trace: Path, change: Any) -> Path:
    """Change each record of a trace."""
    lines = [json.loads(line) for line in trace.read_text().splitlines()]
    trace.write_text("".join(json.dumps(change(each)) + "\n" for each in lines))
    return trace


def test_a_trace_of_another_fleet_is_refused(tmp_path: Path) -> None:
    fleet = written(tmp_path, below=2)
    trace = found(fleet, "--no-deadlock")
    fleet.write_text(fleet.read_text().replace("robots: [bob, cleo]", "robots: [cleo]"))
    done = follow_fleet(fleet, trace)
    assert done.status == 1 and "is the trace of a fleet with the hash" in done.said
    assert f"search for the counterexample again: koordgen explore {fleet}" in done.said
    fleet.write_text(fleet.read_text().replace("name: work", "name: other"))
    done = follow_fleet(fleet, trace)
    assert "is the trace of the applications building, work; " in done.said and "has building, other" in done.said


def test_a_trace_of_applications_does_not_go_with_a_program(tmp_path: Path) -> None:
    fleet = written(tmp_path, below=2)
    trace = found(fleet, "--no-deadlock")
    with redirect_stderr(StringIO()) as failed:
        assert main(["sim", str(tmp_path / "work.koord"), "--fleet", str(fleet), "--follow", str(trace)]) == 2
    assert "is the trace of a fleet file with the applications building, work" in failed.getvalue()


MODEL = """\
export:
  write int n
allwrite: int n
Go:
  pre: n == 0
  eff: n = 1
"""
LATER = """\
import First:
  write int n
Go:
  pre: n == 0
  eff: n = 2
invariant Two: n != 1
"""


def test_an_order_of_instances_that_no_agents_use_is_called_that(tmp_path: Path) -> None:
    """Agents apply the plain write of the later application last, so its value remains."""
    applications = "  - {name: first, program: building.koord, robots: [ann, bob]}\n"
    applications += "  - {name: later, program: work.koord, robots: [cleo], import: {First: first}}\n"
    fleet = written(tmp_path, applications=applications)
    (tmp_path / "building.koord").write_text(MODEL)
    (tmp_path / "work.koord").write_text(LATER)
    trace = found(fleet, "--no-deadlock")

    lines = [json.loads(line) for line in trace.read_text().splitlines()]
    last = [line for line in lines if line.get("round") == 1]
    extra = [
        {**line, "event": "Go" if line["application"] == "later" else None, "shared": {"n": 2}}
        | {"skipped": None if line["application"] == "later" else "another application's step"}
        for line in last
    ]
    place = lines.index(last[0])
    lines[place:place] = extra
    trace.write_text("".join(json.dumps(line) + "\n" for line in lines))
    done = follow_fleet(fleet, trace)
    assert done.status == 4 and "Go of later on robot 2, Go of first on robot 0, in this order: no rounds" in done.said
    assert "then events without a lock by application and ascending pid" in done.said


def test_a_broken_trace_is_refused(tmp_path: Path) -> None:
    fleet = written(tmp_path, below=2)
    trace = found(fleet, "--no-deadlock")
    text = trace.read_text()
    changed(trace, lambda r: {**r, "application": "work"} if r["kind"] == "round" else r)
    done = follow_fleet(fleet, trace)
    assert done.status == 1 and "a broken record" in done.said and "expected 'building'" in done.said
    trace.write_text(text)
    changed(trace, lambda r: {n: v for n, v in r.items() if n != "composition"})
    assert "several applications without a composition" in follow_fleet(fleet, trace).said
    trace.write_text(text)
    changed(trace, lambda r: {**r, "shared": {**r["shared"], "done": [5]}} if r.get("event") == "Put" else r)
    done = follow_fleet(fleet, trace)
    assert done.status == 1 and "done of building on robot 0 is [5] in the trace and [0] by the program" in done.said

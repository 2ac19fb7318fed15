"""Squads in lockstep: fleets that are robots of an outer fleet, with a trace of each fleet."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from koordgen.cli import main
from koordgen.runtime.trace.schema import Header, MemberPose, PoseRecord, Round, TraceRecord
from targets.sim.base.scenario import load
from targets.sim.harness import main as simulate
from targets.sim.lockstep.run import Lockstep
from targets.sim.run.progress import Progress
from targets.sim.run.run import Run
from targets.sim.trace.files import read
from targets.sim.view.data.feed import Feed
from tests.build.squad_files import LINEFORM, OUTER, fleet_files
from tests.sim.lockstep.lockstep import ran

KILLED = 2.0  # seconds of the outer mission, when the host of beta dies


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Squads alpha and beta and the car dora as robots 0, 1 and 2 of LineForm; robots of fidelity `simple`."""
    folder = tmp_path_factory.mktemp("squads")
    *head, dora, beta = OUTER.splitlines(keepends=True)
    fleet_files(folder, "".join([*head, beta, dora]))
    for file in folder.glob("*.yaml"):
        text = file.read_text().replace("target: quad,", "target: quad, sim: {fidelity: simple},")
        file.write_text(text.replace("target: car,", "target: car, sim: {fidelity: simple},"))
    arguments = ["build", str(LINEFORM), "--fleet", str(folder / "outer.yaml"), "--target", "sim"]
    assert main([*arguments, "-o", str(folder / "build")]) == 0
    return folder / "build" / "lineform" / "sim"


@pytest.fixture(scope="module")
def run(bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the host of beta dies in the middle."""
    folder = tmp_path_factory.mktemp("run")
    faults = {"events": [{"at": KILLED, "crash": "beta.eve"}]}
    (folder / "faults.json").write_text(json.dumps(faults))
    ran(bundle, folder / "run", 6, f"--scenario={folder / 'faults.json'}")
    return folder / "run"


def records(trace: Path, kind: type[Any]) -> list[Any]:
    return [record for record in read(trace)[1] if isinstance(record, kind)]


def test_a_squad_is_one_robot_in_the_trace_of_the_outer_fleet(run: Path) -> None:
    header, _ = read(run / "trace.jsonl")
    assert [(r.name, r.pid, r.target) for r in header.robots] == [
        ("alpha", 0, "squad"), ("beta", 1, "squad"), ("dora", 2, "car"),
    ]  # fmt: skip
    squad = {r.t: r.position for r in records(run / "trace.jsonl", PoseRecord) if r.pid == 0}
    inner, _ = read(run / "alpha" / "trace.jsonl")
    assert [r.name for r in inner.robots] == ["ann", "bob", "cyd"]
    last = [r.position for r in records(run / "alpha" / "trace.jsonl", PoseRecord)[-3:]]
    middle = [sum(axis) / 3 for axis in zip(*last, strict=True)]
    assert list(squad[max(squad)]) == pytest.approx(middle, abs=1e-4)
    members = [r for r in records(run / "trace.jsonl", MemberPose) if r.pid == 0][-3:]
    assert [(r.member, r.position) for r in members] == list(zip(("ann", "bob", "cyd"), last, strict=True))


def test_the_summary_names_the_verdict_on_each_squad(run: Path) -> None:
    found = json.loads((run / "summary.json").read_text())
    own = {name: json.loads((run / name / "summary.json").read_text())["verdict"] for name in ("alpha", "beta")}
    assert found["squads"] == own
    assert f"squad alpha: {own['alpha']}; see alpha/summary.txt" in (run / "summary.txt").read_text()
    assert "squads" not in json.loads((run / "alpha" / "summary.json").read_text())


def test_the_outer_robot_goes_on_when_its_host_dies(run: Path) -> None:
    rounds = [r for r in records(run / "trace.jsonl", Round) if r.pid == 1]
    numbers = [r.round for r in rounds]
    assert len(set(numbers)) == len(numbers), "no round is done twice"
    events = [r.t for r in rounds if r.event == "TargetUpdate"]
    assert min(events) < KILLED and max(events) > KILLED + 2
    log = (run / "robots" / "beta" / "log.txt").read_text()
    assert "beta: hosted by beta.eve (term 1)" in log and "beta: hosted by beta.fay (term 2)" in log
    members = records(run / "beta" / "trace.jsonl", Round)
    assert max(r.t for r in members if r.pid == 0) < min(r.t for r in members if r.pid == 1 and r.round > 60)


def test_commands_of_the_outer_robot_reach_the_inner_store_from_each_host(run: Path) -> None:
    commands = [r.actuators["Motion.target"] for r in records(run / "trace.jsonl", Round) if r.actuators and r.pid == 1]
    written = [r for r in records(run / "beta" / "trace.jsonl", Round) if "triangle.goal" in r.shared]
    assert {r.pid for r in written} == {0, 1}, "the first host and the second one"
    assert [bytes(r.shared["triangle.goal"]) for r in written][-1] in [bytes(command) for command in commands[-3:]]


@pytest.mark.parametrize("fleet", ["", "alpha", "beta"])
def test_each_trace_is_replayed_and_audited_by_its_own_program(run: Path, fleet: str) -> None:
    assert main(["replay", str(run / fleet)]) == 0
    assert main(["audit", str(run / fleet)]) == 0


def test_the_two_levels_of_a_run_agree(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(run)]) == 0
    text = capsys.readouterr().out
    found = re.findall(r"/(\w+)/trace.jsonl: (\d+) readings and (\d+) commands of \w+: no differences", text)
    assert [name for name, _, _ in found] == ["alpha", "beta"]
    assert all(int(readings) > 12 for _, readings, _ in found) and int(found[1][2]) > 8, "beta commands, alpha does not"


def test_the_trace_of_one_robot_of_a_squad_is_replayed(
    bundle: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hash in it covers the programs of both levels. They come from the run's folder or from options."""
    trace = run / "robots" / "alpha.ann" / "trace.jsonl"
    assert main(["replay", str(trace)]) == 0
    robots = [str(run / "robots" / name) for name in ("alpha.ann", "alpha.bob", "alpha.cyd")]
    assert main(["audit", *robots]) == 0
    alone = Path(shutil.copy(trace, tmp_path / "ann.jsonl"))
    fleet = bundle.parents[2] / "alpha.yaml"
    capsys.readouterr()
    assert main(["replay", str(alone), "--fleet", str(fleet)]) == 2
    assert "name the outer program with --program" in capsys.readouterr().err
    assert main(["replay", str(alone), "--fleet", str(fleet), "--program", str(LINEFORM)]) == 0
    other = tmp_path / "other.koord"
    other.write_text(LINEFORM.read_text() + "invariant Other: forall i in ID: x[i].z < 100\n")
    assert main(["replay", str(alone), "--fleet", str(fleet), "--program", str(other)]) == 1
    assert "programs with the hash" in capsys.readouterr().err


def test_a_replay_finds_a_command_that_no_host_wrote(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(run / "alpha" / "source", tmp_path / "source")
    lines = (run / "alpha" / "trace.jsonl").read_text().splitlines()
    (number,) = [k for k, line in enumerate(lines) if '"event":"Write"' in line and '"goal":' in line][-1:]
    lines[number] = re.sub(r'("shared":.*"goal":)\[[^]]*\]', r"\1[0,0,0]", lines[number])
    (tmp_path / "trace.jsonl").write_text("".join(f"{line}\n" for line in lines))
    assert main(["replay", str(tmp_path)]) == 3
    assert "application triangle: copy of goal is" in capsys.readouterr().err


class Fed(Feed):
    """Live view that keeps what it would show."""

    def __init__(self, header: Header) -> None:
        super().__init__(header)
        self.shown: list[tuple[float, TraceRecord]] = []

    def _add(self, record: TraceRecord, t: float) -> None:
        self.shown.append((t, record))

    def _reset(self) -> None:
        self.shown.clear()

    def _send(self) -> None: ...

    def flush(self) -> None: ...


@pytest.mark.slow
def test_a_live_view_shows_the_outer_fleet_with_the_robots_of_squads(bundle: Path, run: Path, tmp_path: Path) -> None:
    scenario, folder = load(bundle), tmp_path / "run"
    for fleet in ("alpha", "beta"):
        (folder / fleet).mkdir(parents=True)
    live = Fed(read(run / "trace.jsonl")[0])
    whole = Run(scenario, Lockstep(scenario, bundle, folder, 0), folder, 1.0, Progress(sys.stderr, quiet=True))
    whole.companions.append(live)
    whole.execute()
    rounds = [r for _, r in live.shown if isinstance(r, Round)]
    assert {r.pid for r in rounds} == {0, 1, 2} and {r.application for r in rounds} == {"lineform"}
    last = {
        (r.pid, getattr(r, "member", "")): r.position for _, r in live.shown if isinstance(r, PoseRecord | MemberPose)
    }
    assert len(last) == 9
    middle = [sum(axis) / 3 for axis in zip(*[last[1, name] for name in ("eve", "fay", "gus")], strict=True)]
    assert list(last[1, ""]) == pytest.approx(middle)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_traces(bundle: Path, tmp_path: Path) -> None:
    for k in range(2):
        ran(bundle, tmp_path / str(k), 1, "--seed=4", hashing=str(k * 7919))
    for trace in ("trace.jsonl", "alpha/trace.jsonl", "beta/trace.jsonl"):
        assert (tmp_path / "0" / trace).read_bytes() == (tmp_path / "1" / trace).read_bytes()


def test_no_fault_is_that_of_a_squad(bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "faults.json").write_text(json.dumps({"events": [{"at": 1, "crash": "beta"}]}))
    command = ["--lockstep", "--out", str(tmp_path / "run"), f"--scenario={tmp_path / 'faults.json'}"]
    assert simulate(bundle, command) == 1
    assert "no robot 'beta' in this fleet" in capsys.readouterr().err

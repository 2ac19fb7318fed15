"""Faults in real time, end to end, on fleets of trivial agents: processes that are killed, started anew, stopped."""

from __future__ import annotations

import errno
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from koordgen.runtime.trace.schema import Cause, Round
from tests.sim.run.fake_fleet import bundle, enlist
from tests.sim.run.test_harness import no_process_left, records, sim, summary


@pytest.fixture(autouse=True)
def device() -> None:
    enlist()


def scenario(folder: Path, **data: Any) -> str:
    file = folder / "s.json"
    file.write_text(json.dumps(data))
    return f"--scenario={file}"


def rounds(out: Path, pid: int) -> list[Round]:
    return [record for record in records(out) if isinstance(record, Round) and record.pid == pid]


def test_a_crashed_robot_comes_back_and_a_frozen_one_goes_on(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["good", "good", "good"]), tmp_path / "out"
    # By then all processes run, on a busy computer too, and there is time for the second life of r1.
    told = scenario(tmp_path, events=[{"at": 1.5, "for": 0.5, "crash": "r1"}, {"at": 1.5, "for": 1, "freeze": "r2"}])
    assert sim(root, out, told, "--duration=4.5") == 0
    causes = [record for record in records(out) if isinstance(record, Cause)]
    assert [(c.what, c.robots, c.lasts) for c in causes] == [
        ("crash", ("r1",), 0.5), ("freeze", ("r2",), 1.0), ("restart", ("r1",), None),
    ]  # fmt: skip
    times = [c.t for c in causes]
    assert times == sorted(times) and times[0] >= 1.5 and times[2] >= 2.0
    assert [cause["what"] for cause in summary(out)["causes"]] == ["crash", "freeze", "restart"]
    assert f"at {times[0]:.2f} s crash (r1)" in (out / "summary.txt").read_text()
    first = [record.round for record in rounds(out, 1)]
    assert first.count(1) == 2  # its second life begins anew
    gaps = [b.t - a.t for a, b in pairwise(rounds(out, 2))]
    frozen = gaps.index(max(gaps))
    assert gaps[frozen] > 0.9
    before, after = rounds(out, 2)[frozen].t, rounds(out, 2)[frozen + 1].t
    meanwhile = [record.t for record in rounds(out, 0) if before < record.t < after]
    assert len(meanwhile) > 1, "the others go on"
    assert json.loads((out / "faults.json").read_text())["events"][0]["crash"] == "r1"
    assert not list(out.rglob("trace-*.jsonl"))
    assert no_process_left(root)


@pytest.mark.slow
def test_all_robots_may_be_gone_for_a_while(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["good"]), tmp_path / "out"
    told = scenario(tmp_path, events=[{"at": 0.3, "for": 0.3, "crash": "r0"}])
    assert sim(root, out, told, "--duration=3") == 0  # its second process must have begun before the run ends
    assert [record.round for record in rounds(out, 0)].count(1) == 2


def test_a_robot_that_stays_away_is_no_failure(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["good", "good"]), tmp_path / "out"
    assert sim(root, out, scenario(tmp_path, events=[{"at": 0.3, "crash": "r1"}])) == 0
    assert summary(out)["verdict"] == "held" and len(rounds(out, 1)) < 6


def test_with_conditions_agents_send_to_the_relay(tmp_path: Path) -> None:
    root, out = bundle(tmp_path / "sim", ["good", "good"]), tmp_path / "out"
    assert sim(root, out, "--loss=0.5") == 0
    told = [json.loads((out / "robots" / f"r{i}" / "settings.json").read_text())["peers"] for i in range(2)]
    ports = [[peer["port"] for peer in peers] for peers in told]
    assert len({port for own in ports for port in own}) == 4  # its own, and the relay's for the other
    assert summary(out)["causes"][0]["detail"] == "loss 0.5, delay 0.001"
    assert no_process_left(root)


@pytest.mark.parametrize(
    ("options", "status", "said"),
    [
        (["--loss=1.5"], 2, "loss is 0 to 1, not 1.5"),
        (["--delay=nan"], 2, "delay is 0 to 10 s, not nan"),
        (["--scenario=nowhere.json"], 1, "nowhere.json: No such file"),
        ([{"events": [{"at": 5, "crash": "r0"}]}], 1, "the crash at 5 s would come after the run's end, at 1 s"),
        ([{"events": [{"at": 5, "crash": "r7"}]}], 1, "events[0].crash: no robot 'r7' in this fleet"),
    ],
)
def test_a_scenario_that_cannot_be_is_told_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[Any], status: int, said: str
) -> None:
    root = bundle(tmp_path / "sim", ["good"])
    words = [option if isinstance(option, str) else scenario(tmp_path, **option) for option in options]
    try:
        assert sim(root, tmp_path / "out", *words) == status
    except SystemExit as exit:
        assert exit.code == status
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_full_disk_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Path, data: str, encoding: str) -> int:
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    root, told = bundle(tmp_path / "sim", ["good"]), scenario(tmp_path, network={"loss": 0.1})
    monkeypatch.setattr(Path, "write_text", full)
    assert sim(root, tmp_path / "out", told) == 5
    assert "faults.json: the disk is full" in capsys.readouterr().err

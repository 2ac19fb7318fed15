"""Random programs: no run breaks a PROVED invariant, and no command ends with an internal error.

Half of the programs are new every day. A failure prints the seed, the program and how to judge it again; so does
`python -m tests.verify.prove.campaign`, which judges as many as one likes.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import pytest

from tests.verify.prove import campaign
from tests.verify.prove.campaign import Runner, kind_of
from tests.verify.prove.randomly.constructs import ANYWHERE, constructs
from tests.verify.prove.randomly.judges import LIMITS, Effort, Judged, attacked, explored, ran
from tests.verify.prove.randomly.programs import Made, checked, program
from tests.verify.prove.randomly.shrink import shrunk

SHARE = 8  # programs of each half
FIXED = range(700_000, 700_000 + SHARE)
TODAY = range(1_000_000 + 1000 * date.today().toordinal(), 1_000_000 + 1000 * date.today().toordinal() + SHARE)
FOUND = sorted((Path(__file__).parent / "randomly" / "found").glob("*.koord"))
JUDGES = (explored, ran, attacked)
WRONG = """\
local:
  int count
  List<int> xs
Go:
  pre: count < 3
  eff:
    for k in range(2): count += 1
    count = count * xs[count - 2] if count > 2 else count
invariant Small: forall i in ID: count[i] < 2
invariant True_: forall i in ID: len(xs[i]) >= 0
"""


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    made = Runner("z3", 0.5)
    yield made
    made.end()


def sound(runner: Runner, made: Made, seed: int) -> Judged:
    """A program, judged: nothing is wrong with it."""
    found = runner.judged(made, seed)
    again = f"python -m tests.verify.prove.campaign --from {seed} --count 1 --folder /tmp/again"
    told = [
        f"{c.invariant} is PROVED, and false in the {c.judge} of {c.robots} robots\n{c.story}"
        for c in found.contradictions
    ]
    assert not kind_of(found), "\n".join([f"seed {seed}: {again}", made.text, *told, found.fault])
    return found


@pytest.mark.parametrize("seeds", (FIXED, TODAY), ids=("fixed", "today"))
def test_nothing_that_is_proved_is_broken_by_a_run(runner: Runner, seeds: range) -> None:
    verdicts: Counter[str] = Counter()
    for seed in seeds:
        verdicts.update(sound(runner, program(seed), seed).verdicts.values())
    assert verdicts["PROVED"] >= SHARE // 2
    assert verdicts["FALSIFIED"] + verdicts["NOT INDUCTIVE"] >= SHARE // 8


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.stem)
def test_programs_with_which_the_prover_was_wrong_once(runner: Runner, path: Path) -> None:
    text = path.read_text()
    made = checked(text)
    assert made is not None
    sound(runner, Made(text, made, 0), 1)


def test_the_text_depends_on_the_seed_alone() -> None:
    assert [program(seed).text for seed in range(5)] == [program(seed).text for seed in range(5)]
    assert len({program(seed).text for seed in range(20)}) == 20


def test_every_construct_is_written() -> None:
    seen = Counter(name for seed in range(300) for name in constructs(program(seed).text))
    assert set(ANYWHERE) <= set(seen)


@pytest.mark.parametrize("judge", JUDGES, ids=("exploration", "runs", "attack"))
def test_a_false_claim_is_contradicted(judge: Any) -> None:
    made = checked(WRONG)
    assert made is not None
    effort = Effort(runs=20, seconds=5.0)
    found = judge(made, frozenset({"Small"}), 1, effort)
    assert found is not None and found.invariant == "Small"
    assert judge(made, frozenset({"True_"}), 1, effort) is None


@pytest.mark.parametrize("judge", JUDGES, ids=("exploration", "runs", "attack"))
def test_a_false_claim_that_events_have_results_is_contradicted(judge: Any) -> None:
    made = checked(WRONG)
    assert made is not None
    effort = Effort(runs=20, length=8, seconds=5.0)
    found = judge(made, frozenset({"(well-defined)"}), 1, effort)
    assert found is not None and found.invariant == "(well-defined)"


@pytest.mark.parametrize("judge", JUDGES, ids=("exploration", "runs", "attack"))
def test_what_a_variable_may_not_keep_is_no_contradiction(judge: Any) -> None:
    made = checked("local: List<int> xs max 2\nGo:\n  pre: True\n  eff: xs.append(1)\ninvariant I: True\n")
    assert made is not None and LIMITS
    assert judge(made, frozenset({"(well-defined)"}), 1, Effort(runs=10, length=8)) is None


@pytest.mark.parametrize("judge", JUDGES, ids=("exploration", "runs", "attack"))
def test_a_false_loop_invariant_is_contradicted_where_it_is_proved(judge: Any) -> None:
    made = checked(
        "local: int n\nGo:\n  pre: n < 9\n  eff:\n    for k in range(2):\n      invariant n < 1\n      n += 1\n"
        "invariant I: True\n"
    )
    assert made is not None
    effort = Effort(runs=20, seconds=5.0)
    found = judge(made, frozenset({"line 6"}), 1, effort)
    assert found is not None and found.invariant == "line 6"
    assert judge(made, frozenset({"I"}), 1, effort) is None


def test_an_unset_target_is_anywhere_where_no_position_is_declared() -> None:
    made = checked(
        "using Motion:\n  actuators: Point target\nlocal: int n\nGo:\n  pre: n < 2\n  eff: n += 1\n"
        "invariant T: forall i in ID: Motion.target[i] == Point(0, 0, 0)\n"
    )
    assert made is not None
    for judge in JUDGES:
        assert judge(made, frozenset({"T"}), 1, Effort(seconds=5.0)) is not None


def test_a_program_is_made_small() -> None:
    text = program(2).text
    small = shrunk(text, lambda t: checked(t) is not None)
    assert checked(small) is not None and len(small) < len(text) / 2


def test_a_campaign_goes_on_where_it_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "results"
    asked = ["--from", "700000", "--count", "3", "--folder", str(folder)]
    assert campaign.main(asked) == 0
    (path,) = folder.glob("*.jsonl")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:2]) + lines[2][:40])  # killed in the midst of the third
    assert campaign.main(asked) == 0
    assert path.read_text().splitlines(keepends=True)[:2] == lines[:2]
    assert [json.loads(line)["seed"] for line in path.read_text().splitlines()] == [700_000, 700_001, 700_002]
    assert "programs                3" in capsys.readouterr().out


def test_what_is_wrong_is_written_and_ends_the_campaign_with_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> list[Any]:
        raise RuntimeError("a fault of the prover")

    monkeypatch.setattr("tests.verify.prove.randomly.judges.prove", broken)
    monkeypatch.setattr(campaign, "TRIES", 3)
    assert campaign.main(["--count", "1", "--folder", str(tmp_path)]) == 1
    told = (tmp_path / "000000.koord").read_text()
    assert "RuntimeError" in told and "seed 0" in told and checked(told) is not None

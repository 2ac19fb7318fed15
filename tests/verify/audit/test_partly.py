"""With fewer traces of a fleet an audit knows less, but never contradicts the audit of all traces."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.verify.audit.fleets import FORMULAS, LINE, audited, conditions
from tests.verify.replay.runs import Run

TEXT = LINE + "".join(f"invariant {name}: {formula}\n" for name, formula in FORMULAS.items())


def flown(folder: Path, seed: int) -> Path:
    """A fleet with loss, one of whose robots may die and come back, or come to rest."""
    rng = Random(seed)
    run = Run(folder, TEXT, n=rng.choice((3, 4)), seed=seed, conditions=conditions(rng.choice((0.0, 0.1, 0.2)))).run(
        3.0
    )
    what = rng.choice(("dies", "rests", "nothing"))
    if what == "dies":
        run.fleet.network._queues.pop(1, None)
        run.fleet.robots[1].wake = 1e9
        run.run(rng.uniform(0.05, 1.5))
        run.boot(1)
        run.run(3.0)
    elif what == "rests":
        run.fleet.robots[1].agent.end("landing")
        run.run(1.5)
    return run.save() / "robots"


def spoiled(home: Path, rng: Random) -> None:
    """Less than all: files, ends, lines."""
    for path in sorted(home.rglob("*.jsonl")):
        lines = path.read_bytes().splitlines(keepends=True)
        match rng.choice(("file", "end", "lines", "nothing", "bytes")):
            case "file" if sum(1 for _ in home.rglob("*.jsonl")) > 1:
                path.unlink()
            case "end":
                data = b"".join(lines)
                path.write_bytes(data[: rng.randrange(len(lines[0]), len(data))])
            case "lines":
                for _ in range(rng.randrange(1, 4)):
                    lines[rng.randrange(1, len(lines))] = b"?\n"
                path.write_bytes(b"".join(lines))
            case "bytes":
                spoilt = bytearray(b"".join(lines))
                for _ in range(3):
                    spoilt[rng.randrange(len(lines[0]), len(spoilt))] = 0xFF
                path.write_bytes(bytes(spoilt))
            case _:
                pass


def outcomes(document: Any) -> dict[tuple[str, str, int, int], str]:
    """By property and round."""
    return {
        (p["of"], p["name"], p["line"], round_): span["outcome"]
        for p in document["properties"]
        if p["of"] in ("invariant", "initially", "assume")
        for span in p["spans"]
        for round_ in range(span["since"], span["until"] + 1)
    }


def checked(folder: Path, seed: int, seen: Counter[str]) -> None:
    rng = Random(seed)
    home = flown(folder, seed)
    program = folder / "source/app.koord"
    whole = outcomes(audited(home, "--program", program)[1])
    before = {path: path.read_bytes() for path in home.rglob("*.jsonl")}
    for k in range(3):
        spoiled(home, rng)
        status, document = audited(home, "--program", program)
        assert status in (0, 3, 4), seed
        for key, outcome in outcomes(document).items():
            seen[outcome] += 1
            if outcome == "unknown" or key[3] == document["rounds"]:  # the last round's end is not looked at
                continue
            wanted = whole.get(key, "unknown")
            assert outcome == wanted, (seed, k, key, json.dumps(document["notes"]))
        for path, data in before.items():
            path.write_bytes(data)


def test_less_of_the_traces_is_less_knowledge(tmp_path: Path) -> None:
    seen: Counter[str] = Counter()
    for seed in range(3):
        checked(tmp_path / str(seed), seed, seen)
    assert seen["unknown"] > 100 and seen["held"] > 100 and seen["violated"] > 10, seen


@pytest.mark.slow
def test_less_of_150_fleets_traces_is_less_knowledge(tmp_path: Path) -> None:
    seen: Counter[str] = Counter()
    for seed in range(100, 250):
        checked(tmp_path / str(seed), seed, seen)
    print(dict(seen))


COUNTING = """\
using Motion:
  sensors: Point position
  actuators: Point target
allread: int turns[N_SYS]
Go:
  pre: pid == 1 and turns[pid] < 4
  eff: turns[pid] += 1
Look:
  pre: pid == 0
  eff: pass
invariant Few: forall i in ID: turns[i] < 4
"""


def test_what_another_robots_broken_line_said_of_the_store_is_not_known(tmp_path: Path) -> None:
    home = Run(tmp_path, COUNTING).run(4.0).save() / "robots"
    program = tmp_path / "source/app.koord"
    assert audited(home / "alice", "--program", program)[0] == 3, "alice saw it"
    path = home / "alice/trace.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    last = max(k for k, line in enumerate(lines) if '"copy":{"turns":{"1":4}}' in line)
    path.write_text("".join([*lines[:last], "?\n", *lines[last + 1 :]]))
    status, document = audited(path, "--program", program)
    (few,) = [p for p in document["properties"] if p["name"] == "Few"]
    assert status == 4 and [s["outcome"] for s in few["spans"]] == ["held", "unknown"]
    assert few["spans"][1]["since"] == json.loads(lines[last])["round"] - 1

"""Leader election as a Promela model, and Spin run on it (Debian package `spin`; its verifiers are compiled by gcc).

Two models of examples/election/election.koord, of the same rounds: at a round's start everyone has seen the store; then
robots, in every order, have a turn each: any event whose guard holds, or none; then a round begins. Each event is one
step (`d_step`), and the program's invariants are asserted after each. The `plain` model is as one would write it down:
who skips takes a step too. The `tight` one is the best for Spin that we know without changing what is asked: a round
may end at any time, and who has not moved then has skipped; who has stopped has no turn.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

MISSING = "Spin is not installed, or gcc is not: on Debian, apt install spin gcc"
COMPILE = ("gcc", "-O2", "-w", "-DSAFETY", "-o", "pan", "pan.c")  # states as they are; partial order reduction is on
SEARCH = ("./pan", "-w20")  # a table for 2 ** 20 states: to clear the default one of 2 ** 24 takes 0.2 s
END = "end of a round:"

_MODEL = """\
/* {n} robots elect a leader, as election.koord does. */
#define N {n}
#define SALT {salt}

short bid[N] = -1;     /* the shared store */
short seen[N] = -1;    /* the store at the round's start: what events read */
short leader[N] = -1;
bool stopped[N];
bool moved[N];         /* who has had its turn */
hidden byte k;         /* hidden: part of no state */
hidden short highest, best;

#define TURN (!moved[_pid] && !stopped[_pid])
#define ALL_HAVE_BID ({all_have_bid})
{best_of_bid}{best_of_seen}
inline invariants() {{
  assert({bidding});
  if
  :: {somebody} ->
    best_of_bid();
    assert({everyone});
    assert({best});
    assert({agreement})
  :: else
  fi;
  k = 0
}}

active [N] proctype robot() {{
end: do
  :: d_step {{ TURN && seen[_pid] < 0 ->
       bid[_pid] = (_pid * SALT + 3) % N * N + _pid; moved[_pid] = true; invariants() }}
  :: d_step {{ TURN && leader[_pid] < 0 && ALL_HAVE_BID ->
       best_of_seen(); leader[_pid] = best; moved[_pid] = true; invariants() }}
  :: d_step {{ TURN && leader[_pid] >= 0 ->
       stopped[_pid] = true; {stop_moved}invariants() }}
{skip}  od
}}

active proctype round() {{
end: do
  :: d_step {{ {over} ->
       printf("{END}{formats}\\n"{values});
       k = 0;
       do
       :: k < N -> seen[k] = bid[k]; moved[k] = false; k++
       :: else -> break
       od;
       k = 0 }}
  od
}}
"""
_BEST = """
inline best_of_{store}() {{
  best = 0; highest = -1; k = 0;
  do
  :: k < N -> if :: {store}[k] > highest -> highest = {store}[k]; best = k :: else fi; k++
  :: else -> break
  od;
  k = 0
}}
"""
_SKIP = "  :: d_step { !moved[_pid] -> moved[_pid] = true }\n"


def election(n: int, salt: int, tight: bool) -> str:
    """The model's text."""
    robots = range(n)
    pairs = [f"(leader[{i}] < 0 || leader[{j}] < 0 || leader[{i}] == leader[{j}])" for i, j in combinations(robots, 2)]
    return _MODEL.format(
        n=n,
        salt=salt,
        best_of_bid=_BEST.format(store="bid"),
        best_of_seen=_BEST.format(store="seen"),
        all_have_bid=_all(f"seen[{i}] >= 0" for i in robots),
        bidding=_all(f"bid[{i}] >= -1" for i in robots),
        somebody=" || ".join(f"leader[{i}] >= 0" for i in robots),
        everyone=_all(f"bid[{i}] >= 0" for i in robots),
        best=_all(f"(leader[{i}] < 0 || leader[{i}] == best)" for i in robots),
        agreement=_all(pairs) or "true",
        stop_moved="" if tight else "moved[_pid] = true; ",
        skip="" if tight else _SKIP,
        over="true" if tight else _all(f"moved[{i}]" for i in robots),
        END=END,
        formats=" %d" * (3 * n),
        values="".join([f", {name}[{i}]" for i in robots for name in ("bid", "leader", "stopped")]),
    )


def _all(parts: Iterable[str]) -> str:
    return " && ".join(parts)


class Ran(NamedTuple):
    """What a search stored and took. CPU seconds of the search alone, and of making and compiling the verifier."""

    states: int
    transitions: int
    search: float
    making: float
    output: str


def installed() -> bool:
    return shutil.which("spin") is not None and shutil.which("gcc") is not None


def version() -> str:
    return subprocess.run(["spin", "-V"], capture_output=True, text=True, check=True).stdout.strip()


def ran(model: str, folder: Path, printing: bool = False, repeats: int = 1) -> Ran:
    """The model's whole search, the quickest of `repeats`; with `printing` its output has each end of a round. Raises
    RuntimeError where Spin does not say that all was searched and nothing found."""
    (folder / "model.pml").write_text(model)
    making = _cpu(["spin", "-a", "model.pml"], folder)[1]
    making += _cpu([*COMPILE[:1], *(["-DPRINTF"] if printing else []), *COMPILE[1:]], folder)[1]
    output, search = min((_cpu(SEARCH, folder) for _ in range(repeats)), key=lambda found: found[1])
    if "errors: 0" not in output or "max search depth too small" in output or "out of memory" in output:
        raise RuntimeError(f"Spin's search was not as it should be:\n{output}")
    return Ran(_number(output, "states, stored"), _number(output, "transitions"), search, making, output)


def ends(output: str) -> set[tuple[int, ...]]:
    """The states at rounds' ends that a printing verifier told: bid, leader and stopped of each robot in turn."""
    lines = (line.strip() for line in output.splitlines())
    return {tuple(map(int, line.removeprefix(END).split())) for line in lines if line.startswith(END)}


def _cpu(command: Iterable[str], folder: Path) -> tuple[str, float]:
    """What a command prints, and its CPU seconds with those of all that it starts."""
    told = folder / "told.txt"
    with told.open("w") as file:
        process = subprocess.Popen([*command], cwd=folder, stdout=file, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    output = told.read_text()
    if process.returncode:
        raise RuntimeError(f"{process.args!r} failed:\n{output}")
    return output, used.ru_utime + used.ru_stime


def _number(output: str, what: str) -> int:
    line = next(line for line in output.splitlines() if what in line)
    return int(line.split()[0])

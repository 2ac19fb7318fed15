"""Time of port calls against that of a round: the worst case, reported at the call."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from koordgen.build.bundle.port_calls import check_calls, planner_budget
from koordgen.cli import main
from tests.build.emit.generated import MOTION, checked

ROOT = Path(__file__).parents[3]
CALL = "Motion.path = Motion.planner(Point(1, 0, 0))"


def calls(body: str, declared: str = "") -> str:
    """Return the arithmetic in the warning of an event, in a fleet of 4 robots; "" without a warning."""
    lines = "".join(f"    {line}\n" for line in body.split("\n"))
    program = checked(f"{MOTION}{declared}E:\n  pre: True\n  eff:\n{lines}")
    found = check_calls(program, 4, 0.1, 0.01)
    assert all((d.code, d.severity) == ("B007", "warning") and d.help for d in found)
    assert len(found) < 2
    if not found:
        return ""
    assert found[0].message.endswith("; half of a round is 50 ms")
    return "inf" if "without a visible bound" in found[0].message else found[0].message.split(", ")[1].split(";")[0]


@pytest.mark.parametrize(
    ("body", "declared", "told"),
    [
        ("\n".join([CALL] * 5), "", ""),
        ("\n".join([CALL] * 6), "", "6 x 10 ms = 60 ms"),
        (f"for i in range(5): {CALL}", "", ""),
        (f"for i in range(1, 12, 2): {CALL}", "", "6 x 10 ms = 60 ms"),
        (f"for i in range(9, 0, -1): {CALL}", "", "9 x 10 ms = 90 ms"),
        (f"for i in range(n): {CALL}", "param int n = 7\n", "7 x 10 ms = 70 ms"),
        (f"for i in range(n): {CALL}", "local: int n = 7\n", "inf"),
        (f"while n > 0:\n  {CALL}\n  n -= 1", "local: int n = 7\n", "inf"),
        (f"for i in ID: {CALL}", "", ""),
        (f"for i in ID:\n  {CALL}\n  {CALL}", "", "8 x 10 ms = 80 ms"),
        (f"for i in range(N_SYS):\n  for j in ID: {CALL}", "", "16 x 10 ms = 160 ms"),
        (f"for n in xs: {CALL}", "local: List<int> xs max 5\n", ""),
        (f"for n in xs: {CALL}", "local: List<int> xs max 6\n", "6 x 10 ms = 60 ms"),
        (f"for i in range(len(xs)): {CALL}", "local: List<int> xs max 6\n", "6 x 10 ms = 60 ms"),
        (f"for n in reversed(xs): {CALL}", "local: List<int> xs max 6\n", "6 x 10 ms = 60 ms"),
        (f"for n in xs[:4]: {CALL}", "local: List<int> xs max 6\n", ""),
        (f"for n in [1, 2, 3]: {CALL}", "", ""),
        (f"for n in xs: {CALL}", "allread: int xs[N_SYS]\n", ""),
        (f"for n, p in m.items(): {CALL}", "local: Map<int, int> m max 6\n", "6 x 10 ms = 60 ms"),
        ("for p in Motion.planner(Point(1, 0, 0)): pass", "", ""),
        (f"if pid == 0:\n  {CALL}\n  {CALL}\n  {CALL}\nelse:\n  {CALL}\n  {CALL}\n  {CALL}", "", ""),
        (f"for i in range(0):\n  for j in xs: {CALL}", "local: List<int> xs\n", ""),
    ],
)  # fmt: skip
def test_the_most_calls_of_an_event(body: str, declared: str, told: str) -> None:
    assert calls(body, declared) == told


def test_it_is_told_at_the_call_and_how_to_mend_it() -> None:
    text = f"{MOTION}Look:\n  pre: True\n  eff:\n    {CALL}\n    for i in range(7): {CALL}\n"
    (found,) = check_calls(checked(text), 4, 0.1, 0.01)
    assert (found.span.line, found.span.column) == (13, 38)
    assert found.message == (
        "Look may take longer than half of a round: up to 8 port calls, 8 x 10 ms = 80 ms; half of a round is 50 ms"
    )
    assert found.help == (
        "5 calls fit into half of a round of 100 ms: loop over a list that is declared with a smaller 'max', "
        "or set planner_budget in the fleet file to 6.25 ms or less if the planner can keep it"
    )
    assert check_calls(checked(text), 4, 0.2, 0.01) == []
    assert check_calls(checked(text), 4, 0.1, 0.006) == []


@pytest.mark.parametrize(
    ("body", "delta", "given", "budget"),
    [
        (CALL, 0.1, None, 0.04),
        (CALL, 0.15, None, 0.06),
        (CALL, 5.0, None, 0.06),
        (CALL, 0.02, None, 0.01),
        (f"{CALL}\n{CALL}", 0.1, None, 0.02),
        ("\n".join([CALL] * 6), 0.1, None, 0.01),
        (f"while True: {CALL}", 0.1, None, 0.01),
        ("Motion.path = []", 0.1, None, 0.04),
        (CALL, 0.1, 0.005, 0.005),
    ],
)
def test_the_default_budget_leaves_an_event_in_time_for_its_round(
    body: str, delta: float, given: float | None, budget: float
) -> None:
    lines = "".join(f"    {line}\n" for line in body.split("\n"))
    program = checked(f"{MOTION}E:\n  pre: True\n  eff:\n{lines}")
    assert planner_budget(program, 4, delta, given) == pytest.approx(budget)


@pytest.mark.parametrize("format", ["text", "json", "sarif"])
def test_a_build_warns_and_goes_on(format: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program, fleet = tmp_path / "look.koord", ROOT / "examples/lineform/fleet.yaml"
    program.write_text(
        "using Motion:\n  actuators: List<Point> path\n  PathPlanner planner\n"
        f"Look:\n  pre: True\n  eff:\n    for i in range(6): {CALL}\n"
    )
    arguments = ["build", str(program), "--fleet", str(fleet), "--target", "quad", "-o", str(tmp_path / "out")]
    assert main([*arguments, "--format", format]) == 0
    out, err = capsys.readouterr()
    if format == "text":
        assert f"{program}:7:38: warning[B007]: Look may take longer than half of a round" in err
    elif format == "json":
        assert [d["code"] for d in json.loads(out)["diagnostics"]] == ["B007"]
    else:
        assert [r["ruleId"] for r in json.loads(out)["runs"][0]["results"]] == ["B007"]
    assert (tmp_path / "out" / "look" / "alice" / "program.py").is_file()


def test_the_example_of_tasks_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = ROOT / "examples/task"
    given = [str(folder / "task.koord"), "--fleet", str(folder / "fleet.yaml"), "--target", "car", "-o", str(tmp_path)]
    assert main(["build", *given]) == 0
    assert "B007" not in capsys.readouterr().err

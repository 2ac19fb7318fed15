"""Proofs straight from the generator: the proved invariants, and consistency of the assumptions."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.lang.node import replace
from koordgen.verify.prove.obligations import generate
from koordgen.verify.prove.smt.obligation import Obligation
from koordgen.verify.prove.smt.solve import Solver


@cache
def checked(text: str) -> Program:
    with TemporaryDirectory() as folder:
        path = Path(folder, "app.koord")
        path.write_text(text.lstrip())
        return check_file(str(path)).program


def proved_names(program: Program, solver: Solver, robots: int | None = None) -> set[str]:
    """The names of what is proved, failing invariants dropped until none fails; "vacuous" where what is assumed cannot
    be true."""
    while True:
        asked = _asked(program, solver, robots)
        failing = {o.invariant for o, result in asked if o.kind != "consistency" and result != o.expected}
        kept = tuple([p for p in program.properties if p.name not in failing])
        if len(kept) == len(program.properties):
            names = {o.invariant for o, _ in asked if o.kind != "consistency"} - failing
            contradicts = any(o.kind == "consistency" and result != "sat" for o, result in asked)
            return names | ({"vacuous"} if contradicts else set())
        program = replace(program, properties=kept)


def _asked(program: Program, solver: Solver, robots: int | None) -> list[tuple[Obligation, str]]:
    """As the command asks: with little told at first, and what fails so with what is told usually."""
    found: list[tuple[Obligation, str]] = [
        (o, solver.ask(o).result) for o in generate.obligations(program, robots, detail="little")
    ]
    if all(result == o.expected for o, result in found):
        return found
    usual = {o.name: o for o in generate.obligations(program, robots)}
    return [(o, r) if r == o.expected else (usual[o.name], solver.ask(usual[o.name]).result) for o, r in found]

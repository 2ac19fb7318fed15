"""Koord text -> generated program, loaded with the user's Python file, and run event by event."""

from __future__ import annotations

import ast
import sys
from types import ModuleType
from typing import Any

from koordgen.build.emit.program import program_text
from koordgen.lang.analyze.program import check
from koordgen.lang.ir.decl import Program as IR
from koordgen.lang.ir.verify import verify
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from koordgen.runtime.program import program as rt
from koordgen.runtime.values.points import Point

MOTION = """using Motion:
  sensors: Point position
  actuators:
    Point target
    List<Point> path
  PathPlanner planner
using Log:
  stream stdout
"""


def checked(text: str) -> IR:
    """Return the IR of a program without errors."""
    tree, found = parse(Source("a.koord", text))
    assert not found, found
    program, wrong = check(tree, Source("a.koord", text))
    assert program is not None, wrong
    verify(program)
    return program


def in_one_line(text: str) -> str:
    """Return Python text with each statement in one line and without comments, as `ast.unparse` writes it."""
    return ast.unparse(ast.parse(text))


def load(text: str, functions: str = "") -> rt.Program:
    """Load the generated program; `functions` is the text of its functions file."""
    program: rt.Program = _module("generated", program_text(checked(text))).PROGRAM
    if program.library is not None and functions:
        program.library._module = _module("a_functions", functions)
        del sys.modules["a_functions"]
    return program


def _module(name: str, text: str) -> Any:
    """Register a module: annotations are looked up in the module of their class."""
    module = sys.modules[name] = ModuleType(name)
    module.__file__ = f"{name}.py"
    exec(compile(text, f"{name}.py", "exec"), vars(module))
    return module


def frame(program: rt.Program, pid: int = 0, n_sys: int = 3, call: Any = rt.no_ports, **changed: Any) -> rt.Frame:
    """Return a frame with initial values everywhere, except for the given names."""
    ports = {"Motion.position": Point(1, 2, 3), "Motion.target": Point(), "Motion.path": ()}
    shared = {v.name: (v.initial(),) * n_sys if v.kind == "allread" else v.initial() for v in program.shared}
    locals_ = {v.name: v.initial() for v in program.locals}
    return rt.Frame(
        pid,
        n_sys,
        {name: changed.get(name, value) for name, value in locals_.items()},
        {name: changed.get(name, value) for name, value in shared.items()},
        ports,
        ports,
        call,
    )


def step(program: rt.Program, given: rt.Frame | None = None) -> rt.Effects | rt.Fault:
    """Run the first enabled event. Return its result."""
    state = program.begin(given or frame(program))
    event = rt.choose(program, state)
    if isinstance(event, rt.Fault):
        return event
    assert event is not None
    return rt.run(program, event.effect, state, event.line)


def locals_after(text: str, functions: str = "", **changed: Any) -> dict[str, Any]:
    """Return the locals after the first enabled event of a program, which must have no fault."""
    program = load(text, functions)
    done = step(program, frame(program, **changed))
    assert isinstance(done, rt.Effects), done
    return dict(done.locals)

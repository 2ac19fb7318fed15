"""Generated text: imports, map of lines to Koord lines, use of `+=`, and breaking of lines."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.emit import layout
from koordgen.build.emit.layout import WIDTH, Page, brackets, chain, display, joined
from koordgen.build.emit.program import program_text
from koordgen.build.emit.property import properties_text
from koordgen.build.pipeline import check_file
from koordgen.lang.ir.decl import Program
from koordgen.lang.ir.verify import verify
from koordgen.runtime.program.program import Effects, Fault
from koordgen.runtime.program.property import Properties, without_properties
from tests.agree.programs import random_program
from tests.build.emit.generated import MOTION, _module, checked, frame, load, step
from tests.programs import programs_alone

ROOT = Path(__file__).parents[3]
EXAMPLES = programs_alone()
ALL = [*EXAMPLES, ROOT / "templates/new/program.koord", ROOT / "tests/golden/kitchen/kitchen.koord"]


def example(path: Path) -> Program:
    return check_file(str(path)).program


def unused_and_missing(text: str) -> tuple[set[str], set[str]]:
    """Return the imported names that a module never reads, and the names that it reads without a definition."""
    imported: set[str] = set()
    read: set[str] = set()
    defined = {*dir(builtins), "__file__"}
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.ImportFrom(module, names):
                imported |= {name.name for name in names} if module != "__future__" else set()
            case ast.Name(name, ast.Load()):
                read.add(name)
            case ast.Name(name) | ast.arg(name) | ast.FunctionDef(name) | ast.ClassDef(name):
                defined.add(name)
            case _:
                pass
    return imported - read, read - imported - defined


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_a_module_imports_exactly_what_it_uses(path: Path) -> None:
    program = example(path)
    assert unused_and_missing(program_text(program)) == (set(), set())
    assert unused_and_missing(properties_text(program)) == (set(), set())


def test_random_modules_import_exactly_what_they_use() -> None:
    for seed in range(30):
        program = random_program(seed)
        verify(program)
        assert unused_and_missing(program_text(program)) == (set(), set()), seed


def test_what_was_tried_and_dropped_is_not_imported() -> None:
    """The screening reads a param before it turns out that there is no screening."""
    text = properties_text(
        checked("param float eps = 0.5\nallwrite: string s\n" + IDLE + "invariant P: eps > 0.1 and s == s\n")
    )
    assert unused_and_missing(text) == (set(), set())
    formula = "forall i in ID: f[i] == 1 or eps < f[i]"
    text = properties_text(checked(f"param float eps = 0.5\nlocal: float f\n{IDLE}invariant P: {formula}\n"))
    assert unused_and_missing(text) == (set(), set())


def statements(text: str) -> Iterator[tuple[int, int, int]]:
    """Return first line, last line and mark of each simple statement and each head of a compound one with a mark."""
    lines = text.split("\n")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.stmt):
            found = re.search(r"  # line (\d+)$", lines[node.lineno - 1])
            inner: list[ast.stmt] = getattr(node, "body", [])
            if found:
                yield node.lineno, inner[0].lineno - 1 if inner else node.end_lineno or 0, int(found[1])


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_each_line_of_a_statement_is_mapped_to_the_line_that_its_mark_names(path: Path) -> None:
    text = program_text(example(path))
    lines: dict[int, int] = ast.literal_eval(text[text.index("] = {") + 4 : text.index("}\n\nPROGRAM") + 1])
    wanted = {line: mark for first, last, mark in statements(text) for line in range(first, last + 1)}
    assert lines == wanted
    assert len(set(lines.values())) > 2


def test_a_fault_within_a_broken_statement_names_its_line() -> None:
    many = " + ".join(["len(xs) // (len(xs) + 1)"] * 6)
    text = f"local:\n  List<int> xs\n  int i\nE:\n  pre: True\n  eff:\n    i = 1\n    i = {many} + xs[i]\n    i = 2\n"
    generated = program_text(checked(text))
    assert "i.value = (  # line 8\n" in generated
    found = step(load(text))
    assert isinstance(found, Fault) and found.line == 8
    found = step(load(text.replace("xs[i]", "10 ** 30")))
    assert isinstance(found, Effects)
    found = step(load(text.replace("xs[i]", "10 ** 30").replace("    i = 2\n", "")))
    assert isinstance(found, Fault) and (found.line, found.reason[:14]) == (8, "i would become")


IDLE = "E:\n  pre: True\n  eff: pass\n"
RECORD = "def Leg:\n  int marks\n"


@pytest.mark.parametrize(
    ("declared", "statement", "python"),
    [
        ("int n", "n += 1", "s.local_n.value += 1"),
        ("int n", "n = n - 2", "s.local_n.value -= 2"),
        ("int n", "n //= 3", "s.local_n.value //= 3"),
        ("int n", "n %= 3", "s.local_n.value %= 3"),
        ("float f", "f *= 2", "s.local_f.value *= 2.0"),
        ("float f", "f /= 2", "s.local_f.value /= 2.0"),
        ("float f", "f -= f - 1", "s.local_f.value -= s.local_f.value - 1.0"),
        ("Point p", "p += Point(1, 0, 0)", "s.local_p.value += Point(1.0, 0.0, 0.0)"),
        ("int n", "x[pid] += 1", "s.shared_x.own += 1"),
        ("int n", "total += 1", "s.shared_total.value += 1"),
        ("int n", "Motion.target *= 2", "s.motion_target.value *= 2.0"),
        ("int n", "int k = 2\nk += 1", "my_k += 1"),
        # Another operand, another place, another tree:
        ("int n", "n = 1 + n", "s.local_n.value = 1 + s.local_n.value"),
        ("int n\n  int m", "n = m + 1", "s.local_n.value = s.local_m.value + 1"),
        ("int n", "n = n + 1 + 2", "s.local_n.value = s.local_n.value + 1 + 2"),
        ("int n", "n = -n + 1", "s.local_n.value = -s.local_n.value + 1"),
        ("int n", "x[pid] = x[0] + 1", "s.shared_x.own = s.shared_x[0] + 1"),
        ("int n", "x[pid] = x[(pid + 1) % N_SYS] + 1", "s.shared_x.own = s.shared_x[(s.pid + 1) % s.n_sys] + 1"),
        ("int n", "n = x[pid] + 1", "s.local_n.value = s.shared_x[s.pid] + 1"),
        # What the runtime carries out itself:
        ("int n\n  int m", "n += m", "s.local_n.value = plus(s.local_n.value, s.local_m.value)"),
        ("int n", "n = n ** 2", "s.local_n.value = power(s.local_n.value, 2)"),
        ("string s", 's += "a"', 's.local_s.value = made(s.local_s.value + "a")'),
        ("List<int> xs", "xs[0] += 1", "s.local_xs.value = updated(s.local_xs.value, 0, at(s.local_xs.value, 0) + 1)"),
        ("Leg r", "r.marks += 1", "s.local_r.value = replace(s.local_r.value, marks=s.local_r.value.marks + 1)"),
    ],
)
def test_a_place_that_is_changed_by_its_own_value(declared: str, statement: str, python: str) -> None:
    body = statement.replace("\n", "\n    ")
    head = f"{RECORD}{MOTION}allread: int x[N_SYS]\nallwrite: int total\nlocal:\n  {declared}\n"
    text = program_text(checked(f"{head}E:\n  pre: N_SYS > 1\n  eff:\n    {body}\n"))
    assert f"    {python}  # line" in text


def test_a_changed_place_holds_the_new_value_and_its_line() -> None:
    effect = "    n //= -2\n    x[pid] += n\n    x[pid] %= 3\n"
    text = f"allread: int x[N_SYS]\nlocal: int n = 7\nE:\n  pre: True\n  eff:\n{effect}"
    done = step(load(text))
    assert isinstance(done, Effects)
    assert (done.locals, done.shared) == ({"n": -4}, {"x": 2})
    broken = step(load(text.replace("x[pid] += n", "n -= 2 ** 99")))
    assert isinstance(broken, Fault) and broken.line == 7
    broken = step(load(text.replace("n //= -2", "n //= x[pid]")))
    assert isinstance(broken, Fault) and broken.line == 6


def test_a_change_that_fails_leaves_the_place() -> None:
    program = load("local:\n  int n = 7\n  List<int> xs\nE:\n  pre: True\n  eff:\n    n += xs[n]\n")
    state = program.begin(frame(program))
    with pytest.raises(Exception, match="out of range"):
        program.events[0].effect(state)
    assert state.written_values() == {}


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.stem)
def test_lines_are_as_wide_as_the_page(path: Path) -> None:
    program = example(path)
    for text in (program_text(program), properties_text(program)):
        assert [line for line in text.split("\n") if len(line) > WIDTH] == []
        assert [line for line in text.split("\n") if line != line.rstrip()] == []


def test_a_text_is_always_the_same() -> None:
    program = example(ROOT / "tests/golden/kitchen/kitchen.koord")
    assert program_text(program) == program_text(program)
    assert properties_text(program) == properties_text(program)


LONG = [f"argument_no_{i}" for i in range(9)]


@pytest.mark.parametrize(
    ("code", "lines"),
    [
        (brackets("f(", LONG[:2], ")"), ["f(argument_no_0, argument_no_1)"]),
        (brackets("long_function(", LONG[:6], ")"), ["long_function(", f"    {', '.join(LONG[:6])}", ")"]),
        (joined("x = ", brackets("f(", LONG, ")")), ["x = f(", *[f"    {a}," for a in LONG], ")"]),
        (display(LONG), ["(", f"    {', '.join(LONG[:6])},", f"    {', '.join(LONG[6:])},", ")"]),
        (
            joined("x = ", chain(LONG[0], *[f"+ {a}" for a in LONG[1:]])),
            ["x = (", f"    {LONG[0]}", *[f"    + {a}" for a in LONG[1:]], ")"],
        ),
        (
            joined("return ", brackets("f(", [chain(LONG[0], *[f"+ {a}" for a in LONG[1:]])], ")"), ".x"),
            ["return f(", f"    {LONG[0]}", *[f"    + {a}" for a in LONG[1:]], ").x"],
        ),
        (display([brackets("f(", LONG, ")")]), ["(", "    f(", *[f"        {a}," for a in LONG], "    ),", ")"]),
    ],
)  # fmt: skip
def test_where_lines_are_broken(code: str, lines: list[str]) -> None:
    page = Page()
    page.add(code)
    assert [line for line, _ in page.lines] == lines
    assert ast.dump(ast.parse(code.removeprefix("return "))) == ast.dump(
        ast.parse("\n".join(lines).removeprefix("return "))
    )


def test_a_mark_stands_at_the_first_line() -> None:
    page = Page()
    page.add(brackets("f(", LONG, ")"), "    ", 12)
    assert page.lines[0] == ("    f(  # line 12", 12)
    assert {line for _, line in page.lines} == {12}


def test_an_explanation_stands_only_where_something_needs_it() -> None:
    text = program_text(checked("local: int n\nE:\n  pre: True\n  eff: n = n // -2\n"))
    assert "#   a // b, a % b     round down" in text and "#   no_nan" not in text
    assert "#   " not in program_text(checked("local: bool b\nE:\n  pre: b\n  eff: b = False\n"))


def test_what_a_program_without_properties_measures_is_what_its_text_would_say() -> None:
    motion = "using Motion:\n  sensors:\n    Point position\n    float velocity\n"
    others = "using Arm:\n  sensors: Pose pose\nusing Own:\n  sensors: Point position\n"
    program = checked(f"{motion}{others}{IDLE}")
    module = _module("program", program_text(program))
    said: Properties = _module("properties", properties_text(program, {"Own"})).PROPERTIES
    assert said == without_properties(module.PROGRAM, {"Own"})
    assert said.measured == ("Motion.position", "Arm.pose")


class Flat(ast.NodeTransformer):
    """Merges `(a and b) and c` into one node like `a and b and c`, since both mean the same."""

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.BoolOp:
        self.generic_visit(node)
        inner = [v.values if isinstance(v, ast.BoolOp) and type(v.op) is type(node.op) else [v] for v in node.values]
        return ast.BoolOp(node.op, [value for values in inner for value in values])


def tree(text: str) -> str:
    """Return the module's syntax tree, without the line map."""
    module = Flat().visit(ast.parse(text))
    module.body = [s for s in module.body if not (isinstance(s, ast.AnnAssign) and ast.unparse(s.target) == "LINES")]
    return ast.dump(module)


@pytest.mark.parametrize("width", [pytest.param(30, marks=pytest.mark.slow), 60])
def test_a_text_means_the_same_however_wide_it_is(monkeypatch: pytest.MonkeyPatch, width: int) -> None:
    programs = [*map(example, ALL), *map(random_program, range(12))]
    texts = [emit(program) for program in programs for emit in (program_text, properties_text)]
    monkeypatch.setattr(layout, "WIDTH", width)
    narrow = [emit(program) for program in programs for emit in (program_text, properties_text)]
    assert sum(a != b for a, b in zip(texts, narrow, strict=True)) > 30
    for text, other in zip(texts, narrow, strict=True):
        assert tree(text) == tree(other)


@pytest.mark.parametrize("part", ["n * (2 + {})", "len([{}])", "(1 if n > {} else 2)", "abs({} + 1)"])
def test_deep_expressions_are_not_broken_further(part: str) -> None:
    deep = "n"
    for _ in range(40):
        deep = part.format(deep)
    text = program_text(checked(f"local: int n\nE:\n  pre: True\n  eff: n = {deep}\n"))
    assert max(len(line) - len(line.lstrip()) for line in text.split("\n")) <= 4 * 14


def test_alternatives_stand_one_below_the_other() -> None:
    many = "".join(f"{i} if n == {10**9 + i} else " for i in range(9))
    text = program_text(checked(f"local: int n\nE:\n  pre: True\n  eff: n = {many}n\n"))
    assert "        0\n        if s.local_n.value == 1000000000\n        else 1\n        if" in text

"""The parser: trees and places, limits, and that no text whatever makes it raise."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.lang.analyze.program import check
from koordgen.lang.diagnostics import render, to_json
from koordgen.lang.ir.printer import show
from koordgen.lang.ir.verify import verify
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax import expr
from koordgen.lang.syntax.decl import Event, Guard
from koordgen.lang.syntax.generate import TABLES, tables
from koordgen.lang.syntax.parse import parse
from koordgen.lang.syntax.printer import show as show_tree

ROOT = Path(__file__).parents[3]
LINEFORM = (ROOT / "examples/lineform/lineform.koord").read_text(encoding="utf-8")
PRELUDE = "local: int a\n  float f\n  bool b\n"


def guard(text: str) -> expr.Expr:
    tree, found = parse(Source("t", f"E:\n  pre: {text}\n  eff: pass\n"))
    assert not found
    (event,) = tree.sections
    assert isinstance(event, Event)
    clause = event.clauses[0]
    assert isinstance(clause, Guard)
    return clause.condition


def shape(text: str) -> str:
    """A guard's tree without its places."""
    return re.sub(r"  @.*", "", show_tree(guard(text)))


def run(text: str) -> str:
    """The tree is made and shown whatever the text is; every diagnostic rendered."""
    source = Source("t.koord", text)
    tree, found = parse(source)
    assert show_tree(tree)
    to_json((source, d) for d in found)
    return "\n".join(render(d, source) for d in found)


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("a + b * c", "a + (b * c)"),
        ("a - b - c", "(a - b) - c"),
        ("-a * b", "(-a) * b"),
        ("-a.x", "-(a.x)"),
        ("not a == b", "not (a == b)"),
        ("a or b and not c", "a or (b and (not c))"),
        ("a if b else c if d else e", "a if b else (c if d else e)"),
        ("a or b if c else d", "(a or b) if c else d"),
        ("a // b % c / d", "((a // b) % c) / d"),
        ("x[pid + 1].y", "(x[pid + 1]).y"),
    ],
)
def test_operators_bind_as_in_python(text: str, same: str) -> None:
    assert shape(text) == shape(same)


def test_a_chain_is_one_node() -> None:
    chain = guard("0 <= a < b")
    assert isinstance(chain, expr.Compare) and [op for op, _ in chain.rest] == ["<=", "<"]
    assert shape("0 <= a < b") != shape("(0 <= a) < b")


def test_nodes_know_their_place() -> None:
    tree, _ = parse(Source("t", "E:\n  pre: (a +\n    bc) < 3\n  eff: pass\n"))
    assert isinstance(tree.sections[0], Event)
    condition = tree.sections[0].clauses[0]
    assert isinstance(condition, Guard) and isinstance(condition.condition, expr.Compare)
    span = condition.condition.first.span
    assert (span.line, span.column, span.end_line, span.end_column) == (2, 8, 3, 8)
    assert isinstance(span, Span)


def test_windows_line_ends_and_a_missing_last_one_change_nothing() -> None:
    plain = parse(Source("t", LINEFORM))
    assert parse(Source("t", LINEFORM.replace("\n", "\r\n"))) == plain
    assert parse(Source("t", LINEFORM.rstrip("\n"))) == plain
    assert plain[0].sections and not plain[1]


def test_a_byte_order_mark_changes_nothing() -> None:
    assert parse(Source("t", "\ufeff" + LINEFORM)) == parse(Source("t", LINEFORM))


def test_a_mistake_in_one_section_hides_no_other() -> None:
    found = run("E:\n  pre True\n  eff: pass\nF:\n  pre: (\nG:\n  pre: 3 +\n  eff: pass\n")
    assert found.count("error") == 3
    assert "t.koord:2:6: error[K001]: expected ':' after 'pre'" in found
    assert "t.koord:5:8: error[K006]: '(' is never closed" in found


def test_a_diagnostic_shows_line_and_place() -> None:
    text = run("E:\n  pre: (a\n  eff: pass\n")
    assert text == "t.koord:2:8: error[K006]: '(' is never closed\n2 |   pre: (a\n  |        ^"


DEEP = {
    "brackets": "(" * 1000 + "a" + ")" * 1000,
    "open brackets": "(" * 1000,
    "minus": "-" * 5000 + "a",
    "not": "not " * 5000 + "b",
    "sum": "+".join(["a"] * 5000),
    "or": " or ".join(["b"] * 5000),
    "index": "x[" * 1000 + "0" + "]" * 1000,
    "call": "abs(" * 1000 + "a" + ")" * 1000,
    "field": "a" + ".x" * 5000,
    "choice": " if b else ".join(["b"] * 3000),
    "power": " ** ".join(["a"] * 3000),
    "quantifiers": "forall i in ID: " * 1000 + "b",
    "map": "{1: " * 1000 + "2" + "}" * 1000,
    "tuple": "(1, " * 1000 + "2" + ")" * 1000,
    "primes": "a" + "'" * 5000,
    "comparison": " < ".join(["a"] * 5000),
}


@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP.keys())
def test_what_is_nested_too_deeply_is_told(text: str) -> None:
    found = run(f"{PRELUDE}E:\n  pre: {text}\n  eff: pass\n")
    assert found.count("error[K007]") == 1 or found.count("error[K006]") == 1
    assert found.count("error[") == 1


@pytest.mark.parametrize(
    "text", ["List<" * 1000 + "int" + ">" * 1000, "int" + "[]" * 1000, "(int, " * 90 + "int" + ")" * 90]
)
@pytest.mark.parametrize("place", ["local: {} x", "fun f({} x) -> int: return 1", "init: {} x", "init: {} x = y"])
def test_types_nest_to_a_limit(text: str, place: str) -> None:
    found = run(place.format(text))
    assert (found.count("error[K007]") == 1) == ("," not in text)
    assert found.count("error[") <= 1


@pytest.mark.parametrize("depth", [25, 31, 200, 2000])
def test_blocks_nest_to_a_limit(depth: int) -> None:
    lines = ["E:", "  pre: True", "  eff:"]
    lines += [f"{' ' * (i + 4)}if b:" for i in range(depth)]
    lines.append(" " * (depth + 4) + "a = 1")
    found = run(PRELUDE + "\n".join(lines))
    assert ("K007" in found) == (depth > 30)


def test_the_deepest_allowed_program_passes_all_passes() -> None:
    """Blocks, a chain of elif and an expression at their limits at once stay within Python's stack."""
    lines = ["E:", "  pre: b", "  eff:"]
    lines += [f"{' ' * (i + 4)}if b:" for i in range(26)]
    pad = " " * 30
    lines += [f"{pad}if a == 0:", f"{pad} a = 1"]
    for i in range(90):
        lines += [f"{pad}elif a == {i} + 1:", f"{pad} a = {'-(1 + ' * 45}a{')' * 45}"]
    source = Source("t", PRELUDE + "\n".join(lines))
    tree, found = parse(source)
    program, more = check(tree, source)
    assert not found and not any(d.severity == "error" for d in more)
    assert program is not None
    verify(program)
    assert show(program)


ODD = ["", "\n", "   ", "\t", "\0", "a", ":", "#", "\\", "\\\n", "x:\n", "pre:", '"', "'", "\ufeff",
       "E:\n pre:\n", "🦊:\n", "using", "using M", "using M:", "param int k =",
       "E:\n  pre: 1e\n",
       "\r", "E:\n  pre: .\n",
       "(", ")", "([)]",
       "9" * 5000, f"E:\n  pre: {'9' * 5000} > 0\n  eff: pass", "init:\n", "local:",
       "allread: int x[", "else:",
       "  x = 3",
       "E: pre: True\n", "E: pre: True\n   eff: pass", "E:\n  pre: True\n  eff: pass\n stray", "x = 3"]  # fmt: skip


@pytest.mark.parametrize("text", ODD)
def test_odd_texts_yield_diagnostics(text: str) -> None:
    found = run(text)
    right = text in ("", "\n", "   ", "\t", "#", "\\\n", "\ufeff") or text.startswith("E: pre: True\n")
    assert ("error[" in found) != right


def test_collection_is_left_as_it_was() -> None:
    parse(Source("t", LINEFORM))
    assert gc.isenabled()
    gc.disable()
    try:
        parse(Source("t", "("))
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_tables_do_not_depend_on_the_hash_seed() -> None:
    text = tables()
    assert TABLES.read_text(encoding="utf-8") == text
    for seed in ("1", "77"):
        code = "import sys; from koordgen.lang.syntax.generate import tables; sys.stdout.write(tables())"
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, check=True)
        assert done.stdout.decode() == text


def test_checking_needs_neither_the_grammar_nor_heavy_imports() -> None:
    code = (
        "import sys\nfrom koordgen.lang.source import Source\nfrom koordgen.lang.syntax.parse import parse\n"
        "from koordgen.lang.analyze.program import check\nsource = Source('t', open(sys.argv[1]).read())\n"
        "assert check(parse(source)[0], source)[0]\n"
        "print(sorted({'lark', 'dataclasses', 'inspect', 'json', 'pathlib', 'difflib', 'jinja2'} & set(sys.modules)))"
    )
    path = str(ROOT / "examples/lineform/lineform.koord")
    done = subprocess.run([sys.executable, "-I", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}", path],
                          capture_output=True, check=True)  # fmt: skip
    assert done.stdout.decode().strip() == "[]"

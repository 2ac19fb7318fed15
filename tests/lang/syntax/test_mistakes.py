"""One mistake, one message, in the language's words: what is told to those who come from Python or C, and to those
whose fingers slip."""

from __future__ import annotations

import re
import time

import pytest

from koordgen.lang.diagnostics import Diagnostic, render
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse
from tests.lang.test_lang import found

EVENT = "E:\n  pre: b\n  eff:\n    {}\n"


def sole(text: str) -> Diagnostic:
    """The only thing found in a text."""
    source = Source("t", text)
    _, found = parse(source)
    assert len(found) == 1, [(d.span.line, d.message) for d in found]
    assert render(found[0], source)
    return found[0]


def spot(told: Diagnostic, text: str) -> str:
    """What the carets stand under."""
    line = text.split("\n")[told.span.line - 1]
    return line[told.span.column - 1 : told.span.end_column - 1]


STATEMENTS = [
    # Other languages
    ("x++", "+", "Koord has no '++'", "write x += 1"),
    ("x--", "", "Koord has no '--'", "write x -= 1"),
    ("++x", "+", "Koord has no '++'", "write x += 1"),
    ("x = +3", "+", "a value cannot have a '+' before it", "remove the '+'"),
    ("x = a ? b : c", "?", "unexpected character '?'", "write 'a if condition else b'"),
    ("x = if a then b else c", "if", "expected an expression, found 'if'", "write 'a if condition else b'"),
    ("x = 3; y = 4", ";", "unexpected character ';'", "each statement on a line of its own"),
    ("x = y × z", "×", "unexpected character '×' (U+00D7)", "write '*'"),
    ("x = y ≤ z", "≤", "unexpected character '≤' (U+2264)", "write '<='"),
    ("x = “a”", "“", "unexpected character '“' (U+201C)", 'straight quotes: "..."'),
    ("é = 3", "é", "unexpected character 'é'", "a name is made of the letters a to z"),
    ("x = \0", "\0", "unexpected character 'U+0000'", ""),
    ("x = a & b", "&", "unexpected character '&'", "write 'and'"),
    ("x = a <> b", ">", "Koord has no '<>'", "write '!='"),
    ("x = a === b", "=", "Koord has no '==='", "write '=='"),
    ("x = a => b", "=", "Koord has no '=>'", "write '>='"),
    ("x = a =< b", "=", "Koord has no '=<'", "write '<='"),
    ("x := 3", ":", "Koord has no ':='", "write '='"),
    ("x = p->y", "->", "Koord has no '->'", "write '.'"),
    ("x = M::y", ":", "Koord has no '::'", "write '.'"),
    ("x = a is b", "is", "Koord has no 'is'", "'==' compares"),
    ("x = a is not b", "is", "Koord has no 'is'", "'!=' compares"),
    ("// a comment", "//", "a line cannot begin with '//'", "a comment begins with '#'"),
    ("x = 3 // the first one", "first", "expected an operator, found 'first'", "a comment begins with '#'"),
    ('"""what this does"""', '""', "a string must be on one line", "a comment begins with '#'"),
    ("x = lambda y: y", "lambda", "Koord has no 'lambda'", "fun name(Type x) -> Type:"),
    ("xs = [x for x in ys]", "for", "Koord has no comprehensions", "fill a list in a loop"),
    ("xs = {x for x in ys}", "for", "Koord has no comprehensions", "fill a set in a loop"),
    ("s = sum(x for x in ys)", "for", "Koord has no comprehensions", "in a loop"),
    ("import math", "import", "Koord has no 'import'", "extern fun"),
    ("print 'abc'", "print", "Koord has no 'print'", "Log.stdout << value"),
    ('x = f"at {y}"', "f", "Koord has no f-strings", "str(x)"),
    ("x = f'at'", "f'", "Koord has no f-strings", "str(x)"),
    ('x = r"at"', "r", "a string has no prefix before its quotes", ""),
    ("x = 'a' 'b'", "'b'", "two strings follow each other", "join them with '+'"),
    ("let x = 3", "let", "Koord has no 'let'", "the type must come before the name: int x = 3"),
    ("let x: int = 3", "let", "Koord has no 'let'", "the type must come before the name: int x = 3"),
    ("var x = 3", "var", "Koord has no 'var'", "the type must come before the name: int x = 3"),
    ("x = new Foo()", "new", "Koord has no 'new'", "Task(target=p)"),
    ("try:\n      x = 3", "try", "Koord has no 'try'", "Koord has no exceptions"),
    ("try: x = 3\n    except: x = 4\n    finally: x = 5", "try", "Koord has no 'try'", "Koord has no exceptions"),
    ("global n, m", "global", "Koord has no 'global'", "remove the line"),
    ("switch x:\n      pass", "switch", "Koord has no 'switch'", "if, elif, else"),
    ("foreach x in xs:\n      pass", "foreach", "Koord has no 'foreach'", "for x in xs:"),
    ("for each x in xs:\n      pass", "each", "Koord has no 'each'", "for x in xs:"),
    ("for (i = 0; i < 3; i++):\n      pass", "(", "expected a name after 'for', found '('", "range(a, b)"),
    ("for (a, b) in xs:\n      pass", "(", "expected a name after 'for', found '('", "for a, b in pairs:"),
    ("for i = 1 to 3:\n      pass", "to", "expected ',' or ':', found 'to'", "range(a, b)"),
    ("for i in 1..3:\n      pass", ".3", "expected ',' or ':', found '.3'", "range(a, b)"),
    ("if a {\n      x = 3\n    }", "{", "blocks have no braces", "end the header with ':'"),
    ("if (a) {\n      x = 3\n    }", "{", "blocks have no braces", "end the header with ':'"),
    ("if (a) x = 3", "", "expected ':' after the condition of 'if'", ""),
    ("if a then\n      x = 3", "then", "Koord has no 'then'", "a condition ends with ':'"),
    ("if a: x = 1\n    else if b: x = 2", "if", "expected ':' after 'else'", "write 'elif'"),
    ("if a: x = 1\n    elseif b: x = 2", "elseif", "Koord has no 'elseif'", "write 'elif'"),
    ("if a: x = 1 else: x = 2", "else", "'else' must begin a line", ""),
    ("if a: if b: x = 2", "if", "'if' must begin a line", ""),
    ("elif x:\n      y = 3", "elif", "there is no 'if' for this 'elif'", "indent it like the 'if'"),
    ("f(*xs)", "*", "'*' cannot spread values here", "one by one"),
    # Assignments
    (
        "a = b = c",
        "=",
        "an assignment has no value and cannot be part of another one",
        "each assignment on its own line",
    ),
    ("a, b = pair", "a, b = pair", "an assignment has one target", "p[0], p[1]"),
    ("x = a, b", ",", "expected one value, found ','", "write a tuple in brackets: (a, b)"),
    ("a + b = 3", "a + b", "the left side of '=' cannot be assigned", ""),
    ("if a = 3:\n      pass", "=", "'=' assigns and cannot be used in a condition", "'==' compares"),
    ("while a = 3: pass", "=", "'=' assigns and cannot be used in a condition", "'==' compares"),
    ("x = (a = 3)", "=", "'=' assigns and cannot be used in a condition", "'==' compares"),
    ("int a, b", ",", "declare each name on its own line", "on the next line"),
    ("int a = 3, b = 4", ",", "declare each name on its own line", "on the next line"),
    ("int x[3]", "[", "a variable of a block has no size", "declare a list as List<int> x"),
    ("(a + b) x", "(a + b)", "this is not a type", "a type and a name"),
    ("foo bar baz", "baz", "expected '=' or the end of the line after 'bar', found 'baz'", ""),
    # Numbers and strings
    ("x = 010", "010", "a number does not begin with 0: 010", "write 10"),
    ("x = 1_000", "1_000", "'1_000' is not a number", "write 1000"),
    ("x = 0x1F", "0x1F", "'0x1F' is not a number", "write 31"),
    ("x = 0b11", "0b11", "'0b11' is not a number", "write 3"),
    ("x = 1.5f", "1.5f", "'1.5f' is not a number", "write 1.5"),
    ("x = 12abc", "12abc", "'12abc' is not a number", "a name does not begin with a digit"),
    ("x = 1.", "1.", "'1.' is not a number", "write 1.0"),
    ("x = 'abc", "'", "this string is not closed", "end it with ' on the same line"),
    ('x = f("abc)', '"', "this string is not closed", 'end it with " on the same line'),
    (r'x = "a\qb"', r"\q", r"'\q' is not an escape sequence", r"\n \t"),
    # Brackets
    ("x = (3", "(", "'(' is never closed", ""),
    ("x = f([3)", ")", "')' does not close '['", ""),
    ("x = xs[i, j]", ",", "expected ']', found ','", "x[i][j]"),
    ("x = xs[a:b:c]", ":", "a slice has no step", "range(a, b, 2)"),
    ("x = xs[::2]", ":", "a slice has no step", "range(a, b, 2)"),
    ("x = (1,)", "(1,)", "a tuple has at least two items", "need no comma"),
    ("x = {1: 2, 3}", "}", "expected an operator or ':' after '3', found '}'", ""),
    # Words that are taken, words that are misspelt
    ("init = 3", "init", "expected a name, found 'init'", "'init' is a keyword of Koord"),
    ("int pre = 3", "pre", "expected a name, found 'pre'", "'pre' is a keyword of Koord"),
    ("for init in xs: pass", "init", "expected a name, found 'init'", "'init' is a keyword of Koord"),
    ("x = a.init", "init", "expected a name, found 'init'", "'init' is a keyword of Koord"),
    ("xs = List()", "List", "'List' is a type, not a value", "write an empty one as []"),
    ("xs = Set<int>()", "Set", "'Set' is a type, not a value", "write an empty one as {}"),
    ("List xs = []", "xs", "expected '<' after 'List'", "List<Point>"),
    ("List[int] xs = []", "[", "expected '<' after 'List'", "List<Point>"),
    ("whlie x:\n      pass", "whlie", "'whlie' is not a keyword of Koord", "did you mean 'while'?"),
    (
        "while x:\n      pass\n    esle:\n      pass",
        "esle",
        "'esle' is not a keyword of Koord",
        "did you mean 'else'?",
    ),
    ("fro i in xs: pass", "fro", "'fro' is not a keyword of Koord", "did you mean 'for'?"),
    ("retrun x + 1", "retrun", "'retrun' is not a keyword of Koord", "did you mean 'return'?"),
    ("if a adn b:\n      pass", "adn", "'adn' is not a keyword of Koord", "did you mean 'and'?"),
    ("if a AND b: pass", "AND", "'AND' is not a keyword of Koord", "did you mean 'and'?"),
    ("x = a if b esle c", "esle", "'esle' is not a keyword of Koord", "did you mean 'else'?"),
    ("while x\n      y = 3", "", "expected ':' after the condition of 'while'", ""),
    ("for i in xs\n      pass", "", "expected ':' after the values of 'for'", ""),
    ("for x xs:\n      pass", "xs", "expected ',' or 'in' after 'x', found 'xs'", ""),
    ("if a b:\n      pass", "b", "expected an operator or ':' after 'a', found 'b'", ""),
    ("atomic x = 3", "", "expected ':' after 'atomic'", ""),
    # The rest of expressions and statements
    ("x = a +", "", "expected an expression after '+', found the end of the line", "a line continues after '\\'"),
    ("x = a b", "b", "expected an operator or the end of the line after 'a', found 'b'", ""),
    ("x = a not b", "b", "expected 'in' after 'not', found 'b'", ""),
    ("x = a if b", "", "expected an operator or 'else' after 'b', found the end of the line", ""),
    ("x = forall i: a", ":", "expected 'in' and a domain for the names", "forall i in ID"),
    ("x = forall i in ID a", "", "expected ':' after the values of 'forall'", ""),
    ("x = for all i in ID: a", "for", "expected an expression, found 'for'", "forall i in ID"),
    ("x = frall i in ID: a", "frall", "'frall' is not a keyword of Koord", "did you mean 'forall'?"),
    ("return", "", "a function returns a value", "write 'return value'"),
    ("stop now", "now", "expected the end of the line after 'stop', found 'now'", ""),
    ("= 3", "=", "expected a statement, found '='", ""),
    ("def f():\n      pass", "def", "expected a statement, found 'def'", "write it at the left margin"),
    ("eff: x = 3", "eff", "expected a statement, found 'eff'", "must be indented once"),
    ("x == 3\n      y = 4", "", "unexpected indentation", "indent it by 4 spaces as line"),
]


@pytest.mark.parametrize(("line", "under", "message", "help"), STATEMENTS, ids=[s[0] for s in STATEMENTS])
def test_in_a_statement(line: str, under: str, message: str, help: str) -> None:
    text = EVENT.format(line)
    told = sole(text)
    assert told.message == message
    assert help in told.help if help else not told.help
    if under:
        assert spot(told, text) == under


SECTIONS = [
    ("local: x = 3", "=", "expected a name after 'x', found '='", "the type must come before the name: int x"),
    ("local: let x = 3", "let", "Koord has no 'let'", "the type must come before the name"),
    ("local: int", "", "expected a name after 'int', found the end of the line", ""),
    ("local: int x, y", ",", "declare each name on its own line", "on the next line"),
    ("local: int x y", "y", "expected '=' or the end of the line after 'x', found 'y'", ""),
    ("local\n  int x", "", "expected ':' after 'local'", ""),
    ("locl: int a", "locl", "'locl' is not a keyword of Koord", "did you mean 'local'?"),
    ("allraed: Point x[N_SYS]", "allraed", "'allraed' is not a keyword of Koord", "did you mean 'allread'?"),
    ("Local: int a", "Local", "'Local' is not a keyword of Koord", "did you mean 'local'?"),
    ("allread: Point[N_SYS] x", "N_SYS", "the size must come after the name", "Point x[N_SYS]"),
    ("allread: int init", "init", "expected a name, found 'init'", "choose another name"),
    ("local: List x", "x", "expected '<' after 'List'", "List<Point>"),
    ("local: Map x", "x", "expected '<' after 'Map'", "Map<int, Point>"),
    ("local: List<int x", "x", "expected ',' or '>' after 'int', found 'x'", ""),
    ("local: Array<int> x", "<", "'Array' takes no types in '<...>'", "'List'"),
    ("local: Box<int> x", "<", "'Box' takes no types in '<...>'", "List, Map, Set and Queue"),
    ("param k = 3", "=", "expected a name after 'k', found '='", "int k"),
    ("param int k", "", "expected '=' after 'k', found the end of the line", "a build or a fleet file"),
    ("using Motion\n  sensors: Point p", "", "expected ':' after 'using Motion'", ""),
    ("using Motion as M:\n  sensors: Point p", "", "expected ':' after 'using Motion'", ""),
    ("using Motion:", "", "expected an indented block after 'using Motion'", ""),
    ("using Motion:\n  sensor: Point p", "sensor", "'sensor' is not a keyword of Koord", "'sensors'"),
    (
        "using Motion:\n  sensors: Point p, Point q",
        ",",
        "declare each name on its own line",
        "on the next line",
    ),
    ("using Motion:\n  sensors: Point p = 3", "=", "a port has no initial value", ""),
    ("using Motion:\n  position", "", "expected a name after 'position', found the end of the line", "Point position"),
    ("using Motion:\n  assume: a", ":", "expected an expression after 'assume', found ':'", "has no colon"),
    ("using Motion:\n  assume a = b", "=", "'=' assigns and cannot be used in a condition", "'==' compares"),
    ("x = 3", "", "expected ':' after 'x'", "a variable is declared under 'local:'"),
    ("int x = 3", "", "expected ':' after 'int'", "a variable is declared under 'local:'"),
    ("List<int> xs = []", "List", "expected a section, found 'List'", "a variable is declared under 'local:'"),
    ("f(3)", "", "expected ':' after 'f'", "write a statement under 'init:'"),
    ("if a: b = 3", "if", "expected a section, found 'if'", "under 'init:' or an event's 'eff:'"),
    ("pre: a", "pre", "expected a section, found 'pre'", "under the name of its event"),
    ("sensors: int a", "sensors", "expected a section, found 'sensors'", "under 'using Module:'"),
    ("42", "42", "expected a section, found '42'", "a section begins with 'using',"),
    ("from math import sin", "from", "Koord has no 'from'", "extern fun"),
    ("import math", "", "expected ':' after 'import math', found the end of the line", "extern fun"),
    ("import math as m", "as", "expected ':' after 'import math', found 'as'", "extern fun"),
    ("import:\n  int x", ":", "expected a name after 'import', found ':'", "import Name:"),
    ("import Mapping:\n  int x = 3", "=", "expected the end of the line, found '='", "the exporter's declaration"),
    ("imprt Mapping:\n  int x", "imprt", "'imprt' is not a keyword of Koord", "did you mean 'import'?"),
    ("export Mapping:\n  int x", "Mapping", "expected ':' after 'export', found 'Mapping'", "'export:' has no name"),
    ("export: int x", "int", "expected the end of the line after ':', found 'int'", ""),
    ("export:\n  int x = 3", "=", "expected the end of the line, found '='", "its declaration under"),
    ("export:\n  List<int> x max 3", "max", "expected the end of the line, found 'max'", "of the declaration"),
    ("export:\n  int x\n    guarantee: x > 3", ":", "expected a name after 'guarantee', found ':'", "guarantee Name"),
    ("export:\n  int x\n    garantee A: x > 3", "garantee", "'garantee' is not a keyword of Koord", "'guarantee'?"),
    ("class Foo:\n  int x", "class", "Koord has no 'class'", "def Name:"),
    ("def f(int x) -> int:\n  return x", "def f", "'def' defines a record", "fun f(Type x) -> Type:"),
    ("fun f(x) -> int:\n  return x", "x", "a parameter needs a type before its name", "write 'int x'"),
    ("fun f(x: int) -> int:\n  return x", "x", "a parameter needs a type before its name", "write 'int x'"),
    ("fun f(int x):\n  return x", ":", "a function must declare the type of its result", "write '-> Type' after ')'"),
    ("fun f(int x) int:\n  return x", "int", "a function must declare the type of its result", "write '-> Type'"),
    ("fun f(int x) -> int\n  return x", "", "expected ':' after the type of the result", ""),
    ("fun f(int x = 3) -> int:\n  return x", "=", "a parameter cannot have a default value", ""),
    ("func f(int x) -> int:\n  return x", "func", "Koord has no 'func'", "fun name(Type x) -> Type:"),
    ("extern fun f(int a)", "", "a function must declare the type of its result", "write '-> Type'"),
    ("extern f(int a) -> int", "f", "expected 'fun' or 'type' after 'extern', found 'f'", ""),
    ("extern fun f(int a) -> int:\n  require: a > 0", "require", "'require' is not a keyword of Koord", "'requires'"),
    ("spec fun f(int a) -> bool:\n  return True", ":", "a spec function has no body", "axiom Name:"),
    ("invariant: x", ":", "expected a name after 'invariant', found ':'", "invariant Name: ..."),
    ("invariant A x > 3", "", "expected ':' after 'invariant A'", ""),
    ("invariant A:\n  x\n  y", "y", "a condition is one expression", "join conditions with 'and' or 'or'"),
    ("invariant A: x = 3", "=", "'=' assigns and cannot be used in a condition", "'==' compares"),
    ("invariant A:\n  x = 3", "=", "'=' assigns and cannot be used in a condition", "'==' compares"),
    ("initially Foo: x", "Foo", "expected ':' after 'initially'", "'initially' has no name"),
    ("invariatn A: x", "invariatn", "'invariatn' is not a keyword of Koord", "did you mean 'invariant'?"),
    ("Go\n  pre: a\n  eff: pass", "", "expected ':' after 'Go'", ""),
    ("Go:\n  pre a\n  eff: pass", "", "expected ':' after 'pre'", ""),
    ("Go:\n  pre: a\n  eff\n    pass", "", "expected ':' after 'eff'", ""),
    ("Go:\n  rpe: a\n  eff: pass", "rpe", "'rpe' is not a keyword of Koord", "did you mean 'pre'?"),
    ("Go:\n  pre: a\n  eff: pass\n  x = 3", "x", "expected 'pre' or 'eff', found 'x'", "write statements under 'eff:'"),
    ("Go:\n  pre: a\n  effect: pass", "effect", "expected 'pre' or 'eff', found 'effect'", "write 'eff:'"),
    ("Go:\n  guard: a\n  eff: pass", "guard", "expected 'pre' or 'eff', found 'guard'", "write 'pre:'"),
    ("Go:\n    pre: a\n  eff: pass", "e", "2 spaces match no enclosing block", "or line 2 by 2"),
    ("Go:\n  pre: a\n    eff: pass", "", "unexpected indentation", "indent it by 2 spaces as line 2"),
    ("Go:\n  pre: a,\n  eff: pass", ",", "expected one value, found ','", "write a tuple in brackets"),
    ("Go:\n  pre: a = 3\n  eff: pass", "=", "'=' assigns and cannot be used in a condition", "'==' compares"),
    ("Go:\n  pre:\n  eff: pass", "", "expected an indented block after 'pre'", ""),
    ("event Go:\n  pre: a\n  eff: pass", "event", "Koord has no 'event'", "Name:"),
    ("def Task:\n  Point target,\n  int id", ",", "declare each name on its own line", "on the next line"),
    ("priority:\n  pre: a\n  eff: x = 3", "pre", "expected the name of an event, found 'pre'", "'Name:', with 'pre:'"),
    ("priority:\n  x = 3\n  Go:\n    pre: a\n    eff: pass", "=", "expected ':' after 'x', found '='", "only events"),
    (
        "priority:\n  local: int a\n  Go:\n    pre: a\n    eff: pass",
        "local",
        "expected the name of an event, found 'local'",
        "'local' begins a section: write it at the left margin",
    ),
    ("priority:\n  stop\n", "stop", "expected the name of an event, found 'stop'", "only events are allowed"),
    ("priority:", "", "expected an indented block after 'priority'", ""),
    ("priority Go:\n  A:\n    pre: a\n    eff: pass", "Go", "expected ':' after 'priority', found 'Go'", "has no name"),
    (
        "priority: Go:\n    pre: a\n    eff: pass",
        "Go",
        "expected the end of the line after 'priority:', found 'Go'",
        "only events are allowed",
    ),
    (
        "priority:\n  priority:\n    Go:\n      pre: a\n      eff: pass",
        "Go",
        "expected 'pre' or 'eff', found 'Go'",
        "'priority:' cannot be inside of another block",
    ),
    ("Priority:\n  Go:\n    pre: a\n    eff: pass", "Priority", "'Priority' is not a keyword of Koord", "'priority'"),
    ("order:\n  Go:\n    pre: a\n    eff: pass", "Go", "expected 'pre' or 'eff', found 'Go'", "under 'priority:'"),
    ("priority:\n  Go:\n    per: a\n    eff: pass", "per", "'per' is not a keyword of Koord", "did you mean 'pre'?"),
    ("inti:\n  x = 3", "inti", "'inti' is not a keyword of Koord", "did you mean 'init'?"),
    ("Go:\n  pre: a\n\teff: pass", "\t", "the indentation contains a tab", "indent with spaces"),
]


@pytest.mark.parametrize(("text", "under", "message", "help"), SECTIONS, ids=[s[0] for s in SECTIONS])
def test_in_a_section(text: str, under: str, message: str, help: str) -> None:
    told = sole(text + "\n")
    assert told.message == message
    assert help in told.help if help else not told.help
    if under:
        assert spot(told, text) == under


@pytest.mark.parametrize(
    "text",
    [
        "x = 3\n    form = 4\n    on = a\n    to = b\n    each = end\n    print(to)",
        "float print = 3",
        "for each in xs: pass",
        "x = requires + ensures + type + result + new",
        "x = y-1 - -1",
        "x = a //b",
        "x = 0 + 0.5 + 00.5 + 1e0",
        "x = max(a, max(b, c))",
    ],
)
def test_names_that_are_words_elsewhere_stay_names(text: str) -> None:
    assert parse(Source("t", EVENT.format(text)))[1] == []


def test_an_open_bracket_reaches_no_further_than_its_statement() -> None:
    """Where a line begins with a word that stands in no bracket, the one before it is at fault."""
    text = (
        EVENT.format("x = f((3,\n      4\n    while a:\n      y = 1 +") + "F:\n  pre: (a\nG:\n  pre: b c\n  eff: pass\n"
    )
    _, found = parse(Source("t", text))
    assert [(d.span.line, d.message) for d in found] == [
        (4, "'(' is never closed"),
        (7, "expected an expression after '+', found the end of the line"),
        (9, "'(' is never closed"),
        (11, "expected an operator or the end of the line after 'b', found 'c'"),
    ]


def test_several_mistakes_are_told_once_each() -> None:
    text = (
        "using Motion\n  sensors: Point p\nlocal: int x, y\nE:\n  pre x\n  eff:\n    x++\n    y = 010\n"
        "    if x = 3:\n      whlie x:\n        pass\n    x = 'abc\n    y = 1\n"
    )
    _, found = parse(Source("t", text))
    assert [d.span.line for d in found] == [1, 3, 5, 7, 8, 9, 10, 12]


FLEET = """\
using Motion:
  actuators: Point target
local:
  int n
  bool b
{declared}
Go:
  pre: b
  eff:
    {line}
"""


@pytest.mark.parametrize(
    ("line", "message", "help"),
    [
        (
            "k = 3",
            "k is not defined",
            "declare k: 'int k = 3'; declare k under 'local:' to keep it for later events",
        ),
        ("k = n / 2\n    b = k > 3", "k is not defined", "'float k = n / 2'"),
        ("k = [1]\n    k.append(2)", "k is not defined", "'List<int> k = [1]'"),
        ("k = []", "k is not defined", "'List<Point> k = []'"),
        ("k = k + 1", "k is not defined", "'Type k = ...'"),
        ("k += 1", "k is not defined", "'int k = ...'"),
        ("nn = n\n    Motion.tagret = nn", "the port Motion.tagret is not declared", ""),
        ("global n", "Koord has no 'global'", "under local, allread or allwrite is visible everywhere"),
        ("raise", "Koord has no 'raise'", "Koord has no exceptions"),
        ("b = n and b", "'and' joins bools, not an int", "compare the number: 'n != 0'"),
        ("b = b or [n]", "'or' joins bools, not a List<int>", "'len([n]) > 0'"),
        ("n = n + b", "'+' does not apply to an int and a bool", "'(1 if b else 0)'"),
        ("string s = '%d' % n", "'%' does not apply to a string and an int", "'n is ' + str(n)"),
        ("string s = 'n is ' + n", "'+' does not apply to a string and an int", "write str(n)"),
        ("b = n == b", "an int and a bool cannot be compared", "make the number a bool: 'n != 0'"),
        ("b = 'a' == n", "a string and an int cannot be compared", "write str(n)"),
        ("b = n", "b is a bool, not an int", "compare the number: 'n != 0'"),
        ("n = b", "n is an int, not a bool", "'1 if b else 0'"),
        ("b = Motion.target > Motion.target", "'>' does not apply to a Point and a Point", "distances"),
        ("Motion.target = Motion.target + 1", "'+' does not apply to a Point and an int", "Point(x, y, z)"),
        ("Go()", "Go is an event and is not called", "by their guards"),
        ("if b:\n      int k = n\n    n = k", "k is not defined here", "declare k before the block: 'int k'"),
        ("if b:\n      int k = n\n    k = n\n    n = k", "k is not defined here", "before the block: 'int k'"),
    ],
)
def test_what_the_checker_says_to_a_first_reader(line: str, message: str, help: str) -> None:
    told = found(FLEET.format(line=line, declared=""))
    assert message in told[-1].message
    assert help in told[-1].help
    assert len(told) == (2 if "tagret" in line else 1), told


def test_labels_point_to_what_is_meant() -> None:
    (told,) = found(FLEET.format(line="if b:\n      int k = n\n    n = k", declared=""))
    assert [(label.span.line, label.span.column) for label in told.labels] == [(11, 11)]
    (told,) = found(FLEET.format(line="n = len([n])", declared="  int len"))
    assert [label.span.line for label in told.labels] == [6]


@pytest.mark.parametrize(
    "line",
    [
        "x = " + "1" * 10**6,
        "x = " + "1" * 10**6 + "z",
        "x = '" + "a" * 10**6,
        "x = '" + "\\" * 10**6,
        "x" * 10**6 + " y z",
        "x = " + "(" * 10**5,
        "x = " + "-" * 10**5,
        "x = " + "a+" * 10**5,
        "x = " + "]" * 10**5,
        "List<" * 10**5 + "int",
    ],
    ids=lambda line: line[:12],
)
def test_a_line_of_a_megabyte_is_answered_soon_and_shortly(line: str) -> None:
    start = time.monotonic()
    source = Source("t", EVENT.format(line))
    _, found = parse(source)
    assert found
    assert all(len(render(d, source)) < 1000 for d in found), [len(d.message) for d in found]
    assert time.monotonic() - start < 15  # seconds; a few where it is linear, hours where it is not


def test_no_message_speaks_of_the_parser() -> None:
    """Names of tokens and of rules stay inside."""
    for text, *_ in [*SECTIONS, *((EVENT.format(s[0]),) for s in STATEMENTS)]:
        for told in parse(Source("t", text + "\n"))[1]:
            assert not re.search(r"\b(NAME|GENERIC|INT|FLOAT|STRING|NEWLINE|INDENT|DEDENT|END|BAD)\b", told.message)
            assert "expr" not in told.message.replace("expression", "")

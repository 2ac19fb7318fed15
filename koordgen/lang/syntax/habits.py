"""Errors for syntax of other languages, with the form that Koord has. marks.py has operators."""

from __future__ import annotations

from collections.abc import Callable

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.syntax.spot import Spot, place, shown

_EXCEPTIONS = "Koord has no exceptions: a fault discards the event and the robot holds; test before you divide or index"
_GLOBAL = "every variable that is declared under local, allread or allwrite is visible everywhere: leave the line out"
_WHILE = "write 'while condition:'"
_CASES = "write a chain of if, elif, else"
_RECORD = "a record is written 'def Name:', its fields below: Type field"
_FUNCTION = "a function is written 'fun name(Type x) -> Type:'"
# Keyword of another language, at or after which parsing fails -> help.
FOREIGN = {
    "import": "a function written in Python is declared: extern fun name(Type x) -> Type",
    "from": "a function written in Python is declared: extern fun name(Type x) -> Type",
    "include": "a function written in Python is declared: extern fun name(Type x) -> Type",
    "class": _RECORD,
    "struct": _RECORD,
    "record": _RECORD,
    "function": _FUNCTION,
    "func": _FUNCTION,
    "fn": _FUNCTION,
    "lambda": "give the function a name: fun name(Type x) -> Type:",
    "try": _EXCEPTIONS,
    "except": _EXCEPTIONS,
    "catch": _EXCEPTIONS,
    "finally": _EXCEPTIONS,
    "raise": _EXCEPTIONS,
    "throw": _EXCEPTIONS,
    "switch": _CASES,
    "match": _CASES,
    "case": _CASES,
    "elseif": "write 'elif'",
    "elsif": "write 'elif'",
    "foreach": "write 'for x in xs:'",
    "each": "write 'for x in xs:'",
    "do": _WHILE,
    "until": _WHILE,
    "repeat": _WHILE,
    "loop": _WHILE,
    "unless": "write 'if not condition:'",
    "then": "a condition ends with ':'",
    "end": "a block ends where the indentation goes back",
    "endif": "a block ends where the indentation goes back",
    "begin": "a block begins with ':' and deeper lines",
    "event": "an event begins with its name: Name:",
    "new": "a record is made by its name: Task(target=p)",
    "print": "a stream prints: Log.stdout << value",
    "echo": "a stream prints: Log.stdout << value",
    "xor": "write '!=' between two conditions",
    "let": "a type stands before the name: int x = 3",
    "var": "a type stands before the name: int x = 3",
    "const": "write 'param Type name = value' for a constant, or a type before the name",
    "auto": "a type stands before the name: int x = 3",
    "async": "each event takes effect at once, when it ends",
    "await": "each event takes effect at once, when it ends",
    "with": "'atomic:' takes the lock that a block needs",
    "global": _GLOBAL,
    "nonlocal": _GLOBAL,
    "del": "write xs.remove(value), xs.pop(i) or m.remove(key)",
    "decreases": "the condition of 'while' shows that a loop ends: leave the line out",
    "assert": "'invariant Name: ...' states what is to hold; an event's guard says when it may run",
}
# Container types of other languages -> container types of Koord.
_HOLDERS = {
    "list": "List", "vector": "List", "array": "List", "dict": "Map", "map": "Map", "hashmap": "Map", "set": "Set",
    "queue": "Queue", "deque": "Queue",
}  # fmt: skip
_FIRST_ONLY = frozenset(
    ("end", "from", "case", "with", "match", "loop", "record", "do", "let", "var", "event", "begin")
)
_TYPES = frozenset(
    ("int", "float", "bool", "string", "Point", "Pose", "Grid", "Scan", "GridMap", "PathPlanner", "stream", "pos")
)
_SECTIONS = frozenset(
    (
        "using", "param", "allread", "allwrite", "local", "def", "fun", "extern", "spec", "axiom", "invariant",
        "initially", "init",
    )
)  # fmt: skip
# Likely wrong names of an event's clauses -> right name.
_PARTS = {
    "effect": "eff", "effects": "eff", "action": "eff", "actions": "eff",
    "precondition": "pre", "preconditions": "pre", "condition": "pre", "guard": "pre", "when": "pre", "requires": "pre",
}  # fmt: skip
_EVENT = "only events stand indented under 'priority:': 'Name:', and under it 'pre:' and 'eff:'"


def _braces(spot: Spot) -> Diagnostic | None:
    """Report a block in braces, as in `if a {`."""
    if spot.kind == "{" and not spot.wants_expression and not spot.bracket:
        return spot.error("a block stands in no braces", "end the header with ':' and indent the block's lines")
    return None


def _else(spot: Spot) -> Diagnostic | None:
    if spot.kind == "if" and spot.before_is("else"):
        return spot.error("expected ':' after 'else'", "write 'elif'")
    if spot.kind in ("else", "elif"):
        if spot.position == spot.start:
            help = "it stands at the depth of the 'if' that it belongs to"
            return spot.error(f"there is no 'if' for this '{spot.kind}'", help)
        if not spot.wants_expression and not spot.bracket:
            return spot.error(f"'{spot.kind}' begins a line of its own")
    if spot.kind == "if" and "pass" in spot.expected and spot.before_is(":"):
        return spot.error("'if' begins a line of its own")
    if spot.kind == "if" and spot.wants_expression and "pass" not in spot.expected:
        return spot.error("expected an expression, found 'if'", "write 'a if condition else b'")
    if spot.kind == "for" and spot.wants_expression and "pass" not in spot.expected and not spot.bracket:
        return spot.error("expected an expression, found 'for'", "write 'forall i in ID: ...'")
    return None


def _functions(spot: Spot) -> Diagnostic | None:
    """Report function headers as in Python."""
    head = [token[0] for token in spot.head]
    if spot.kind == "(" and head[:1] == ["def"]:
        name = shown(spot.head[-1][1])
        return spot.error(
            "'def' defines a record",
            f"a function is written 'fun {name}(Type x) -> Type:'",
            place(spot.head[0], spot.head[-1]),
        )
    if "fun" not in head[:2]:
        return None
    if spot.bracket == "(" and spot.expected <= {"NAME", "[", "<"} and spot.kind in (")", ",", ":", "="):
        name = spot.before[1] if spot.before_is("NAME") and spot.before is not None else "x"
        return spot.error(
            "a parameter has a type before its name", f"write 'int {shown(name)}'", place(spot.head[-1], spot.head[-1])
        )
    if spot.bracket == "(" and spot.kind == "=":
        return spot.error("a parameter has no value of its own")
    if spot.expected == {"->"} or spot.expected == {"->", ":"}:
        return spot.error("a function names the type of its result", "write '-> Type' after ')'")
    if spot.kind == ":" and "->" in spot.expected:
        return spot.error("a function names the type of its result", "write '-> Type' after ')'")
    return None


def _brackets(spot: Spot) -> Diagnostic | None:
    """Report comprehensions, slices with a step, several indices in one bracket, `for (a, b) in ...`."""
    bracket = spot.bracket
    if spot.kind == "for" and bracket:
        name = {"[": "list", "{": "set"}.get(bracket, "list")
        add = "append" if name == "list" else "add"
        return spot.error("Koord has no comprehensions", f"fill a {name} in a loop: for x in xs: ys.{add}(...)")
    if bracket == "[" and spot.kind == ":" and spot.expected & {"]"} and ":" not in spot.expected:
        return spot.error("a slice has no step", "a loop can take steps: for i in range(a, b, 2):")
    if bracket == "[" and spot.kind == "," and "]" in spot.expected:
        return spot.error("expected ']', found ','", "several indices are written x[i][j]")
    if spot.kind == "(" and spot.before_is("for"):
        names = any(token[0] == "in" for token in spot.rest)
        help = "names stand without brackets: for a, b in pairs:" if names else "write 'for i in range(a, b):'"
        return spot.error("expected a name after 'for', found '('", help)
    if spot.kind in ("*", "**") and bracket == "(" and spot.wants_expression:
        return spot.error(f"'{spot.kind}' spreads no values here", "write the arguments one by one")
    return None


def _lists_of_names(spot: Spot) -> Diagnostic | None:
    """Report several targets or declarations at once: `a, b = pair`, `int a, b`."""
    if spot.kind != "," or spot.bracket or spot.first[1] in ("global", "nonlocal", "del"):
        return None
    if spot.expected & {"pre", "eff"} or (spot.level() == 0 and spot.first[0] == "NAME" and spot.start == 0):
        return None
    if "+=" in spot.expected:
        if any(token[0] == "=" for token in spot.rest):
            help = "name the pair and take its items: p[0], p[1]; only 'for a, b in pairs:' takes pairs apart"
            return spot.error("an assignment has one target", help, place(spot.first, spot.rest[-1]))
        return spot.error("expected one expression, found ','", "a tuple stands in brackets: (a, b)")
    if "NEWLINE" not in spot.expected:
        return None
    if "+" not in spot.expected or any(token[0] == "=" for token in spot.rest):
        return spot.error("each name is declared on a line of its own", "write its type and name on the next line")
    return spot.error("expected one value, found ','", "a tuple stands in brackets: (a, b)")


def _types(spot: Spot) -> Diagnostic | None:
    """Report wrong types: `List x`, `int[] x`, `List()`, and names without a type."""
    before = spot.before
    if before is not None and before[0] == "GENERIC" and spot.expected == {"<"}:
        if spot.kind == "(":
            empty = "[]" if before[1] in ("List", "Queue") else "{}"
            return spot.error(f"'{before[1]}' is a type and makes no value", f"an empty one is written {empty}")
        example = "Map<int, Point>" if before[1] == "Map" else f"{before[1]}<Point>"
        return spot.error(f"expected '<' after '{before[1]}'", f"a type says what it holds: {example}")
    if spot.kind == "GENERIC" and spot.wants_expression:
        empty = "[]" if spot.text in ("List", "Queue") else "{}"
        return spot.error(f"'{spot.text}' is a type and no value", f"an empty one is written {empty}")
    if spot.kind == "]" and spot.before_is("[") and len(spot.head) > 1 and spot.wants_expression:
        return spot.error("expected an expression after '[', found ']'", "the type of a list is written List<int>")
    named = before is not None and before[0] == "NAME" and spot.expected <= {"NAME", "["} and "NAME" in spot.expected
    if named and before is not None and (spot.kind == "=" or spot.ends):
        found = "'='" if spot.kind == "=" else "the end of the line"
        example = "Point" if spot.tokens[0][0] == "using" else "int"
        help = "" if before[1] in _TYPES else f"a type stands before the name: {example} {shown(before[1])}"
        return spot.error(f"expected a name after '{shown(before[1])}', found {found}", help)
    if before is not None and "NAME" in spot.expected and spot.kind == "<" and before[0] == "NAME":
        meant = _HOLDERS.get(before[1].lower())
        help = f"did you mean '{meant}'?" if meant else "those that do are List, Map, Set, Queue"
        return spot.error(f"'{shown(before[1])}' holds no other types", help)
    if spot.before_is("[") and spot.expected == {"]"} and len(spot.head) > 1:
        element = shown(spot.head[-2][1])
        if element.lower() in _HOLDERS:
            meant = _HOLDERS[element.lower()]
            help = f"write {meant}<...>, as in {'Map<int, Point>' if meant == 'Map' else f'{meant}<int>'}"
            return spot.error("what a type holds stands between '<' and '>'", help, place(spot.head[-2], spot.head[-1]))
        return spot.error("a size stands behind the name", f"write '{element} x[{shown(spot.text)}]'")
    if spot.kind == "[" and spot.before_is("NAME") and spot.expected == {"=", "NEWLINE"}:
        help = f"a list is declared List<{shown(spot.head[0][1])}> {shown(spot.head[-1][1])}"
        return spot.error("a variable of a block has no size", help)
    behind_port = "NEWLINE" in spot.expected and spot.expected <= {"NEWLINE", "as", "at", "clears", ","}
    if spot.kind == "=" and behind_port and spot.tokens[0][0] == "using":
        return spot.error("a port has no initial value")
    return None


def _annotation(spot: Spot) -> Diagnostic | None:
    """Report a type after the name: `k: int = 3`."""
    name = spot.before
    if spot.kind != ":" or name is None or name[0] != "NAME" or not spot.rest:
        return None
    if name is not spot.first and spot.head[-2][0] != ":":
        return None
    kind, text = spot.rest[0][:2]
    if kind != "GENERIC" and text not in _TYPES and text not in ("str", *_HOLDERS):
        return None
    type_ = f"{text}<...>" if kind == "GENERIC" else text
    return spot.error("a type stands before the name", f"write '{type_} {shown(name[1])}'", place(name, spot.rest[0]))


def _words(spot: Spot) -> Diagnostic | None:
    """Report keywords of other languages."""
    if spot.text == "is" and "==" in spot.expected:
        isnt = spot.next == "not"
        return spot.error("Koord has no 'is'", "'!=' compares" if isnt else "'==' compares")
    if spot.kind == "NEWLINE" and spot.before_is("return"):
        return spot.error("a function returns a value", "write 'return value'; an event ends with its last statement")
    here = spot.tokens[spot.position]
    for token in (spot.first, spot.before, here):
        if token is None or token[0] != "NAME" or token[1].lower() not in FOREIGN:
            continue
        if token is spot.first or token[1] not in _FIRST_ONLY:
            message = f"Koord has no '{token[1]}'"
            return spot.error(message, FOREIGN[token[1].lower()], place(token, token))
    return None


def headers(spot: Spot) -> Diagnostic | None:
    """Report headers with a superfluous or missing name, and statements or variables in the wrong place."""
    if spot.position == 0:
        return _section(spot)
    told = _annotation(spot) or (_priority(spot) if spot.tokens[0][0] == "priority" else None)
    if told is not None:
        return told
    if spot.kind == ":" and spot.start > 0 and spot.first[0] == "invariant":
        return spot.error("a loop invariant has neither name nor ':'", "write 'invariant condition'")
    if spot.kind == ":" and spot.before_is("invariant", "axiom") and spot.before is not None:
        word = spot.before[1]
        return spot.error(f"expected a name after '{word}', found ':'", f"write '{word} Name: ...'")
    if spot.kind == ":" and spot.before_is("assume"):
        return spot.error("expected an expression after 'assume', found ':'", "'assume' has no colon")
    if spot.kind == "NAME" and spot.before_is("initially"):
        return spot.error("expected ':' after 'initially'", "'initially' has no name")
    if spot.kind == ":" and "in" in spot.expected and spot.expected <= {"in", ",", "="}:
        return spot.error("expected 'in' and what the names run over", "write 'forall i in ID: ...'")
    if "pass" in spot.expected and spot.kind in _SECTIONS and spot.next != "=":
        help = f"'{spot.kind}' begins a section: it stands at the left margin"
        return spot.error(f"expected a statement, found '{spot.kind}'", help)
    if "pass" in spot.expected and spot.kind in ("pre", "eff") and spot.next == ":":
        help = f"'{spot.kind}' stands indented once, under the name of its event"
        return spot.error(f"expected a statement, found '{spot.kind}'", help)
    if {"requires", "ensures"} & spot.expected and spot.tokens[0][0] == "extern" and not spot.ends:
        help = "Python implements it; what may stand here is 'requires: ...' and 'ensures: ...'"
        return spot.error("an extern function has no body", help)
    if spot.ends and spot.tokens[0][0] == "param" and spot.expected & {"="} and spot.before_is("NAME"):
        help = "a param has a value: a build or a fleet file may give another"
        return spot.error(f"expected '=' after '{shown(spot.head[-1][1])}', found the end of the line", help)
    if spot.kind == ":" and spot.tokens[0][0] == "spec":
        return spot.error("a spec function has no body", "an axiom says what it means: axiom Name: ...")
    if {"pre", "eff"} & spot.expected and spot.level() <= 1 and spot.kind == "atomic":
        return spot.error("expected 'pre' or 'eff', found 'atomic'", "'atomic:' stands under 'eff:'")
    if {"pre", "eff"} & spot.expected and spot.level() == 1 and spot.kind == "NAME" and spot.next == ":":
        meant = _PARTS.get(spot.text.lower())
        help = f"write '{meant}:'" if meant else "an event begins at the left margin, or indented under 'priority:'"
        return spot.error(f"expected 'pre' or 'eff', found '{shown(spot.text)}'", help)
    if {"pre", "eff"} & spot.expected and spot.level() <= 1 and spot.kind in ("NAME", "GENERIC") and spot.next in (
        "NAME", "=", "<", ".", "[", "+=", "-=", "(",
    ):  # fmt: skip
        help = "statements stand under 'eff:', variables under 'local:', 'allread:' or 'allwrite:'"
        return spot.error(f"expected 'pre' or 'eff', found '{shown(spot.text)}'", help)
    return None


def _priority(spot: Spot) -> Diagnostic | None:
    """Report errors of a `priority:` block: a name in its header, anything but events in it, nesting."""
    found = f"'{shown(spot.text)}'" if spot.text else "the end of the line"
    if spot.level() == 0:
        if spot.kind == "NAME" and ":" in spot.expected:
            return spot.error(f"expected ':' after 'priority', found {found}", "'priority' has no name")
        if spot.expected == {"NEWLINE"}:
            return spot.error(f"expected the end of the line after 'priority:', found {found}", _EVENT)
        return None
    if spot.level() == 1 and spot.position == spot.start and "NAME" in spot.expected:
        help = f"'{spot.kind}' begins a section: it stands at the left margin" if spot.kind in _SECTIONS else _EVENT
        return spot.error(f"expected the name of an event, found {found}", help)
    if spot.level() == 1 and spot.expected == {":"} and spot.kind != "NEWLINE":
        return spot.error(f"expected ':' after '{shown(spot.first[1])}', found {found}", _EVENT)
    if {"pre", "eff"} & spot.expected and spot.first[0] == "NAME" and spot.next == ":":
        inside = [token[1] for token in spot.tokens[: spot.start] if token[0] not in ("NEWLINE", "INDENT", ":")][-1:]
        help = "'priority:' stands in no other block: it begins at the left margin" if inside == ["priority"] else ""
        return spot.error(f"expected 'pre' or 'eff', found {found}", help)
    return None


def _section(spot: Spot) -> Diagnostic:
    help = (
        "sections: using, param, local, allread, allwrite, def, fun, init, invariant, ..., priority, and events, Name:"
    )
    if spot.kind in ("pre", "eff"):
        help = f"'{spot.kind}' stands indented under the name of its event"
    elif spot.kind in ("sensors", "actuators", "assume"):
        help = f"'{spot.kind}' stands indented under 'using Module:'"
    elif spot.kind in ("if", "for", "while", "atomic", "return", "break", "continue", "pass", "stop"):
        help = "a statement stands indented under 'init:' or an event's 'eff:'"
    elif spot.kind in ("GENERIC", "("):
        help = "a variable is declared under 'local:', 'allread:' or 'allwrite:'"
    return spot.error(f"expected a section, found '{shown(spot.text)}'", help)


# Tried in this order; the first diagnostic is reported.
HABITS: tuple[Callable[[Spot], Diagnostic | None], ...] = (
    _braces,
    _else,
    _functions,
    _brackets,
    _lists_of_names,
    _words,
    _types,
)

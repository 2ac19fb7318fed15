"""Errors for syntax of other languages, with the form that Koord has. marks.py has operators."""

from __future__ import annotations

from collections.abc import Callable

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.syntax.error_site import ErrorSite, place, shown

_EXCEPTIONS = "Koord has no exceptions: a fault discards the event and the robot holds; test before you divide or index"
_GLOBAL = "every variable that is declared under local, allread or allwrite is visible everywhere: remove the line"
_WHILE = "write 'while condition:'"
_CASES = "write a chain of if, elif, else"
_RECORD = "define a record by 'def Name:', with its fields below: Type field"
_FUNCTION = "write a function as 'fun name(Type x) -> Type:'"
# Keyword of another language, at or after which parsing fails -> help.
FOREIGN = {
    "import": "declare a function written in Python: extern fun name(Type x) -> Type",
    "from": "declare a function written in Python: extern fun name(Type x) -> Type",
    "include": "declare a function written in Python: extern fun name(Type x) -> Type",
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
    "end": "a block ends where the indentation decreases",
    "endif": "a block ends where the indentation decreases",
    "begin": "a block begins with ':' and indented lines",
    "event": "an event begins with its name: Name:",
    "new": "make a record by its name: Task(target=p)",
    "print": "write to a stream: Log.stdout << value",
    "echo": "write to a stream: Log.stdout << value",
    "xor": "write '!=' between two conditions",
    "let": "the type must come before the name: int x = 3",
    "var": "the type must come before the name: int x = 3",
    "const": "write 'param Type name = value' for a constant, or a type before the name",
    "auto": "the type must come before the name: int x = 3",
    "async": "each event takes effect at once, when it ends",
    "await": "each event takes effect at once, when it ends",
    "with": "'atomic:' takes the lock that a block needs",
    "global": _GLOBAL,
    "nonlocal": _GLOBAL,
    "del": "write xs.remove(value), xs.pop(i) or m.remove(key)",
    "decreases": "the condition of 'while' shows that a loop ends: remove the line",
    "assert": "'invariant Name: ...' states what must hold; an event's guard says when it may run",
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
_EVENT = "only events are allowed under 'priority:': 'Name:', with 'pre:' and 'eff:' under it"


def _braces(site: ErrorSite) -> Diagnostic | None:
    """Report a block in braces, as in `if a {`."""
    if site.kind == "{" and not site.wants_expression and not site.bracket:
        return site.error("blocks have no braces", "end the header with ':' and indent the block's lines")
    return None


def _else(site: ErrorSite) -> Diagnostic | None:
    if site.kind == "if" and site.before_is("else"):
        return site.error("expected ':' after 'else'", "write 'elif'")
    if site.kind in ("else", "elif"):
        if site.position == site.start:
            help = "indent it like the 'if' that it belongs to"
            return site.error(f"there is no 'if' for this '{site.kind}'", help)
        if not site.wants_expression and not site.bracket:
            return site.error(f"'{site.kind}' must begin a line")
    if site.kind == "if" and "pass" in site.expected and site.before_is(":"):
        return site.error("'if' must begin a line")
    if site.kind == "if" and site.wants_expression and "pass" not in site.expected:
        return site.error("expected an expression, found 'if'", "write 'a if condition else b'")
    if site.kind == "for" and site.wants_expression and "pass" not in site.expected and not site.bracket:
        return site.error("expected an expression, found 'for'", "write 'forall i in ID: ...'")
    return None


def _functions(site: ErrorSite) -> Diagnostic | None:
    """Report function headers as in Python."""
    head = [token[0] for token in site.head]
    if site.kind == "(" and head[:1] == ["def"]:
        name = shown(site.head[-1][1])
        return site.error(
            "'def' defines a record",
            f"write a function as 'fun {name}(Type x) -> Type:'",
            place(site.head[0], site.head[-1]),
        )
    if "fun" not in head[:2]:
        return None
    if site.bracket == "(" and site.expected <= {"NAME", "[", "<"} and site.kind in (")", ",", ":", "="):
        name = site.before[1] if site.before_is("NAME") and site.before is not None else "x"
        return site.error(
            "a parameter needs a type before its name",
            f"write 'int {shown(name)}'",
            place(site.head[-1], site.head[-1]),
        )
    if site.bracket == "(" and site.kind == "=":
        return site.error("a parameter cannot have a default value")
    if site.expected == {"->"} or site.expected == {"->", ":"}:
        return site.error("a function must declare the type of its result", "write '-> Type' after ')'")
    if site.kind == ":" and "->" in site.expected:
        return site.error("a function must declare the type of its result", "write '-> Type' after ')'")
    return None


def _brackets(site: ErrorSite) -> Diagnostic | None:
    """Report comprehensions, slices with a step, several indices in one bracket, `for (a, b) in ...`."""
    bracket = site.bracket
    if site.kind == "for" and bracket:
        name = {"[": "list", "{": "set"}.get(bracket, "list")
        add = "append" if name == "list" else "add"
        return site.error("Koord has no comprehensions", f"fill a {name} in a loop: for x in xs: ys.{add}(...)")
    if bracket == "[" and site.kind == ":" and site.expected & {"]"} and ":" not in site.expected:
        return site.error("a slice has no step", "use a loop with a step: for i in range(a, b, 2):")
    if bracket == "[" and site.kind == "," and "]" in site.expected:
        return site.error("expected ']', found ','", "write several indices as x[i][j]")
    if site.kind == "(" and site.before_is("for"):
        names = any(token[0] == "in" for token in site.following)
        help = "write the names without brackets: for a, b in pairs:" if names else "write 'for i in range(a, b):'"
        return site.error("expected a name after 'for', found '('", help)
    if site.kind in ("*", "**") and bracket == "(" and site.wants_expression:
        return site.error(f"'{site.kind}' cannot spread values here", "write the arguments one by one")
    return None


def _lists_of_names(site: ErrorSite) -> Diagnostic | None:
    """Report several targets or declarations at once: `a, b = pair`, `int a, b`."""
    if site.kind != "," or site.bracket or site.first[1] in ("global", "nonlocal", "del"):
        return None
    if site.expected & {"pre", "eff"} or (site.level() == 0 and site.first[0] == "NAME" and site.start == 0):
        return None
    if "+=" in site.expected:
        if any(token[0] == "=" for token in site.following):
            help = (
                "assign the pair to a variable and read its items p[0], p[1]; only 'for a, b in pairs:' unpacks pairs"
            )
            return site.error("an assignment has one target", help, place(site.first, site.following[-1]))
        return site.error("expected one expression, found ','", "write a tuple in brackets: (a, b)")
    if "NEWLINE" not in site.expected:
        return None
    if "+" not in site.expected or any(token[0] == "=" for token in site.following):
        return site.error("declare each name on its own line", "write its type and name on the next line")
    return site.error("expected one value, found ','", "write a tuple in brackets: (a, b)")


def _types(site: ErrorSite) -> Diagnostic | None:
    """Report wrong types: `List x`, `int[] x`, `List()`, and names without a type."""
    before = site.before
    if before is not None and before[0] == "GENERIC" and site.expected == {"<"}:
        if site.kind == "(":
            empty = "[]" if before[1] in ("List", "Queue") else "{}"
            return site.error(f"'{before[1]}' is a type, not a function", f"write an empty one as {empty}")
        example = "Map<int, Point>" if before[1] == "Map" else f"{before[1]}<Point>"
        return site.error(f"expected '<' after '{before[1]}'", f"give the types of its contents: {example}")
    if site.kind == "GENERIC" and site.wants_expression:
        empty = "[]" if site.text in ("List", "Queue") else "{}"
        return site.error(f"'{site.text}' is a type, not a value", f"write an empty one as {empty}")
    if site.kind == "]" and site.before_is("[") and len(site.head) > 1 and site.wants_expression:
        return site.error("expected an expression after '[', found ']'", "write the type of a list as List<int>")
    named = before is not None and before[0] == "NAME" and site.expected <= {"NAME", "["} and "NAME" in site.expected
    if named and before is not None and (site.kind == "=" or site.ends):
        found = "'='" if site.kind == "=" else "the end of the line"
        example = "Point" if site.tokens[0][0] == "using" else "int"
        help = "" if before[1] in _TYPES else f"the type must come before the name: {example} {shown(before[1])}"
        return site.error(f"expected a name after '{shown(before[1])}', found {found}", help)
    if before is not None and "NAME" in site.expected and site.kind == "<" and before[0] == "NAME":
        meant = _HOLDERS.get(before[1].lower())
        help = f"did you mean '{meant}'?" if meant else "the types with '<...>' are List, Map, Set and Queue"
        return site.error(f"'{shown(before[1])}' takes no types in '<...>'", help)
    if site.before_is("[") and site.expected == {"]"} and len(site.head) > 1:
        element = shown(site.head[-2][1])
        if element.lower() in _HOLDERS:
            meant = _HOLDERS[element.lower()]
            help = f"write {meant}<...>, as in {'Map<int, Point>' if meant == 'Map' else f'{meant}<int>'}"
            return site.error(
                "the types of the contents must be between '<' and '>'", help, place(site.head[-2], site.head[-1])
            )
        return site.error("the size must come after the name", f"write '{element} x[{shown(site.text)}]'")
    if site.kind == "[" and site.before_is("NAME") and site.expected == {"=", "NEWLINE"}:
        help = f"declare a list as List<{shown(site.head[0][1])}> {shown(site.head[-1][1])}"
        return site.error("a variable of a block has no size", help)
    behind_port = "NEWLINE" in site.expected and site.expected <= {"NEWLINE", "as", "at", "clears", ","}
    if site.kind == "=" and behind_port and site.tokens[0][0] == "using":
        return site.error("a port has no initial value")
    return None


def _annotation(site: ErrorSite) -> Diagnostic | None:
    """Report a type after the name: `k: int = 3`."""
    name = site.before
    if site.kind != ":" or name is None or name[0] != "NAME" or not site.following:
        return None
    if name is not site.first and site.head[-2][0] != ":":
        return None
    kind, text = site.following[0][:2]
    if kind != "GENERIC" and text not in _TYPES and text not in ("str", *_HOLDERS):
        return None
    type_ = f"{text}<...>" if kind == "GENERIC" else text
    return site.error(
        "the type must come before the name", f"write '{type_} {shown(name[1])}'", place(name, site.following[0])
    )


def _words(site: ErrorSite) -> Diagnostic | None:
    """Report keywords of other languages."""
    if site.text == "is" and "==" in site.expected:
        isnt = site.next == "not"
        return site.error("Koord has no 'is'", "'!=' compares" if isnt else "'==' compares")
    if site.kind == "NEWLINE" and site.before_is("return"):
        return site.error("a function returns a value", "write 'return value'; an event ends with its last statement")
    here = site.tokens[site.position]
    for token in (site.first, site.before, here):
        if token is None or token[0] != "NAME" or token[1].lower() not in FOREIGN:
            continue
        if token is site.first or token[1] not in _FIRST_ONLY:
            message = f"Koord has no '{token[1]}'"
            return site.error(message, FOREIGN[token[1].lower()], place(token, token))
    return None


def headers(site: ErrorSite) -> Diagnostic | None:
    """Report headers with a superfluous or missing name, and statements or variables in the wrong place."""
    if site.position == 0:
        return _section(site)
    diagnostic = _annotation(site) or (_priority(site) if site.tokens[0][0] == "priority" else None)
    diagnostic = diagnostic or (_interface(site) if site.tokens[0][0] in ("export", "import") else None)
    if diagnostic is not None:
        return diagnostic
    if site.kind == ":" and site.start > 0 and site.first[0] == "invariant":
        return site.error("a loop invariant has neither name nor ':'", "write 'invariant condition'")
    if site.kind == ":" and site.before_is("invariant", "axiom") and site.before is not None:
        word = site.before[1]
        return site.error(f"expected a name after '{word}', found ':'", f"write '{word} Name: ...'")
    if site.kind == ":" and site.before_is("assume"):
        return site.error("expected an expression after 'assume', found ':'", "'assume' has no colon")
    if site.kind == "NAME" and site.before_is("initially"):
        return site.error("expected ':' after 'initially'", "'initially' has no name")
    if site.kind == ":" and "in" in site.expected and site.expected <= {"in", ",", "="}:
        return site.error("expected 'in' and a domain for the names", "write 'forall i in ID: ...'")
    if "pass" in site.expected and site.kind in _SECTIONS and site.next != "=":
        help = f"'{site.kind}' begins a section: write it at the left margin"
        return site.error(f"expected a statement, found '{site.kind}'", help)
    if "pass" in site.expected and site.kind in ("pre", "eff") and site.next == ":":
        help = f"'{site.kind}' must be indented once, under the name of its event"
        return site.error(f"expected a statement, found '{site.kind}'", help)
    if {"requires", "ensures"} & site.expected and site.tokens[0][0] == "extern" and not site.ends:
        help = "it is implemented in Python; only 'requires: ...' and 'ensures: ...' are allowed here"
        return site.error("an extern function has no body", help)
    if site.ends and site.tokens[0][0] == "param" and site.expected & {"="} and site.before_is("NAME"):
        help = "a param needs a default value, which a build or a fleet file may replace"
        return site.error(f"expected '=' after '{shown(site.head[-1][1])}', found the end of the line", help)
    if site.kind == ":" and site.tokens[0][0] == "spec":
        return site.error("a spec function has no body", "describe it by an axiom: axiom Name: ...")
    if {"pre", "eff"} & site.expected and site.level() <= 1 and site.kind == "atomic":
        return site.error("expected 'pre' or 'eff', found 'atomic'", "write 'atomic:' under 'eff:'")
    if {"pre", "eff"} & site.expected and site.level() == 1 and site.kind == "NAME" and site.next == ":":
        meant = _PARTS.get(site.text.lower())
        help = f"write '{meant}:'" if meant else "an event begins at the left margin, or indented under 'priority:'"
        return site.error(f"expected 'pre' or 'eff', found '{shown(site.text)}'", help)
    if {"pre", "eff"} & site.expected and site.level() <= 1 and site.kind in ("NAME", "GENERIC") and site.next in (
        "NAME", "=", "<", ".", "[", "+=", "-=", "(",
    ):  # fmt: skip
        help = "write statements under 'eff:', variables under 'local:', 'allread:' or 'allwrite:'"
        return site.error(f"expected 'pre' or 'eff', found '{shown(site.text)}'", help)
    return None


def _priority(site: ErrorSite) -> Diagnostic | None:
    """Report errors of a `priority:` block: a name in its header, anything but events in it, nesting."""
    found = f"'{shown(site.text)}'" if site.text else "the end of the line"
    if site.level() == 0:
        if site.kind == "NAME" and ":" in site.expected:
            return site.error(f"expected ':' after 'priority', found {found}", "'priority' has no name")
        if site.expected == {"NEWLINE"}:
            return site.error(f"expected the end of the line after 'priority:', found {found}", _EVENT)
        return None
    if site.level() == 1 and site.position == site.start and "NAME" in site.expected:
        help = f"'{site.kind}' begins a section: write it at the left margin" if site.kind in _SECTIONS else _EVENT
        return site.error(f"expected the name of an event, found {found}", help)
    if site.level() == 1 and site.expected == {":"} and site.kind != "NEWLINE":
        return site.error(f"expected ':' after '{shown(site.first[1])}', found {found}", _EVENT)
    if {"pre", "eff"} & site.expected and site.first[0] == "NAME" and site.next == ":":
        inside = [token[1] for token in site.tokens[: site.start] if token[0] not in ("NEWLINE", "INDENT", ":")][-1:]
        help = (
            "'priority:' cannot be inside of another block: write it at the left margin"
            if inside == ["priority"]
            else ""
        )
        return site.error(f"expected 'pre' or 'eff', found {found}", help)
    return None


def _interface(site: ErrorSite) -> Diagnostic | None:
    """Report errors in `export:` and `import Name:`, among them the `import` of Python."""
    found = f"'{shown(site.text)}'" if site.text and not site.ends else "the end of the line"
    if site.tokens[0][0] == "import" and site.level() == 0 and (site.ends or site.kind != ":"):
        help = (
            "'import Name:' takes variables of another application; a function written in Python is declared: "
            "extern fun name(Type x) -> Type"
        )
        if site.expected == {":"}:
            return site.error(f"expected ':' after 'import {shown(site.head[-1][1])}', found {found}", help)
    if site.kind == ":" and site.before_is("import"):
        return site.error("expected a name after 'import', found ':'", "write 'import Name:'")
    if site.kind == "NAME" and site.before_is("export"):
        help = "'export:' has no name: the fleet file gives the application its name"
        return site.error(f"expected ':' after 'export', found {found}", help)
    if site.kind == "=" and site.level() == 1:
        where = (
            "the exporter's declaration"
            if site.tokens[0][0] == "import"
            else "its declaration under 'allwrite:' or 'allread:'"
        )
        return site.error("expected the end of the line, found '='", f"the initial value is that of {where}")
    if site.kind == ":" and site.before_is("guarantee"):
        return site.error("expected a name after 'guarantee', found ':'", "write 'guarantee Name: ...'")
    if site.kind == "max" and site.tokens[0][0] == "export":
        return site.error("expected the end of the line, found 'max'", "the capacity is that of the declaration")
    return None


def _section(site: ErrorSite) -> Diagnostic:
    help = (
        "a section begins with 'using', 'param', 'local', 'allread', 'allwrite', 'def', 'fun', 'init', 'invariant', "
        "..., 'priority', 'export', 'import', 'provides' or, for an event, with its name: 'Name:'"
    )
    if site.kind in ("pre", "eff"):
        help = f"'{site.kind}' must be indented under the name of its event"
    elif site.kind in ("sensors", "actuators", "assume"):
        help = f"'{site.kind}' must be indented under 'using Module:'"
    elif site.kind in ("if", "for", "while", "atomic", "return", "break", "continue", "pass", "stop"):
        help = "indent a statement under 'init:' or an event's 'eff:'"
    elif site.kind in ("GENERIC", "("):
        help = "a variable is declared under 'local:', 'allread:' or 'allwrite:'"
    return site.error(f"expected a section, found '{shown(site.text)}'", help)


# Tried in this order; the first diagnostic is reported.
HABITS: tuple[Callable[[ErrorSite], Diagnostic | None], ...] = (
    _braces,
    _else,
    _functions,
    _brackets,
    _lists_of_names,
    _words,
    _types,
)

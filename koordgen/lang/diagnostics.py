"""Diagnostics of the compiler: their data, their catalogue, and their rendering as text and as JSON.

Only the command line prints. A user's mistake is a Diagnostic; a bug of the compiler is an InternalError.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from koordgen.lang.node import Node
from koordgen.lang.source import Source, Span

Severity = Literal["error", "warning", "note"]

# Code -> title. K: the program. F: files, in particular the fleet file. B: building for a target. A code's meaning
# never changes; a retired code is never used again.
CATALOGUE: dict[str, str] = {
    "K001": "something else is expected here",
    "K002": "unexpected character",
    "K004": "tab in indentation",
    "K005": "indentation matches no enclosing block",
    "K006": "unpaired bracket",
    "K007": "nested too deeply",
    "K008": "unexpected or missing indentation",
    "K009": "number too large",
    "K010": "undefined name",
    "K011": "name declared twice",
    "K012": "types do not agree",
    "K013": "a condition must be a bool",
    "K014": "wrong number of arguments",
    "K015": "no such field",
    "K016": "unknown type",
    "K017": "a name is used as another kind of thing",
    "K018": "port not declared",
    "K019": "an event or a program lacks a part",
    "K020": "write to a sensor",
    "K021": "write to another robot's slot",
    "K022": "cannot be assigned",
    "K023": "read of shared state in init",
    "K024": "statement without effect",
    "K025": "initial value is not constant",
    "K026": "a function calls itself",
    "K027": "a statement or an effect is not allowed here",
    "K028": "'break' or 'continue' outside of a loop, or 'return' outside of a function",
    "K029": "a function can end without a result",
    "K030": "index names no robot",
    "K031": "index may name no robot",
    "K032": "division by zero",
    "K033": "divisor may be zero",
    "K034": "index may be out of range",
    "K035": "a loop that is not proved to end",
    "K036": "index counts from the end",
    "K040": "update may be lost",
    "K041": "event can never run",
    "K042": "event is hidden by an earlier one",
    "K043": "statement can never run",
    "K044": "plain write to a variable of atomic events",
    "K045": "'atomic' is not allowed here",
    "K046": "a priority block with a single event",
    "K050": "a spelling of the 2020 dialect",
    "K051": "the type of an empty value is unknown",
    "K052": "wrong type of a key",
    "K053": "wrong capacity",
    "K054": "a name or a mark is not allowed in a property",
    "K055": "a type contains itself",
    "K056": "wrong use of a stream",
    "K057": "a constant value does not exist, or cannot be stored",
    "K058": "a loop invariant or 'old' is not allowed here",
    "K059": "the meaning of a port does not fit",
    "K060": "wrong use of an exported or imported variable",
    "K061": "wrong port of a provided module",
    "F001": "not valid YAML",
    "F002": "unknown key",
    "F003": "missing key",
    "F004": "wrong type of value",
    "F005": "value out of range, or in the wrong form",
    "F006": "given twice: a key, a robot's name, an address",
    "F007": "unknown target",
    "F100": "a file cannot be read",
    "F101": "a file is not UTF-8",
    "B001": "the target has no such module",
    "B002": "the target has no such port",
    "B003": "the target's port has another type",
    "B004": "shared variables are too large to be sent",
    "B005": "a driver cannot serve the module",
    "B006": "the functions file lacks a required function or class",
    "B007": "calls of ports may take too long for a round",
    "B008": "the writes of all robots in a round exceed what the link carries",
    "B009": "an event's writes may need several datagrams",
    "B010": "the target's port has another meaning",
    "B011": "a program with imports or guarantees does not run alone",
    "B012": "an import does not fit what the other application exports",
    "B013": "two applications use one robot in ways that do not fit",
    "B014": "a fleet does not provide what the program uses of it as one robot",
}


class InternalError(Exception):
    """A bug of the compiler, whatever the user wrote."""


class Label(Node):
    """Secondary span of a diagnostic, with a text about it."""

    span: Span
    text: str


class Edit(Node):
    """Proposed edit: replace the text at `span` by `text`. An empty span is a position to insert at."""

    span: Span
    text: str


class Diagnostic(Node):
    """Diagnostic: an error, a warning or a note about a program.

    `message` is readable without the source line; `help` says what to write instead. `edits`, applied together, repair
    or modernise the program; they do not overlap.
    """

    code: str
    severity: Severity
    message: str
    span: Span
    labels: tuple[Label, ...] = ()
    help: str = ""
    edits: tuple[Edit, ...] = ()


def in_order(found: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Return diagnostics in the order of the text, each once.

    Compares positions, which equality of nodes ignores.
    """
    once = {(d.span.line, d.span.column, d.code, d.message): d for d in found}
    return [once[key] for key in sorted(once)]


def together(unread: Iterable[Diagnostic], found: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Merge the diagnostics of the parser and the checker, in the order of the text.

    In a line with a syntax error, diagnostics of the checker are consequences and are left out.
    """
    unread = list(unread)
    lines = {d.span.line for d in unread}
    return in_order([*unread, *(d for d in found if d.span.line not in lines)])


def render(diagnostic: Diagnostic, source: Source) -> str:
    """Return a diagnostic as text: headline, source line with carets, labels, help.

    No line end after the last line.
    """
    d = diagnostic
    lines = [f"{source.path}:{d.span.line}:{d.span.column}: {d.severity}[{d.code}]: {d.message}"]
    width = len(str(max([d.span.line, *(label.span.line for label in d.labels)])))
    lines += _excerpt(d.span, "^", "", source, width)
    for label in d.labels:
        lines += _excerpt(label.span, "-", label.text, source, width)
    if d.help:
        lines += [f"{' ' * width} = help: {d.help}"]
    return "\n".join(lines)


def _excerpt(span: Span, mark: str, text: str, source: Source, width: int) -> list[str]:
    line = source.line(span.line)
    shown = "".join(c if c.isprintable() else " " if c == "\t" else "\N{REPLACEMENT CHARACTER}" for c in line)
    if not shown.strip():
        return []
    end = span.end_column if span.end_line == span.line else len(shown) + 1
    marks = " " * (span.column - 1) + mark * max(1, min(end, len(shown) + 1) - span.column)
    if len(shown) > 160:  # show a part of a long line around the error
        cut = max(0, span.column - 60)
        shown, marks = shown[cut : cut + 160], marks[cut : cut + 160]
    return [f"{span.line:>{width}} | {shown}", f"{' ' * width} | {marks} {text}".rstrip()]


def to_json(found: Iterable[tuple[Source, Diagnostic]]) -> str:
    """Return diagnostics as JSON.

    The form is `{"diagnostics": [{code, severity, message, file, line, column, end_line, end_column, help}]}`. One with
    proposed edits also has `edits`: `[{line, column, end_line, end_column, text}]`.
    """
    import json

    return json.dumps({"diagnostics": [as_data(source, d) for source, d in found]}, indent=2)


def as_data(source: Source, diagnostic: Diagnostic) -> dict[str, object]:
    """Return a diagnostic as data for JSON."""
    d = diagnostic
    data: dict[str, object] = {
        "code": d.code,
        "severity": d.severity,
        "message": d.message,
        "file": source.path,
        **_place(d.span),
        "help": d.help,
    }
    if d.edits:
        data["edits"] = [{**_place(edit.span), "text": edit.text} for edit in d.edits]
    return data


def _place(span: Span) -> dict[str, int]:
    return {"line": span.line, "column": span.column, "end_line": span.end_line, "end_column": span.end_column}

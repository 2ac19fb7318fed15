"""SMT-LIB 2.6 text of obligations: scripts for solvers, and annotated files for people.

Numbers are never rounded: a fraction without a finite decimal becomes a quotient of two decimals. A long subterm that
occurs more than once is defined once, and each occurrence refers to it by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from fractions import Fraction

from koordgen.verify.prove.smt.obligation import LabelledFormula, Obligation
from koordgen.verify.prove.smt.term import Apply, FunctionSymbol, LiteralTerm, Op, Term, not_

Line = Callable[[str, int], str]  # (file, line) -> text of the line; "" if the file has no such line
BUILT_IN = frozenset(("Bool", "Int", "Real"))
LONG = 60  # fewest characters of a repeated subterm that gets a name
WIDTH = 100
_SIMPLE = re.compile(r"[A-Za-z~!$%^&*_+=<>?/-][A-Za-z0-9~!$%^&*_+=<>.?/@-]*")
# Reserved words of SMT-LIB, which are valid names only between bars. Names that SMT-LIB's logics define need no entry,
# because encode/context.py never creates a symbol with such a name.
_RESERVED = frozenset(("!", "_", "as", "let", "exists", "forall", "match", "par", "assert", "push", "pop", "exit"))


def symbol(name: str) -> str:
    """Return a name in SMT-LIB's notation: between bars if necessary."""
    return name if _SIMPLE.fullmatch(name) and name not in _RESERVED else f"|{name}|"


def literal(value: bool | int | Fraction, sort: str) -> str:
    """Return a number or truth value as SMT-LIB text, without rounding."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value < 0:
        return f"(- {literal(-value, sort)})"
    if sort == "Int":
        return str(int(value))
    exact = Fraction(value)
    return decimal(exact) or f"(/ {exact.numerator}.0 {exact.denominator}.0)"


def decimal(value: Fraction) -> str:
    """Return a number >= 0 as a decimal; empty if the number has no finite decimal."""
    places, rest = 0, value.denominator
    for prime in (2, 5):
        count = 0
        while rest % prime == 0:
            rest, count = rest // prime, count + 1
        places = max(places, count)
    if rest != 1:
        return ""
    digits = str(value.numerator * 10**places // value.denominator).rjust(places + 1, "0")
    return f"{digits[: len(digits) - places]}.{digits[len(digits) - places :] or '0'}"


class Printer:
    """Printer of the terms of one script.

    The printer first counts the uses of each subterm. Then it prints each subterm once."""

    def __init__(self, terms: Iterable[Term]) -> None:
        self.uses: dict[Term, int] = {}
        self.functions: dict[str, FunctionSymbol] = {}
        self.heads: dict[str, str] = {}
        self.done: dict[Term, str] = {}
        self.named = 0
        uses, pending = self.uses, list(terms)[::-1]
        while pending:
            node = pending.pop()
            if node in uses:
                uses[node] += 1
                continue
            uses[node] = 1
            if isinstance(node, LiteralTerm):
                continue
            if isinstance(node, Apply):
                self.functions.setdefault(node.function.name, node.function)
            pending += node.args[::-1]

    def print(self, term: Term) -> tuple[list[str], str]:
        """Return the definitions that a term's text refers to, and the text."""
        definitions: list[str] = []
        done, pending = self.done, [term]
        while pending:
            node = pending[-1]
            if node in done:
                pending.pop()
                continue
            missing = [] if isinstance(node, LiteralTerm) else [arg for arg in node.args if arg not in done]
            if missing:
                pending += missing[::-1]
                continue
            text = self.shown(node)
            if len(text) > LONG and self.uses.get(node, 0) > 1:
                name = self.fresh()
                definitions.append(f"(define-fun {name} () {symbol(node.sort.name)} {text})")
                text = name
            done[node] = text
        return definitions, done[term]

    def fresh(self) -> str:
        while True:
            self.named += 1
            name = f"part!{self.named}"
            if name not in self.functions:
                return name

    def shown(self, node: Term) -> str:
        """Return the text of a term whose arguments have been printed."""
        if isinstance(node, LiteralTerm):
            return literal(node.value, node.sort.name)
        if isinstance(node, Op):
            return f"({node.name} {' '.join([self.done[arg] for arg in node.args])})"
        name = node.function.name
        head = self.heads.get(name) or self.heads.setdefault(name, symbol(name))
        return f"({head} {' '.join([self.done[arg] for arg in node.args])})" if node.args else head

    def declarations(self) -> Iterator[str]:
        """Yield one declaration for each sort and each symbol."""
        functions = self.functions.values()
        sorts = dict.fromkeys(s for f in functions for s in (*f.domain, f.result) if s.name not in BUILT_IN)
        yield from (f"(declare-sort {symbol(sort.name)} 0)" for sort in sorts)
        for function in functions:
            domain = " ".join(symbol(s.name) for s in function.domain)
            yield f"(declare-fun {symbol(function.name)} ({domain}) {symbol(function.result.name)})"


def script(obligation: Obligation, wanted: Iterable[Term] = (), named: bool = False) -> tuple[str, list[str]]:
    """Return the script of an obligation, and the texts of the `wanted` terms.

    The caller asks the solver for the values of the `wanted` terms. The script has no `set-logic` and no `check-sat`
    command. If `named`, the facts get the names fact!0, fact!1, ... for unsat cores."""
    facts = [f.term for f in obligation.facts]
    if obligation.goal is not None:
        facts.append(not_(obligation.goal.term))
    values = list(wanted)
    printer = Printer([*facts, *values])
    lines = list(printer.declarations())
    for number, fact in enumerate(facts):
        definitions, text = printer.print(fact)
        lines += definitions
        lines.append(f"(assert (! {text} :named fact!{number}))" if named else f"(assert {text})")
    shown = []
    for term in values:
        definitions, text = printer.print(term)
        lines += definitions
        shown.append(text)
    return "\n".join(lines) + "\n", shown


def together(group: Sequence[Obligation], parts: Sequence[Sequence[Term]]) -> tuple[str, list[list[str]]]:
    """Print obligations that share facts.

    Returns one script with the facts that all obligations assume, and further scripts for each obligation: one script
    per part of the obligation's goal. A further script asserts its part and the facts that only its obligation
    assumes."""
    shared = set.intersection(*({id(fact) for fact in o.facts} for o in group))
    own = [[fact.term for fact in o.facts if id(fact) not in shared] for o in group]
    common = [fact.term for fact in group[0].facts if id(fact) in shared]
    printer = Printer([*common, *(term for terms in (*own, *parts) for term in terms)])
    lines = list(printer.declarations())

    def asserted(term: Term) -> str:
        definitions, text = printer.print(term)
        lines.extend(definitions)
        return f"(assert {text})\n"

    lines += [asserted(term) for term in common]
    goals = []
    for terms, each in zip(own, parts, strict=True):
        assumed = "".join(map(asserted, terms))
        goals.append([assumed + asserted(part) for part in each])
    return "\n".join(lines) + "\n", goals


def document(obligation: Obligation, line: Line) -> str:
    """Return an obligation as an annotated file, for people and for every solver.

    `line`: returns the text of a line of the program."""
    goal = obligation.goal
    refuted = [*obligation.facts, *([goal] if goal else [])]
    printer = Printer([*(f.term for f in obligation.facts), *([not_(goal.term)] if goal else [])])
    lines = [*_head(obligation), "(set-info :smt-lib-version 2.6)", f"(set-logic {obligation.logic})"]
    lines += [f"(set-info :status {obligation.expected})", ""]
    lines += [*_cells(obligation, printer.functions), *printer.declarations()]
    last = ""
    for fact in refuted:
        said = f"{fact.label}{_place(fact, line)}"
        if said != last or fact is goal:
            lines += ["", *_comment(f"{'to be shown, therefore negated: ' if fact is goal else ''}{said}")]
            last = said
        definitions, text = printer.print(not_(fact.term) if fact is goal else fact.term)
        lines += [wrapped(d) for d in definitions]
        lines.append(wrapped(f"(assert {text})"))
    return "\n".join([*lines, "", "(check-sat)", "(exit)"]) + "\n"


def _head(obligation: Obligation) -> Iterator[str]:
    if obligation.goal is None:
        yield f"; {obligation.file}:{obligation.line}: the assumptions do not contradict one another"
    else:
        by = f", {obligation.event}" if obligation.event else ""
        yield f"; {obligation.file}:{obligation.line}: {obligation.invariant}{by} ({obligation.kind})"
    robots = "for every number of robots" if obligation.robots is None else f"for {obligation.robots} robots"
    yield f"; {robots}; the expected answer is {obligation.expected}"
    for note in obligation.notes:
        yield from _comment(note)


def _cells(obligation: Obligation, used: Collection[str]) -> Iterator[str]:
    """Yield comments that relate the printed symbols to variables of the program."""
    told: dict[str, None] = {}
    for cell in obligation.cells:
        names = dict.fromkeys(t.function.name for t in cell.terms if isinstance(t, Apply) and t.function.name in used)
        if names:
            told[f"{', '.join(map(symbol, names))}: {cell.name} {cell.state_name}"] = None
    for text in told:
        yield from _comment(text)


def _place(fact: LabelledFormula, line: Line) -> str:
    if not fact.line:
        return ""
    text = _flat(line(fact.file, fact.line))
    return f" ({fact.file}:{fact.line}{': ' if text else ''}{text})"


def _comment(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(_flat(text), WIDTH, initial_indent="; ", subsequent_indent=";   ", break_on_hyphens=False)


def _flat(text: str) -> str:
    return " ".join(text.split())


def wrapped(text: str) -> str:
    """Break a long command into several lines.

    An argument that does not fit gets a separate line with more indentation."""
    return "\n".join(_wrapped(text, 0))


def _wrapped(text: str, indent: int) -> Iterator[str]:
    if len(text) + indent <= WIDTH or not text.startswith("("):
        yield " " * indent + text
        return
    parts = list(_split(text[1:-1]))
    keep = 1 + (parts[0] == "define-fun") * 3
    yield f"{' ' * indent}({' '.join(parts[:keep])}"
    rows = [row for part in parts[keep:] for row in _wrapped(part, indent + 2)]
    rows[-1] += ")"
    yield from rows


def _split(text: str) -> Iterator[str]:
    """Yield the S-expressions of a sequence, in their order."""
    depth, start, quoted = 0, 0, False
    for place, character in enumerate(text):
        if character == "|":
            quoted = not quoted
        if quoted:
            continue
        if character == "(":
            depth += 1
        elif character == ")":
            depth -= 1
        elif character == " " and not depth:
            yield text[start:place]
            start = place + 1
    yield text[start:]

"""Error recovery: replaces wrong tokens by the token BROKEN, and parses the section again.

At most a line is replaced, or a block if its header cannot be recovered. The replacement is found by trial: each
candidate, beginning with the one that keeps most tokens, is run from the parser's state before its line. Only programs
with errors come here, so this code need not be fast, only linear; a section is parsed once more for each error in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from koordgen.lang.diagnostics import Diagnostic
from koordgen.lang.source import Span
from koordgen.lang.syntax import build, decl
from koordgen.lang.syntax._generated.grammar import START, STATES
from koordgen.lang.syntax.build import token_span
from koordgen.lang.syntax.layout import Chunk
from koordgen.lang.syntax.lr import DEEPEST_TREE, ROWS, UnexpectedToken, section, too_deep
from koordgen.lang.syntax.mistake import explain

MOST_FAULTS = 30  # diagnostics reported for one text
_DEEPEST_STACK = 20 * DEEPEST_TREE  # states; more than the deepest allowed tree needs

_MARGINS = ("NEWLINE", "INDENT", "DEDENT")
_DEPTH = {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}
_CATCHING = ("except", "catch", "finally")
_NAMED = ("using", "provides", "def", "invariant", "axiom")  # keywords of headers with a name

Tokens = list[Any]
States = list[int]


def recovered(
    chunk: Chunk, found: list[Diagnostic], wrong: UnexpectedToken | build.BuilderError | None
) -> decl.Section:
    """Return the node of a section with errors: in its layout, or `wrong`, which ended the first attempt.

    Adds their diagnostics to `found`, up to MOST_FAULTS.
    """
    repair = _Repair(chunk, found)
    faults = sorted(chunk.faults, key=_place, reverse=True)
    while not repair.hopeless:
        if wrong is None and faults and repair.readable(faults[-1]):
            repair.fault(faults.pop())
        elif wrong is not None:
            if isinstance(wrong, UnexpectedToken):
                repair.stuck(wrong.position)
            else:
                repair.fault(wrong.diagnostic)
            wrong = None
        else:
            try:
                return section(repair.tokens, chunk.long)  # type: ignore[no-any-return]
            except (UnexpectedToken, build.BuilderError) as error:
                wrong = error
    first = chunk.tokens[0]
    return decl.BrokenSection(_names(chunk.tokens), Span(first[2], first[3], first[2], first[3] + len(first[1])))


class _Repair:
    """Tokens of a section while they are repaired. Each step reports an error or gives up."""

    def __init__(self, chunk: Chunk, found: list[Diagnostic]) -> None:
        self.tokens: Tokens = list(chunk.tokens)
        self.found = found
        self.touched: dict[int, int] = {}  # line number -> number of repairs in it
        self.reported: set[tuple[int, int]] = set()  # positions of reported errors
        self.tried = False  # a `try` was reported, so its `except` is not
        self.muted = False  # tabs in the indentation: later errors may be consequences
        self.hopeless = len(found) == MOST_FAULTS
        kinds = {token[0] for token in chunk.tokens}
        self.headless = chunk.tokens[0][0] == "NAME" and not kinds & {"pre", "eff"}  # probably not an event

    def readable(self, diagnostic: Diagnostic) -> bool:
        """Return whether all text before the line of a diagnostic can be parsed by now."""
        start = _start(self.tokens, self._position(diagnostic))
        return _advanced([START], self.tokens[:start]) is not None

    def _position(self, diagnostic: Diagnostic) -> int:
        """Return the index of the token at which the span begins. It is an INDENT only if blocks are too deep."""
        where = _place(diagnostic)
        margins = ("DEDENT",) if diagnostic.code == "K007" else ("INDENT", "DEDENT")
        ahead = (i for i, token in enumerate(self.tokens) if token[2:4] >= where and token[0] not in margins)
        return next(ahead, len(self.tokens) - 1)

    def fault(self, diagnostic: Diagnostic) -> None:
        """Report and repair an error that the layout or a builder found."""
        position = self._position(diagnostic)
        reported = self._report(diagnostic, position)
        if diagnostic.code == "K004":
            self.muted = True
        elif diagnostic.code == "K005":
            if reported:
                self._rejoin(position)
        elif self.tokens[position][0] == "INDENT":  # blocks are nested too deeply
            end = _block_end(self.tokens, position)
            self.tokens[position + 1 : end - 1] = [_broken(self.tokens[position:end]), self.tokens[position - 1]]
        else:
            self._line(position, colon=False)

    def stuck(self, position: int) -> None:
        """Report and repair a syntax error."""
        states = _advanced([START], self.tokens[:position])
        kind = self.tokens[position][0]
        if self.muted or states is None:
            self.hopeless = True
            return
        blockless = position > 0 and _wants_block(states)
        ended = not blockless and (kind in ("DEDENT", "$END") or _fits(states, [], ("$END",)))
        if ended and self.touched:  # earlier repairs removed or kept too much
            self.hopeless = True
            return
        if len(states) > _DEEPEST_STACK:
            first = self._report(too_deep(token_span(self.tokens[position])).diagnostic, position)
        else:
            first = self._report(explain(self.tokens, position, states), position)
        if kind == "INDENT":
            self._deeper(position, states)
        elif kind in ("pre", "eff") and self.tokens[0][0] == "priority" and _awaits_event(states):
            self._nameless(position)
        elif blockless:
            self._no_block(position, states)
        elif kind in ("DEDENT", "$END"):
            self.hopeless = True
        else:
            self._line(position, colon=first)

    def _report(self, diagnostic: Diagnostic, position: int) -> bool:
        """Report an error, and return whether it is the first one in its line.

        A further error in the same line or at the same position may be a consequence of the first and is not reported.
        """
        first = self.tokens[_start(self.tokens, position)]
        line = first[2]
        echo = self.muted or (self.tried and first[1] in _CATCHING)
        self.tried |= first[1] == "try"
        times = self.touched[line] = self.touched.get(line, 0) + 1
        where = _place(diagnostic)
        if times == 1 and where not in self.reported and not echo and len(self.found) < MOST_FAULTS:
            self.found.append(diagnostic)
            self.reported.add(where)
        self.hopeless |= self.headless or times > 3 or len(self.found) == MOST_FAULTS
        return times == 1

    def _rejoin(self, position: int) -> None:
        """Repair a line between the indentations of two blocks.

        It joins the inner block, unless only the outer one can hold it.
        """
        states = _advanced([START], self.tokens[:position])
        line = self.tokens[position]
        if states is not None and not _fits(states, [], line) and _fits(states, [("DEDENT",)], line):
            end = _block_end(self.tokens, position) - 1
            self.tokens.insert(position, self.tokens.pop(end))

    def _deeper(self, position: int, states: States) -> None:
        """Repair lines that are too deep: remove their extra indentation, or the lines if they fit nowhere."""
        end = _block_end(self.tokens, position)
        self.tokens[position:end] = (
            self.tokens[position + 1 : end - 1] if _fits(states, [], self.tokens[position + 1]) else []
        )

    def _nameless(self, position: int) -> None:
        """Remove clauses that lack the name of their event."""
        end = position
        while self.tokens[end][0] in ("pre", "eff"):
            end = _next_line(self.tokens, end)
        del self.tokens[position:end]

    def _no_block(self, position: int, states: States) -> None:
        """Repair a header without a block: the following lines become its block if they fit nowhere else."""
        end = position - 1
        hole = [_broken(self.tokens[_start(self.tokens, end) : end]), self.tokens[end]]
        before = _advanced([START], self.tokens[:end])
        beside = _advanced(before, hole) if before is not None else None
        inside = _advanced(states, [("INDENT",)])
        stop = position
        while inside is not None and _fits(inside, [], self.tokens[stop]):
            if beside is not None and _fits(beside, [], self.tokens[stop]):
                break
            stop = _next_line(self.tokens, stop)
        if stop > position:
            self.tokens.insert(stop, ("DEDENT", "", *self.tokens[stop][2:4]))
            self.tokens.insert(position, ("INDENT", "", *self.tokens[position][2:4]))
        elif beside is not None:
            self.tokens.insert(end, hole[0])
        else:
            self.hopeless = True

    def _line(self, position: int, colon: bool) -> None:
        """Replace the wrong part of a line by the first candidate that can be parsed."""
        start = _start(self.tokens, position)
        end = start
        while self.tokens[end][0] not in (*_MARGINS, "$END"):
            end += 1
        states = _advanced([START], self.tokens[:start])
        if states is None or self.tokens[end][0] != "NEWLINE":
            self.hopeless = True
            return
        deep = self.tokens[end + 1][0] == "INDENT"
        block = _block_end(self.tokens, end + 1) if deep else end + 1
        for line, keeps_block in self._candidates(start, position, end, block, colon):
            new = [*line, self.tokens[end]] if line else []
            rest = end + 1 if keeps_block else block
            reached = _advanced(states, new)
            if reached is not None and _follows(reached, self.tokens[rest]):
                self.tokens[start:rest] = new
                return
        self.hopeless = True

    def _candidates(
        self, start: int, position: int, end: int, block: int, colon: bool
    ) -> Iterator[tuple[Tokens, bool]]:
        """Yield replacements for `tokens[start:end]`, those that keep most first.

        Each comes with whether the block below is kept.
        """
        tokens = self.tokens
        if colon and _depth(tokens[start:position]) == 0:
            yield [*tokens[start:position], _mark(":", tokens[position]), *tokens[position:end]], True
        parts = _parts(tokens[start:end])
        bad = next((i for i, part in enumerate(parts) if tokens[position] in part), len(parts) - 1)
        prefix = [token for part in parts[:bad] for token in part]
        part, rest = parts[bad], [token for later in parts[bad + 1 :] for token in later]
        hole = [_broken(tokens[start:end])]
        of_loop = part[0][0] == "invariant" and start > 0  # a loop invariant is not a header, even with a colon
        if (part[-1][0] == ":" or block > end + 1) and not of_loop:
            for head in _heads(part, hole[0], tokens[block], {token[0] for token in tokens}):
                for tail in (rest, hole, []):
                    yield [*prefix, *head, *tail], True
        whole = [_broken(tokens[start:block])]
        yield [*prefix, *whole], True
        yield [*prefix, *whole], False
        for head in _clauses(part, {token[0] for token in tokens}):
            yield [*head, *whole], False
        yield [], False


def _place(diagnostic: Diagnostic) -> tuple[int, int]:
    return diagnostic.span.line, diagnostic.span.column


def _heads(part: Tokens, hole: Any, after: Any, present: set[str]) -> Iterator[Tokens]:
    """Yield headers that an unreadable header may stand for. `after` is the token after its block."""
    first = part[0]
    colon = _mark(":", part[-1])
    function = first[0] == "def" and any(token[0] in ("(", "->") for token in part)  # as in Python
    if first[0] in _NAMED and len(part) > 1 and part[1][0] == "NAME" and not function:
        yield [first, part[1], colon]
    if first[0] == "else":
        yield [_mark("elif", first), hole, colon]
    yield [first, colon]
    yield [first, hole, colon]
    loop = first[0] in ("for", "while") or after[0] not in ("elif", "else")
    for word in ("while", "if") if loop and first[0] not in ("elif", "else") else ("if",):
        yield [_mark(word, first), hole, colon]
    yield from _clauses(part, present)


def _clauses(part: Tokens, present: set[str]) -> Iterator[Tokens]:
    """Yield headers of the clauses that an event lacks: an unknown clause may stand for one of them."""
    for word in ("eff", "pre"):
        if word not in present:
            yield [_mark(word, part[0]), _mark(":", part[0])]


def _fits(states: States, between: Tokens, token: Any) -> bool:
    return _advanced(states, [*between, token]) is not None


def _follows(states: States, token: Any) -> bool:
    """Return whether the token after a line fits: a block if and only if one is required there."""
    if token[0] in ("INDENT", "DEDENT", "$END"):
        return _fits(states, [], token)
    return not _wants_block(states)


def _awaits_event(states: States) -> bool:
    """Return whether the name of an event may follow, and no statement."""
    return _fits(states, [], ("NAME",)) and not _fits(states, [], ("pass",))


def _wants_block(states: States) -> bool:
    return [symbol for symbol in STATES[states[-1]] if symbol.isupper()] == ["INDENT"]


def _advanced(states: States, tokens: Sequence[Any]) -> States | None:
    """Return the parser's stack after the tokens, or None if they do not fit.

    `$END` fits a complete section.
    """
    stack = list(states)
    for token in tokens:
        action = ROWS[stack[-1]][token[0]]
        while action.__class__ is tuple:  # as in `lr.run`, without values
            top, _, after = action
            if top is None:
                stack[-1], action = after[stack[-2]]
            else:
                del stack[top]
                state, action = after[stack[-1]]
                stack.append(state)
        if action is not None:
            stack.append(action)
        elif token[0] != "$END" or STATES[stack[-1]]:
            return None
    return stack


def _start(tokens: Tokens, position: int) -> int:
    """Return the index of the first token of a line. INDENT and DEDENT belong to the line before."""
    while position and tokens[position][0] in ("INDENT", "DEDENT", "$END"):
        position -= 1
    while position and tokens[position - 1][0] not in _MARGINS:
        position -= 1
    return position


def _next_line(tokens: Tokens, position: int) -> int:
    """Return the index after the line that starts at `position`, and after its block."""
    while tokens[position][0] != "NEWLINE":
        position += 1
    return _block_end(tokens, position + 1) if tokens[position + 1][0] == "INDENT" else position + 1


def _block_end(tokens: Tokens, position: int) -> int:
    """Return the index after the end of the block that `tokens[position]` is in, or opens."""
    depth = 0 if tokens[position][0] == "INDENT" else 1
    while True:
        depth += {"INDENT": 1, "DEDENT": -1}.get(tokens[position][0], 0)
        position += 1
        if depth == 0:
            return position


def _parts(line: Tokens) -> list[Tokens]:
    """Split a line into headers and the rest: after each colon outside of brackets and quantifiers."""
    parts: list[Tokens] = [[]]
    depth = quantifiers = 0
    cut = False
    for token in line:
        if cut:
            parts.append([])
        parts[-1].append(token)
        depth += _DEPTH.get(token[0], 0)
        cut = token[0] == ":" and depth == 0 and quantifiers == 0
        if depth == 0:
            quantifiers += (token[0] in ("forall", "exists")) - (token[0] == ":" and quantifiers > 0)
    return parts


def _depth(tokens: Tokens) -> int:
    return sum(_DEPTH.get(token[0], 0) for token in tokens)


def _mark(word: str, place: Any) -> Any:
    return word, word, place[2], place[3]


def _broken(tokens: Tokens) -> Any:
    """Make the BROKEN token for text that cannot be parsed; see `build.broken`."""
    first = tokens[0]
    last = [token for token in tokens if token[2] == first[2]][-1]
    names = [token for token in tokens if token[0] == "NAME"]
    span = Span(first[2], first[3], first[2], last[3] + len(last[1]))
    rest = tokens[1:] if first[0] == "write" else tokens  # `write Type name`
    declared = names[1:2] if len(names) > 1 and rest[0] is names[0] and rest[1] is names[1] else names[:1]
    return "BROKEN", declared[0][1] if declared else "", first[2], first[3], _names(tokens), span


def _names(tokens: Tokens) -> tuple[str, ...]:
    """Return all names in the tokens, each once."""
    known = [name for token in tokens if token[0] == "BROKEN" for name in token[4]]
    return tuple(dict.fromkeys([token[1] for token in tokens if token[0] == "NAME"] + known))

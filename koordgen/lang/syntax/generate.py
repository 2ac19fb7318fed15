"""Makes the parser's tables ahead: `python -m koordgen.lang.syntax.generate`; `--check` only tells whether that is due.

Lark analyses the grammar and its LALR(1) tables are written out as literals, so that neither the grammar nor Lark
itself is needed at start-up. States and rules are numbered in an order of our own: two runs give the same bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from koordgen.lang import resources

GRAMMAR = Path(__file__).with_name("koord.lark")
TABLES = Path(__file__).parent / "_generated" / "grammar.py"

_HEAD = '''"""The LALR(1) tables of koordgen/lang/syntax/koord.lark: made by `make generated`, not written by hand.

STATES: symbol -> n >= 0: shift (or go) to state n; n < 0: reduce by rule -n - 1.
BROKEN: state -> what STATES would say of the symbol BROKEN, which recover.py puts in the place of what cannot be read;
it stands apart because nobody can write it: it is never what is expected.
RULES: (symbol, length, name of the function in build.py; empty: the value of the only child or a spliced list).
SPLICING: the rules that may have a spliced list among their children.
"""

'''


def tables() -> str:
    """The text of the generated module."""
    from lark import Lark

    grammar = GRAMMAR.read_text(encoding="utf-8")
    # Its lexer is never run: the tokens come from layout.py.
    lark = Lark(grammar, parser="lalr", lexer="basic", keep_all_tokens=True, maybe_placeholders=False)
    literals = {t.name: t.pattern.value for t in lark.terminals if t.pattern.type == "str"}
    table = lark.parser.parser._parse_table
    symbols = {name: literals.get(name, name) for row in table.states.values() for name in row}
    assert len(set(symbols.values())) == len(symbols), "a rule has the name of a keyword: give it a trailing underscore"
    # Rules that differ only in marks that nobody looks at are one.
    used = [arg for row in table.states.values() for _, arg in row.values() if hasattr(arg, "origin")]
    rules = sorted({_rule(arg) for arg in used})
    rule_number = {rule: number for number, rule in enumerate(rules)}
    order = _reached(table, symbols)
    state_number = {state: number for number, state in enumerate(order)}

    def code(arg: Any) -> int:
        return -rule_number[_rule(arg)] - 1 if hasattr(arg, "origin") else state_number[arg]

    lines = [_HEAD, "STATES: tuple[dict[str, int], ...] = (\n"]
    broken = {}
    for number, state in enumerate(order):
        row = {symbols[name]: code(arg) for name, (_, arg) in table.states[state].items()}
        if "BROKEN" in row:
            broken[number] = row.pop("BROKEN")
        lines.append(f"    {{{', '.join(f'{name!r}: {row[name]}' for name in sorted(row))}}},\n")
    lines.append(f")\nBROKEN: dict[int, int] = {broken}\n")
    lines.append("RULES: tuple[tuple[str, int, str], ...] = (\n")
    for rule in rules:
        lines.append(f"    {rule!r},\n")
    lines.append(f")\nSPLICING = frozenset({_splicing(used, rule_number)})\n")
    lines.append(f"START = {state_number[table.start_states['start']]}\n")
    lines.append(f"END = {state_number[table.end_states['start']]}\n")
    return "".join(lines)


def _rule(rule: Any) -> tuple[str, int, str]:
    name = str(rule.origin.name)
    passed_on = name.startswith("_") or name == "start" or (rule.options.expand1 and len(rule.expansion) == 1)
    return name, len(rule.expansion), str(rule.alias or ("" if passed_on else name))


def _splicing(used: list[Any], number: dict[tuple[str, int, str], int]) -> list[int]:
    """The numbers of the rules some child of which is a list, or passes one on."""
    lists: set[str] = set()
    while True:
        makers = [rule for rule in used if not _rule(rule)[2] and (rule.origin.name[0] == "_" or _has(rule, lists))]
        if {rule.origin.name for rule in makers} == lists:
            return sorted({number[_rule(rule)] for rule in used if _has(rule, lists)})
        lists = {rule.origin.name for rule in makers}


def _has(rule: Any, names: set[str]) -> bool:
    return any(symbol.name in names for symbol in rule.expansion)


def _reached(table: Any, symbols: dict[str, str]) -> list[int]:
    """All states, breadth first from the start, along the symbols in alphabetical order."""
    order = [table.start_states["start"]]
    seen = set(order)
    for state in order:
        for name in sorted(table.states[state], key=symbols.__getitem__):
            target = table.states[state][name][1]
            if not hasattr(target, "origin") and target not in seen:
                seen.add(target)
                order.append(target)
    return order


def main(arguments: list[str]) -> int:
    return resources.freshen({TABLES: tables()}, arguments)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

"""Generator of docs/reference/grammar.md from koord.lark: `python -m koordgen.lang.syntax.page`.

With `--check` it only reports whether the page is out of date. The page leaves out technical parts of the grammar:
names of functions, marks for inlining, and rules for error recovery.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from koordgen.lang import resources
from koordgen.lang.syntax.generate import GRAMMAR

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "grammar.md"

_HEAD = """# Koord's grammar

Made from `koordgen/lang/syntax/koord.lark` by `make generated`; [language](language.md) explains
each construct. A program is a sequence of sections, each beginning at the left margin.

| sign | meaning |
|---|---|
| `"word"` | stands for itself |
| `a*`, `a+`, `a?` | none or more, one or more, one or none |
| `a` \\| `b` | either |
| a `suite` of items | one on the header's line, or several on indented lines, or both |
| NEWLINE | ends a line outside of brackets that does not end in `\\` |
| INDENT, DEDENT | the indentation of lines increases, and decreases |

| | |
|---|---|
| NAME | a letter or `_`, then letters, digits, `_` (ASCII); not a keyword |
| GENERIC | `List`, `Map`, `Set`, `Queue` |
| INT | digits, not beginning with 0 unless it is 0; at most 2^63 - 1 |
| FLOAT | `1.5`, `.5`, `1e-3`, `2.5E+6` |
| STRING | `"..."` or `'...'` on a line; `\\"`, `\\'`, `\\\\`, `\\n`, `\\t`; after a name, `]`, `)`, `'` it is a prime |
"""
_RULE = re.compile(r"^\??(_?[a-z][a-z_]*)(\{item\})?: (.*)$", re.DOTALL)


def page(grammar: str) -> str:
    """Return the text of the page."""
    parts = [_HEAD]
    for title, rules in _sections(grammar):
        parts.append(f"\n## {title}\n\n```\n" + "\n".join(map(_shown, rules)) + "\n```\n")
    return "".join(parts)


def _sections(grammar: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the title of each section of the grammar with the section's rules.

    A comment that begins with a capital letter is a title. A rule consists of all of its lines.
    """
    title, rules = "Program", list[str]()
    for line in grammar.split("\n"):
        if line.startswith("// ") and rules and line[3].isupper() and not rules[-1].startswith("//"):
            yield title, rules
            title, rules = re.split(r"[.,]", line[3:])[0], []
        elif line.startswith((" ", "\t")) and rules:
            rules[-1] += "\n" + line
        elif _RULE.match(line):
            rules.append(line)
    yield title, rules


def _shown(rule: str) -> str:
    found = _RULE.match(rule)
    assert found, rule
    alternatives = dict.fromkeys(
        _plain(a) for a in re.split(r"\n?\s+\|(?=\s)|\n\s*\|\s", found[3]) if "BROKEN" not in a
    )
    name = _name(found[1]) + (" of items" if found[2] else "")
    return f"{name}: " + ("\n" + " " * len(name) + "| ").join(alternatives)


def _plain(alternative: str) -> str:
    text = re.sub(r"\s+->\s+[a-z_]+\s*$", "", alternative.strip())
    text = re.sub(r"_suite\{(\w+)\}", lambda m: f"suite of {_name(m[1])}", text)
    return re.sub(r'"[^"]*"|\b_?[a-z][a-z_]*\b', lambda m: m[0] if m[0][0] == '"' else _name(m[0]), text)


def _name(rule: str) -> str:
    return rule if rule in ("of", "item", "items", "suite") else rule.strip("_").replace("_", "-")


def main(arguments: list[str]) -> int:
    return resources.freshen({PAGE: page(GRAMMAR.read_text(encoding="utf-8"))}, arguments)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

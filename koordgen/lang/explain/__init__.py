"""Explanations of all diagnostic codes, with tested examples.

Owns: the pages beside this file, one for each initial letter of codes, and `topics.md`. Pages of codes that the
    analysis reports stand beside its rules.
Offers: `explanation`, `topic`, `show`.
Must not import: syntax, or any package above it.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from koordgen.lang.diagnostics import CATALOGUE, InternalError
from koordgen.lang.node import Node

_FENCE = "```"
_RULES = Path(__file__).parents[1] / "analyze" / "rules"


class CodeExplanation(Node):
    """Explanation of one code.

    `markdown` is its section without the heading. `wrong` and `right` are its examples, `wrong_note` and `right_note`
    the lines before them.
    """

    code: str
    title: str
    markdown: str
    wrong_note: str
    wrong: str
    right_note: str
    right: str


def explanation(code: str) -> CodeExplanation:
    """Return the explanation of a code. Raises KeyError for a code that is not in the catalogue."""
    title = CATALOGUE[code]
    section = _sections(code[0]).get(code, "")
    parts = section.split(f"\n{_FENCE}")
    if len(parts) != 5:
        raise InternalError(f"the explanation of {code} does not have its five parts")
    before, wrong, between, right, _ = parts
    return CodeExplanation(
        code, title, section, before.split("\n")[-1], _listing(wrong), between.strip(), _listing(right)
    )


def show(found: CodeExplanation) -> str:
    """Return an explanation for a terminal: title and section, with indented instead of fenced listings."""
    return f"{found.code}: {found.title}\n\n{_plain(found.markdown)}"


def topic(word: str) -> str:
    """Return the text about a verdict, `skip` or one reason to skip, for a terminal.

    Returns an empty string for other words.
    """
    for heading, body in topics().items():
        if word.casefold() == heading.casefold() or f"\n- `{word.casefold()}`:" in body:
            return f"{heading}\n\n{_plain(body)}"
    return ""


def topics() -> dict[str, str]:
    """Return the sections of topics.md by their headings."""
    return _sections("topics")


def _plain(markdown: str) -> str:
    lines: list[str] = []
    inside = False
    for line in markdown.split("\n"):
        if line.startswith(_FENCE):
            inside = not inside
            lines.append("")
        elif inside:
            lines.append(f"    {line}".rstrip(" "))
        elif line or (lines and lines[-1]):
            lines.append(line)
    return "\n".join(lines).rstrip("\n")


def _listing(part: str) -> str:
    """Return a listing without the line of its opening fence."""
    return part.partition("\n")[2] + "\n"


@cache
def _sections(name: str) -> dict[str, str]:
    """Return the sections of a page, and for K also those of the pages beside the rules of the analysis."""
    pages = [Path(__file__).with_name(f"{name}.md"), *(sorted(_RULES.glob("*.md")) if name == "K" else ())]
    texts = [page.read_text(encoding="utf-8") for page in pages]
    sections = (section.partition("\n") for text in texts for section in text.split("\n## ")[1:])
    return {code: body.strip("\n") for code, _, body in sections}

"""`koordgen docs`: the documentation pages that are installed with koordgen."""

from __future__ import annotations

import re
from argparse import Namespace
from difflib import get_close_matches
from pathlib import Path

from koordgen.cli.base import console
from koordgen.lang import resources

LIST = "`koordgen docs` lists all pages"
# Folders of the pages, with the line above their part of the list.
KINDS = {
    ".": "Start here",
    "tutorial": "Tutorial: learn by doing, step by step",
    "how-to": "How-to: steps for one task",
    "reference": "Reference: all keys, options and rules, to look up",
    "explanation": "Explanation: how it works, and why",
}


def docs(options: Namespace) -> int:
    """List the pages, or print a page or one of its sections as Markdown. Raises Failure."""
    if options.page is None:
        print(_listing())
    else:
        page, marker, anchor = options.page.partition("#")
        text = _page(page)
        print(_section(text, page, anchor) if marker else text, end="")
    return console.HOLDS


def pages() -> dict[str, Path]:
    """Return the file of each page by its name: README.md, then the pages of each folder, then records of decisions.

    Names of pages are unique among all folders, so links in messages need no folder.
    """
    folder = resources.docs()
    files = [path for kind in KINDS for path in sorted(folder.glob(f"{kind}/*.md"))]
    named = {"map" if path.stem == "README" else path.stem: path for path in files}
    decisions = {f"adr/{path.stem}": path for path in sorted(folder.glob("adr/*.md"))}
    return {"readme": folder.parent / "README.md", **named, **decisions}


def sections(text: str) -> dict[str, str]:
    """Return the text of each section of a page, with its subsections, by the section's anchor in links."""
    found: dict[str, str] = {}
    headings = [
        (len(m[1]), m[2], m.start()) for m in re.finditer(r"^(#+) (.*)$", _without_listings(text), re.MULTILINE)
    ]
    for index, (level, title, start) in enumerate(headings):
        end = next((place for deep, _, place in headings[index + 1 :] if deep <= level), len(text))
        found.setdefault(re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-"), text[start:end].rstrip("\n") + "\n")
    return found


def _without_listings(text: str) -> str:
    """Return the text with code blocks replaced by blanks, since `#` does not begin a heading in them."""
    return re.sub(r"^```.*?^```$", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.MULTILINE | re.DOTALL)


def _listing() -> str:
    listed = {name: path for name, path in pages().items() if "/" not in name}
    width = max(map(len, listed))
    lines = ["`koordgen docs PAGE` prints a page, `koordgen docs PAGE#SECTION` a section of it."]
    for kind, title in KINDS.items():
        own = {name: path for name, path in listed.items() if _kind(path) == kind}
        lines += ["", f"{title}:", *(f"  {name:{width}}  {_title(path)}" for name, path in own.items())]
    return "\n".join([*lines, "", f"Files of the pages, with their pictures: {resources.docs()}"])


def _kind(path: Path) -> str:
    """Return the key of KINDS for a page; README.md above all folders is among the first."""
    return path.parent.name if path.parent.name in KINDS else "."


def _title(path: Path) -> str:
    with path.open(encoding="utf-8") as file:
        return file.readline().lstrip("#").strip()


def _page(name: str) -> str:
    """Return the text of a page. Raises Failure."""
    there = pages()
    if name not in there:
        near = get_close_matches(Path(name).stem, there, 1)
        help = f"did you mean `koordgen docs {near[0]}`? " if near else ""
        raise console.Failure(console.USAGE, f"no page {name!r}", help + LIST)
    return there[name].read_text(encoding="utf-8")


def _section(text: str, page: str, anchor: str) -> str:
    """Return the text of a section. Raises Failure."""
    there = sections(text)
    if anchor not in there:
        near = get_close_matches(anchor, there, 1)
        help = f"did you mean `koordgen docs {page}#{near[0]}`? " if near else ""
        raise console.Failure(console.USAGE, f"no section {page}#{anchor}", f"{help}its sections: {', '.join(there)}")
    return there[anchor]

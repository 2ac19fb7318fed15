"""`koordgen docs`: the documentation pages that are installed with koordgen."""

from __future__ import annotations

import re
from argparse import Namespace
from difflib import get_close_matches
from pathlib import Path

from koordgen.cli.base import console
from koordgen.lang import resources

LIST = "`koordgen docs` lists all pages"


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
    """Return the file of each page by its name: first README, then the pages by name, then records of decisions."""
    folder = resources.docs()
    files = [*sorted(folder.glob("*.md")), *sorted(folder.glob("adr/*.md"))]
    named = {path.relative_to(folder).with_suffix("").as_posix(): path for path in files}
    return {"readme": folder.parent / "README.md", **named}


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
    titles = {name: _title(path) for name, path in pages().items() if "/" not in name}
    width = max(map(len, titles))
    return "\n".join(
        [
            "`koordgen docs PAGE` prints a page, `koordgen docs PAGE#SECTION` a section of it:",
            "",
            *(f"  {name:{width}}  {title}" for name, title in titles.items()),
            "",
            f"Files of the pages, with their pictures: {resources.docs()}",
        ]
    )


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

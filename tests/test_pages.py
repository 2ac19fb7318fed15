"""The pages in Markdown: links, folders and the map."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from koordgen.cli.docs import KINDS, sections

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FIRST = {"README.md", "glossary.md", "examples.md"}  # pages outside the four folders


def all_pages() -> list[Path]:
    """The Markdown files that people read, with paths relative to the repository."""
    found = [*ROOT.glob("*.md"), *DOCS.rglob("*.md"), *ROOT.glob("examples/**/*.md"), *ROOT.glob("targets/**/*.md")]
    return sorted(path.relative_to(ROOT) for path in found)


def our_pages() -> list[Path]:
    """The pages of the documentation, without the records of decisions."""
    return [path for path in all_pages() if path.parts[0] == "docs" and path.parent.name != "adr"]


def prose(text: str) -> str:
    """The text with its listings and inline code replaced by blanks, line by line."""
    text = re.sub(r"^```.*?^```$", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`", lambda m: " " * len(m[0]), text)


@cache
def anchors(path: Path) -> frozenset[str]:
    return frozenset(sections((ROOT / path).read_text(encoding="utf-8")))


def links(path: Path) -> Iterator[tuple[Path, str]]:
    """The file, relative to the repository, and the anchor (or "") of each link to a file."""
    text = prose((ROOT / path).read_text(encoding="utf-8"))
    for link, anchor in re.findall(r"\]\((?!https?:|mailto:)([^)#\s]*)(?:#([^)\s]*))?\)", text):
        yield Path(os.path.normpath(path.parent / link)) if link else path, anchor


@pytest.mark.parametrize("path", all_pages(), ids=str)
def test_links_and_anchors_lead_somewhere(path: Path) -> None:
    for to, anchor in links(path):
        assert (ROOT / to).exists(), f"{path}: {to}"
        assert not anchor or anchor in anchors(to), f"{path}: {to}#{anchor}"


def test_links_were_found() -> None:
    assert sum(1 for path in all_pages() for _ in links(path)) > 300


def test_pages_stand_in_the_folder_of_their_kind() -> None:
    assert {path.parts[1] for path in our_pages()} == (set(KINDS) - {"."}) | FIRST


def test_the_map_has_every_page() -> None:
    linked = {to for to, _ in links(Path("docs/README.md"))}
    assert {path for path in our_pages() if path != Path("docs/README.md")} <= linked

"""CONTRIBUTING.md: its files, names, commands and links exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
INVENTED = {"targets/NAME", "tests/NAME"}
PATHS = sorted(
    set(re.findall(r"(?<![\w/.])((?:koordgen|targets|tests|tools|benchmarks|docs)/[\w/.\-]*\w)", PAGE)) - INVENTED
)
# "`NAME` in `file.py`", "`NAME` of `file.py`"
NAMED = re.findall(r"`([A-Za-z_][\w.]*)` (?:in|of) `([\w/]+\.py)`", PAGE)


def defined(path: str) -> set[str]:
    """Return the top-level names of a module, and `Class.name` of names in its classes."""
    found = set()
    for node in ast.parse((ROOT / path).read_text(encoding="utf-8")).body:
        names = [node.name] if isinstance(node, (ast.FunctionDef, ast.ClassDef)) else []
        if isinstance(node, ast.Assign):
            names = [part.id for target in node.targets for part in ast.walk(target) if isinstance(part, ast.Name)]
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names = [node.target.id]
        found.update(names)
        if isinstance(node, ast.ClassDef):
            inner = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
            found |= inner | {f"{node.name}.{name}" for name in inner}
    return found


@pytest.mark.parametrize("path", [path for path in PATHS if not path.endswith("/NAME")])
def test_a_path_is_there(path: str) -> None:
    assert (ROOT / path).exists()


@pytest.mark.parametrize(("name", "path"), NAMED)
def test_a_name_is_in_its_file(name: str, path: str) -> None:
    assert name in defined(path), sorted(defined(path))


def test_names_were_found() -> None:
    assert len(NAMED) > 12


@pytest.mark.parametrize("target", sorted(set(re.findall(r"\bmake ([a-z]+)\b", PAGE))))
def test_a_make_target_is_there(target: str) -> None:
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_lead_somewhere(page: str) -> None:
    for link in re.findall(r"\]\(([^)#]+)", (ROOT / page).read_text(encoding="utf-8")):
        assert link.startswith("https://") or (ROOT / link).exists(), link


def test_old_imports_are_gone_and_new_ones_are_there() -> None:
    table = re.findall(
        r"^  \| (`.*`.*) \| (`.*`.*) \|$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(table) > 5
    for _, new in table:
        (module, *_) = re.findall(r"`((?:koordgen|targets)\.[\w.]+)`", new)
        assert (ROOT / module.replace(".", "/")).with_suffix(".py").is_file(), module

"""Wheel: installed in an empty environment outside of the checkout, it builds a program."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from importlib import metadata
from itertools import chain
from pathlib import Path

import pytest

from koordgen.cli.commands import COMMANDS, harnesses
from koordgen.cli.docs import pages, sections

ROOT = Path(__file__).parents[1]


NEEDED = ("jinja2", "markupsafe", "msgspec", "pyyaml", "shtab")  # of other people's packages


def copied(name: str, site: Path) -> None:
    """Install the package from this environment, without an index, which may be far away."""
    distribution = metadata.distribution(name)
    for file in distribution.files or ():
        if ".." not in file.parts:  # as scripts are
            (site / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(str(distribution.locate_file(file)), site / file)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel without isolation: the build backend is among the locked packages."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)],
        check=True, capture_output=True,
    )  # fmt: skip
    return next(folder.glob("koordgen-*.whl"))


def test_it_carries_templates_targets_runtime_and_explanations(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "koordgen/_data/templates/main_agent.py.j2",
        "koordgen/_data/targets/quad/manifest.toml",
        "koordgen/_data/targets/quad/platform/platform.py",
        "koordgen/_data/targets/car/control/solver/mpc.c",
        "koordgen/_data/targets/sim/harness.py",
        "koordgen/_data/targets/__init__.py",
        "koordgen/runtime/agent/process.py",
        "koordgen/runtime/net/socket_batch.c",
        "koordgen/lang/syntax/_generated/grammar.py",
        "koordgen/lang/explain/K.md",
        "koordgen/lang/explain/F.md",
        "koordgen/lang/explain/B.md",
        "koordgen/lang/explain/topics.md",
    } <= names
    assert not [n for n in names if n.startswith(("tests/", "benchmarks/")) or n.endswith(".pyc")]


def tracked(*folders: str) -> list[str]:
    """Return the files of the repository as in a clean checkout."""
    done = subprocess.run(["git", "ls-files", *folders], cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip("no git, or no repository: which files are the project's own cannot be told")
    return [file for file in done.stdout.splitlines() if (ROOT / file).exists()]


def test_it_carries_examples_and_pages_and_nothing_that_lies_about(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    data = {name.removeprefix("koordgen/_data/") for name in names if name.startswith("koordgen/_data/")}
    assert data == set(
        tracked(
            "examples",
            "docs",
            "templates",
            "targets",
            "README.md",
            "ARCHITECTURE.md",
            "CONTRIBUTING.md",
            "CHANGELOG.md",
        )
    )
    package = {name for name in names if name.startswith("koordgen/") and not name.startswith("koordgen/_data/")}
    assert package == set(tracked("koordgen"))
    assert sum(info.compress_size for info in zipfile.ZipFile(wheel).infolist()) < 4e6, "bytes"


def test_links_of_its_pages_lead_somewhere(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    data = tmp_path / "koordgen/_data"
    carried = list(data.rglob("*.md"))
    assert len(carried) > 30
    for page in carried:
        for link, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", page.read_text(encoding="utf-8")):
            to = page.parent / link if link else page
            assert to.exists(), f"{page.relative_to(data)}: {link}"
            assert not anchor or anchor in sections(to.read_text(encoding="utf-8")), f"{page}: {link}#{anchor}"


def said() -> Iterator[tuple[str, str]]:
    """Return all texts for users, as (file, text).

    These are strings in code without docstrings, explanations, templates, and pages of examples, which users copy
    without the other pages.
    """
    for path in [*(ROOT / "koordgen").rglob("*.py"), *(ROOT / "targets").rglob("*.py")]:
        if "_generated" in path.parts or path.name == "page.py":  # which writes a page
            continue
        text = path.read_text(encoding="utf-8")
        if "koordgen " not in text and ".md" not in text:
            continue
        tree = ast.parse(text)
        notes = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in notes:
                yield str(path), node.value
    others = [(ROOT / "koordgen/lang/explain").glob("*.md"), (ROOT / "templates").rglob("*.*")]
    for path in chain(*others, (ROOT / "examples").rglob("README.md")):
        yield str(path), path.read_text(encoding="utf-8")


def test_pages_and_commands_that_messages_name_are_there() -> None:
    named = 0
    for file, text in said():
        elsewhere = re.search(r"docs/\w|\b[a-z-]+\.md\b", text)
        assert not elsewhere, f"{file}: name a page as `koordgen docs PAGE`: {text!r}"
        for page, section in re.findall(r"koordgen docs ([a-z][\w/-]*)(?:#([\w-]+))?", text):
            named += 1
            assert page in pages(), f"{file}: {page}"
            assert not section or section in sections(pages()[page].read_text(encoding="utf-8")), f"{file}: {section}"
        for command in re.findall(r"`koordgen ([a-z]+)", text):
            assert command in COMMANDS or command in harnesses(), f"{file}: {command}"
    assert named >= 8


def test_it_builds_a_program_in_a_bare_environment(wheel: Path, tmp_path: Path) -> None:
    env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv")], check=True)
    (site,) = tmp_path.glob("venv/lib/python3*/site-packages")
    for name in NEEDED:
        copied(name, site)
    pip = [sys.executable, "-m", "pip", "--python", str(tmp_path / "venv/bin/python")]
    done = subprocess.run([*pip, "install", "--no-index", str(wheel)], env=env, capture_output=True, text=True)
    assert done.returncode == 0, f"the compiler needs few packages: {done.stderr}"
    program, fleet = tmp_path / "lineform.koord", tmp_path / "fleet.yaml"
    program.write_text((ROOT / "examples/lineform/lineform.koord").read_text())
    fleet.write_text((ROOT / "examples/lineform/fleet.yaml").read_text())
    command = [str(tmp_path / "venv/bin/koordgen"), "build", str(program), "--target", "quad,car,sim"]
    done = subprocess.run([*command, "--fleet", str(fleet)], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    ours = subprocess.run(
        [sys.executable, "-m", "koordgen", *command[1:], "--fleet", str(fleet), "-o", str(tmp_path / "ours")],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert ours.returncode == 0, ours.stderr
    same = subprocess.run(["diff", "-r", "build", "ours"], cwd=tmp_path, capture_output=True, text=True)
    assert (same.returncode, same.stdout) == (0, ""), "the wheel and the checkout build the same bytes"
    ran = subprocess.run(
        [str(tmp_path / "venv/bin/koordgen"), "sim", str(program), "--fleet", str(fleet)],
        cwd=tmp_path, env=env, capture_output=True, text=True,
    )  # fmt: skip
    assert ran.returncode == 5
    assert "pybullet" in ran.stderr
    assert "koordgen[sim]" in ran.stderr

"""Examples: each has no diagnostics, builds for its fleet, is formatted, and says how to run it.

`make slow` also runs each in the simulator once.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from koordgen import cli
from koordgen.build.pipeline import check_file, check_system
from koordgen.lang.format.files import format_file
from tests.examples.stage import EXAMPLES
from tests.programs import COMPOSED

ROOT = EXAMPLES.parent
NAMES = sorted(path.name for path in EXAMPLES.iterdir() if path.is_dir())
PAGE = ROOT / "docs/examples.md"
each = pytest.mark.parametrize("name", NAMES)


def readme(name: str) -> str:
    return (EXAMPLES / name / "README.md").read_text(encoding="utf-8")


def commands(text: str) -> list[list[str]]:
    """Return the commands in the code blocks of a page."""
    blocks = re.findall(r"^```\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    return [line for line in lines if line]


ALONE = {"hello"}  # runs without a fleet file
OTHERS = {"squads": "lineform"}  # examples with a fleet file for the program of another example


def program_of(name: str) -> str:
    """Return the path of an example's program, relative to the folder of all examples."""
    of = OTHERS.get(name, name)
    return f"{of}/{of}.koord"


def test_all_fifteen_are_here() -> None:
    assert len(NAMES) == 15
    assert {name for name in NAMES if not (EXAMPLES / name / "fleet.yaml").exists()} == ALONE


@each
def test_it_checks_without_a_word(name: str) -> None:
    if name in COMPOSED:
        assert all(part.diagnostics == () for part in check_system(str(EXAMPLES / name / "fleet.yaml")).parts)
        return
    for path in (EXAMPLES / name).glob("*.koord") if name in OTHERS else [EXAMPLES / program_of(name)]:
        assert check_file(str(path)).diagnostics == ()


@each
def test_it_is_in_the_one_style(name: str) -> None:
    main = EXAMPLES / program_of(name)
    for path in [main] if name not in (*COMPOSED, *OTHERS) else sorted((EXAMPLES / name).glob("*.koord")):
        result = format_file(str(path), None, write=False)
        assert result.after == result.before


@each
def test_the_commands_of_its_readme(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`koordgen build` in it writes a bundle for each robot; `koordgen sim` uses the same files."""
    if name in ALONE:
        check, sim = commands(readme(name))
        assert check == ["koordgen", "check", f"examples/{name}/{name}.koord"]
        assert sim[:4] == ["koordgen", "sim", check[2], "--lockstep"] and "--fleet" not in sim
        return
    build, sim, *others = commands(readme(name))
    folder = f"examples/{name}"
    program = [f"examples/{program_of(name)}", "--fleet", f"{folder}/fleet.yaml"]
    if name in COMPOSED:
        program = program[2:]
    assert build[:3] == ["koordgen", "build", program[0]] and build[-2:] == ["-o", "build"]
    assert sim[: 2 + len(program)] == ["koordgen", "sim", *program]
    assert all((ROOT / word).exists() for line in others for word in line if word.startswith("examples/"))
    monkeypatch.chdir(ROOT)
    assert cli.main([*build[1:-1], str(tmp_path)]) == 0
    told = capsys.readouterr()
    assert told.err == "", "building it warns"
    _, _, listed = (EXAMPLES / name / "fleet.yaml").read_text().partition("\nrobots:")
    robots = re.findall(r"^ *- name: (\w+)$", listed, re.MULTILINE)
    if name in OTHERS:
        robots += ["alpha.ann", "beta.cleo"]
    module = "applications.py" if name in COMPOSED else "program.py"
    made = tmp_path / OTHERS.get(name, name)
    assert robots and all((made / robot / module).exists() for robot in robots)


@each
def test_its_readme_names_what_is_there(name: str) -> None:
    text = readme(name)
    assert 10 <= len(text.splitlines()) <= 30 and text.startswith("# ")
    for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        assert (EXAMPLES / name / link).exists(), link
    for file in re.findall(r"`([a-z_]+\.(?:py|koord|yaml))`", text):
        assert (EXAMPLES / name / file).exists(), file
    programs = "".join(path.read_text(encoding="utf-8") for path in (EXAMPLES / name).glob("*.koord"))
    for invariant in re.findall(r"invariant\s`(\w+)`", text):
        assert f"invariant {invariant}:" in programs, invariant


@each
def test_the_page_has_it(name: str) -> None:
    assert f"(../examples/{name}/README.md)" in PAGE.read_text(encoding="utf-8")


def test_the_page_shows_pictures_that_are_there() -> None:
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", PAGE.read_text(encoding="utf-8"))
    assert all((PAGE.parent / link).exists() for link in links), links
    assert len([link for link in links if link.endswith(".png")]) >= 2


SECONDS = {
    "atomicsum": 5, "crossing": 45, "delivery": 90, "election": 5, "follow": 15, "formation": 20, "hello": 15,
    "hvac": 10, "lineform": 15, "mapping": 60, "patrol": 20, "rendezvous": 25, "squads": 30, "survey": 240,
    "task": 120,
}  # fmt: skip
ENDS = {"atomicsum", "crossing", "delivery", "election", "hello", "mapping", "rendezvous", "survey", "task"}


@pytest.mark.slow
@each
def test_it_runs_in_the_simulator(name: str, tmp_path: Path) -> None:
    """The run holds; programs that stop do so within the given time."""
    folder = EXAMPLES / name
    command = [sys.executable, "-m", "koordgen", "sim"]
    command += [str(folder / "fleet.yaml" if name in COMPOSED else EXAMPLES / program_of(name))]
    command += [] if name in ALONE or name in COMPOSED else ["--fleet", str(folder / "fleet.yaml")]
    command += ["--duration", str(SECONDS[name]), "--seed", "3", "--lockstep"]
    command += ["--out", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{'mapping+task' if name in COMPOSED else OTHERS.get(name, name)}: HELD" in done.stdout
    assert ("all robots ended by themselves" in done.stdout) == (name in ENDS)

"""README: its commands exist, and a newcomer's first commands succeed in an empty folder."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from koordgen.cli.commands import parsed

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
STATUS = {"validate": 3}  # of commands that find something, as the README says


def commands(page: str) -> list[str]:
    """Return the lines of its code blocks that call koordgen or Python, without lines that contain `...`."""
    listings = re.findall(r"^```\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    lines = [line for listing in listings for line in listing.splitlines()]
    return [line for line in lines if line.startswith(("koordgen ", "python3 ")) and "..." not in line]


@pytest.mark.parametrize("command", [line for line in commands(README) if line.startswith("koordgen ")])
def test_a_command_can_be_called_so(command: str) -> None:
    parsed(shlex.split(command, comments=True)[1:])


def test_every_extra_is_explained() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    table = README.partition("| extra |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE)
    assert sorted(re.findall(r"`(\w+)`", " ".join(rows))) == sorted(extras)


SCREENS = 2 * 56  # lines
OURS = {"bundle", "slot", "delta", "instance", "ledger", "skip", "discard", "view", "inductive", "harness", "round"}


def test_what_is_read_first_fits_on_two_screens_and_needs_no_word_of_ours() -> None:
    first = README.partition("\n| I want to |")[0]
    assert len(first.splitlines()) <= SCREENS + 1
    prose = re.sub(r"^```.*?^```$|`[^`\n]*`|\([^)]*\)", "", first, flags=re.MULTILINE | re.DOTALL)
    assert not {word.rstrip("s") for word in re.findall(r"[a-z]+", prose.lower())} & OURS


def test_what_is_read_first_is_what_happens(tmp_path: Path) -> None:
    """The two commands, the program that they run, and the mistake."""
    first = README.partition("\n| I want to |")[0]
    hello, line = re.findall(r"^```koord\n(.*?)^```$", first, re.MULTILINE | re.DOTALL)
    assert hello == (ROOT / "examples/hello/hello.koord").read_text()
    two = commands(first.partition("## Two commands")[2].partition("\n## ")[0])
    assert len(two) == 2
    for command in two:
        done = subprocess.run(
            [sys.executable, "-m", "koordgen", *shlex.split(command)[1:]], cwd=tmp_path, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "run/report.html").exists()
    (tmp_path / "line.koord").write_text(line)
    done = subprocess.run(
        [sys.executable, "-m", "koordgen", "check", "line.koord"], cwd=tmp_path, capture_output=True, text=True
    )
    (mistake,) = re.findall(r"^```text\n(line\.koord.*?)^```$", first, re.MULTILINE | re.DOTALL)
    assert done.returncode == 1 and done.stderr.startswith(mistake)


@pytest.mark.slow
def test_the_first_hour(tmp_path: Path) -> None:
    """Runs in turn every command of the section that names existing files."""
    until = README.partition("## The first hour")[2].partition("\n## ")[0]
    followed = [line for line in commands(until) if not re.search(r"\b(APP|FILE|NAME)\b", line.partition(" #")[0])]
    assert len(followed) > 15
    python = shlex.quote(sys.executable)
    prelude = f'koordgen() {{ {python} -m koordgen "$@"; }}; python3() {{ {python} "$@"; }}; '
    for line in followed:
        done = subprocess.run(["bash", "-c", prelude + line], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == STATUS.get(line.split()[1], 0), f"{line}\n{done.stdout}{done.stderr}"

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


@pytest.mark.slow
def test_the_first_hour(tmp_path: Path) -> None:
    """Runs in turn every command before real robots that names existing files."""
    until = README.partition("## The first hour")[2].partition("## On real robots")[0]
    followed = [line for line in commands(until) if not re.search(r"\b(APP|FILE|NAME)\b", line.partition(" #")[0])]
    assert len(followed) > 15
    python = shlex.quote(sys.executable)
    prelude = f'koordgen() {{ {python} -m koordgen "$@"; }}; python3() {{ {python} "$@"; }}; '
    for line in followed:
        done = subprocess.run(["bash", "-c", prelude + line], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == STATUS.get(line.split()[1], 0), f"{line}\n{done.stdout}{done.stderr}"

"""Commands without the packages of the extras: each works, or names what is missing and how to install it."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from tests.sim.view.canned import header, moving, write

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LINEFORM = "examples/lineform/lineform.koord --fleet examples/lineform/fleet.yaml"


def name_of(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")


def modules_of_extras() -> list[str]:
    """Return the modules that only an extra installs."""
    always = {name_of(line) for line in PROJECT["dependencies"]}
    extras = {name_of(line) for lines in PROJECT["optional-dependencies"].values() for line in lines} - {"koordgen"}
    return [
        module
        for module, packages in packages_distributions().items()
        if {name.lower().replace("_", "-") for name in packages} <= extras - always
    ]


def koordgen(command: str, out: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in which the modules of extras cannot be imported."""
    code = f"import sys; sys.modules.update(dict.fromkeys({modules_of_extras()!r})); from koordgen.cli import main; "
    code += "raise SystemExit(main(sys.argv[1:]))"
    words = command.replace("OUT", str(out)).split()
    return subprocess.run(
        [sys.executable, "-c", code, *words], cwd=ROOT, capture_output=True, text=True, check=False, env={}
    )


def test_the_extras_are_known() -> None:
    assert {"numpy", "matplotlib", "z3", "distributed", "mcap"} <= set(modules_of_extras())
    assert not {"yaml", "jinja2", "msgspec"} & set(modules_of_extras())


@pytest.mark.parametrize("command", [f"build {LINEFORM} -o OUT", "explore examples/election/election.koord", "docs"])
def test_these_need_no_extra(command: str, tmp_path: Path) -> None:
    done = koordgen(command, tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("command", "missing", "extra"),
    [
        ("basestation OUT/feed.yaml --system vicon --host h --key OUT/key", "motioncapture", "mocap"),
        ("report OUT", "numpy", "sim"),
        ("export OUT --to png", "numpy", "sim"),
        ("export OUT --to mcap", "mcap", "sim"),
    ],
)  # fmt: skip
def test_these_name_what_is_missing(command: str, missing: str, extra: str, tmp_path: Path) -> None:
    fleet = (ROOT / "examples/lineform/fleet.yaml").read_text()
    (tmp_path / "feed.yaml").write_text(fleet.replace("flight_height: 1.5", "flight_height: 1.5, positioning: vision"))
    (tmp_path / "key").write_bytes(bytes(32))
    (tmp_path / "key").chmod(0o600)
    write(tmp_path / "trace.jsonl", header(["alice", "bert"]), moving([(0, 0, 0), (2, 0, 0)], [(1, 0, 0), (3, 0, 0)]))
    done = koordgen(command, tmp_path)
    assert done.returncode == 5, done.stderr
    assert missing in done.stderr and f"pip install 'koordgen[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr

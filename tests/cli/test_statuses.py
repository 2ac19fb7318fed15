"""Exit statuses have the same meaning in every command, as in the table of docs/reference/cli.md."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from koordgen.cli.base import console
from koordgen.cli.commands import COMMANDS, harnesses
from tests.cli.test_parser import left

ROOT = Path(__file__).parents[2]
APP, FLEET = "lineform.koord", "--fleet fleet.yaml"
# One or more commands for each file that a command reads; none of these files exists.
MISSING = [
    "check no.koord", "fmt no.koord", "dump no.koord", f"build no.koord {FLEET}", "prove no.koord", "explore no.koord",
    f"validate no.koord {FLEET}", f"campaign no.koord {FLEET} --runs 1", f"sim no.koord {FLEET}",
    f"build {APP} --fleet no.yaml", f"prove {APP} --fleet no.yaml", f"explore {APP} --fleet no.yaml",
    "validate geofence.koord --fleet no.yaml", f"campaign {APP} --fleet no.yaml --runs 1", f"sim {APP} --fleet no.yaml",
    "basestation no.yaml --system vicon --host h", "estop no.yaml", "status no.yaml", "status fleet.yaml --key no.key",
    "dashboard no.yaml", "dashboard fleet.yaml --key no.key",
    "start no.yaml", "stop no.yaml", "logs no.yaml", "collect no.yaml -o out", "doctor --fleet no.yaml",
    "start fleet.yaml", "stop fleet.yaml", "logs fleet.yaml", "doctor --fleet fleet.yaml",  # which names no hosts
    "report no", "show no", "export no --to csv", "replay no",
    "audit no", "doctor no", f"explore {APP} --env no.yaml", f"sim {APP} {FLEET} --scenario no.yaml",
    f"sim {APP} {FLEET} --follow no", "prove geofence.koord --attack-from no",
    f"campaign {APP} {FLEET} --runs 1 --verdict no.py", "estop fleet.yaml", "estop fleet.yaml --key no.key",
    f"deploy no.koord {FLEET}", f"deploy {APP} --fleet no.yaml", f"deploy {APP} {FLEET}", "rollback no.yaml",
    "rollback fleet.yaml", "key rotate no.yaml", "key rotate fleet.yaml",
    "basestation feed.yaml --system vicon --host h", "basestation feed.yaml --system vicon --host h --key no.key",
]  # fmt: skip
# A folder or file that cannot be written: it is below a file.
UNWRITABLE = [
    "key new fleet.yaml/fleet.key", f"build {APP} {FLEET} -o fleet.yaml/out",
    "prove geofence.koord --emit fleet.yaml/out", f"campaign {APP} {FLEET} --runs 1 --lockstep --out fleet.yaml/out",
    f"sim {APP} {FLEET} --lockstep --duration 1 --out fleet.yaml/out", "new taken",
    "examples copy election fleet.yaml/out", "collect fleet.yaml -o fleet.yaml/out", "collect fleet.yaml -o fleet.yaml",
]  # fmt: skip
USAGE = [f"{name} --no-such-option" for name in (*COMMANDS, *harnesses())] + [
    f"build {APP} --target boat", "explain K999", "help boat", "estop", "estop --address robot --key no.key",
    f"build {APP} {FLEET} --param nope=1", f"sim {APP} {FLEET} --param nope=1", f"prove {APP} --param nope=1",
    f"validate geofence.koord {FLEET} --param nope=1", "new no-name", "examples copy boat", "examples copy",
    "docs boat", "docs fleet#boat", "dashboard fleet.yaml --bind 0.0.0.0",
    "doctor", "doctor build --fleet fleet.yaml", "collect fleet.yaml",
    "rollback fleet.yaml --to before", f"deploy {APP}",
]  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(ROOT / "examples/lineform", tmp_path, dirs_exist_ok=True)
    fleet = (tmp_path / "fleet.yaml").read_text()
    (tmp_path / "feed.yaml").write_text(fleet.replace("flight_height: 1.5", "flight_height: 1.5, positioning: vision"))
    (tmp_path / "taken").write_text("")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("status", "command"),
    [(1, each) for each in MISSING] + [(2, each) for each in USAGE] + [(5, each) for each in UNWRITABLE],
)
def test_the_status_of_a_failure(status: int, command: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert left(shlex.split(command)) == status
    told = capfd.readouterr().err
    assert "error" in told and "Traceback" not in told, told


def test_every_command_is_tested() -> None:
    tested = {command.split()[0] for command in (*MISSING, *UNWRITABLE)}
    assert {*COMMANDS, *harnesses()} - tested == {"completion", "docs", "explain", "help"}, (
        "these read and write no files of the user"
    )


def test_the_table_in_the_docs_has_every_status() -> None:
    page = (
        (ROOT / "docs/reference/cli.md")
        .read_text(encoding="utf-8")
        .partition("## Exit statuses")[2]
        .partition("\n## ")[0]
    )
    listed = [int(status) for status in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)]
    assert listed == [
        console.HOLDS, console.WRONG, console.USAGE, console.VIOLATED, console.INCONCLUSIVE, console.SURROUNDINGS,
        console.HOST, console.INTERNAL, console.INTERRUPTED,
    ]  # fmt: skip

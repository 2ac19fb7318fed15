"""Build errors for fleets that could not send the program's writes, and policies of the fleet."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from koordgen.cli import main
from koordgen.runtime.config.settings import Safety, load

ROOT = Path(__file__).parents[2]
LINEFORM = ROOT / "examples/lineform/lineform.koord"
FLEET = ROOT / "examples/lineform/fleet.yaml"
PATHS = "allread: List<Point> path[N_SYS] max {}\nGo:\n  pre: True\n  eff: path[pid] = [Point(0, 0, 0)]\n"


def built(folder: Path, program: str, fleet: str) -> int:
    """Run `build` on a program for a fleet of five quads and cars, with additional lines in the fleet file."""
    (folder / "a.koord").write_text(program)
    (folder / "fleet.yaml").write_text(FLEET.read_text() + fleet)
    build = ["build", str(folder / "a.koord"), "--target", "quad,car", "--fleet", str(folder / "fleet.yaml")]
    return main([*build, "-o", str(folder / "out")])


@pytest.mark.parametrize(
    ("network", "receivers"),
    [
        ("", " x 4 receivers"),
        ("network: {transport: multicast, group: 239.255.71.1}\n", ""),
        ("network: {transport: broadcast, group: 192.168.1.255}\n", ""),
        ("network: {transport: zenoh}\n", " x 4 receivers"),
    ],
)
def test_a_round_that_the_link_does_not_carry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], network: str, receivers: str
) -> None:
    """One datagram that reaches all others is counted once."""
    link = "link: {rate: 3e6, loss: 0.2}\n" + network
    assert built(tmp_path, PATHS.format(1000), link) == 1
    told = capsys.readouterr().err
    assert f"{tmp_path}/a.koord:1:22: error[B008]: a round may send " in told
    assert f" bytes: 5 robots{receivers} x (" in told
    assert "B009" not in told and not (tmp_path / "out").exists()
    (most,) = map(int, re.findall(r"it fits with a delta of .*`max (\d+)`", told))
    assert built(tmp_path, PATHS.format(most), link) == 0
    assert built(tmp_path, PATHS.format(most + 1), link) == 1
    assert built(tmp_path, PATHS.format(1000), network) == 0, "nothing is said of the link"


def test_writes_that_need_several_datagrams_are_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert built(tmp_path, PATHS.format(100), "link: {rate: 54e6}\n") == 0
    told = capsys.readouterr().err
    assert f"{tmp_path}/a.koord:1:22: warning[B009]: the writes of an event take up to " in told
    assert (tmp_path / "out/a/alice/settings.json").exists()
    assert built(tmp_path, PATHS.format(10), "link: {rate: 54e6}\n") == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (PATHS.format(6000), "error[B004]: shared writes of one round take up to 168046 bytes"),
        (PATHS.format(4000), "error[B004]: all shared variables together take up to 560"),
        (
            f"local: string s max 2000\ninit: t = s\nallwrite: string t max 2000\n{PATHS.format(1)}",
            "writes of `init` to",
        ),
    ],
)
def test_what_no_robot_can_send(tmp_path: Path, capsys: pytest.CaptureFixture[str], program: str, words: str) -> None:
    assert built(tmp_path, program, "link: {}\n") == 1
    told = capsys.readouterr().err
    assert words in told and told.count("error[") == 1
    assert not (tmp_path / "out").exists()


def test_the_safety_of_the_fleet_file_reaches_the_robots(tmp_path: Path) -> None:
    safety = "safety: {missed_rounds: 25, missed_action: stop, peer_timeout: 6, outside_fence: 1}\n"
    assert built(tmp_path, LINEFORM.read_text(), safety) == 0
    for robot in ("alice", "bert"):
        found = load(tmp_path / "out/a" / robot / "settings.json")
        assert found.safety == Safety(missed_rounds=25, missed_action="stop", peer_timeout=6, outside_fence=1.0)

"""Deployments over real SSH servers: the whole fleet takes a release, or nothing is changed."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from tests.operate.deployed import Deployed, deployed, place

ROBOTS = {"alice": "a", "bert": "b", "cleo": "c", "dora": "c"}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployed]:
    with deployed(tmp_path_factory.mktemp("fleet"), ROBOTS) as running:
        yield running


def test_a_fleet_of_three_hosts_is_deployed_changed_and_rolled_back(
    fleet: Deployed, capfd: pytest.CaptureFixture[str]
) -> None:
    capfd.readouterr()
    assert fleet.deploy() == 0, capfd.readouterr().err
    (first,) = fleet.confirmed()
    assert f"release {first}: on 4 robots, confirmed" in capfd.readouterr().out
    for robot, host in ROBOTS.items():
        bundle = place(fleet.ssh.hosts[host]) / "current" / robot
        assert (bundle / "__main__.py").is_file()
    assert (place(fleet.ssh.hosts["c"]) / "current/cleo").is_dir()
    assert not (place(fleet.ssh.hosts["a"]) / "current/bert").exists()
    (key,) = (place(fleet.ssh.hosts["a"]) / "keys").iterdir()
    assert key.read_bytes() == fleet.key.read_bytes() and key.stat().st_mode & 0o777 == 0o600

    assert fleet.deploy("--format", "json") == 0
    document = json.loads(capfd.readouterr().out)
    assert document["release"] == first and not any(host["changed"] for host in document["hosts"])

    fleet.write(version=2)
    assert fleet.deploy("--format", "json") == 0
    document = json.loads(capfd.readouterr().out)
    assert all(host["changed"] and host["before"] == first for host in document["hosts"])
    assert fleet.confirmed() == {document["release"]} != {first}

    assert fleet.rollback("--format", "json") == 0
    document = json.loads(capfd.readouterr().out)
    assert fleet.confirmed() == {first} == {document["release"]}
    assert all(host["sent_bytes"] < 2000 for host in document["hosts"])
    print(document)

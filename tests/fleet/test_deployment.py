"""Deployment keys of the fleet file: hosts of robots, and the section `deploy`."""

from __future__ import annotations

from pathlib import Path

import pytest

from koordgen.build.pipeline import plan_file
from koordgen.fleet import manifest
from koordgen.fleet.deployment import DeploymentSettings, Login
from tests.fleet.test_fleet import GOOD, read

EXAMPLE = Path(__file__).parents[2] / "examples/lineform"
TARGETS = {name: manifest.load(name) for name in manifest.available()}


def with_host(host: str) -> str:
    return GOOD.replace("name: alice", f"name: alice\n    host: {host}", 1)


@pytest.mark.parametrize(
    ("text", "deployment"),
    [
        ("", DeploymentSettings("koordgen/fleet", "python3", "systemd", "index")),
        ("deploy: {}", DeploymentSettings()),
        ("deploy: {folder: robots/line, service: none}", DeploymentSettings("robots/line", service="none")),
        ("deploy: {folder: /srv/koordgen, python: /usr/bin/python3.11}",
         DeploymentSettings("/srv/koordgen", "/usr/bin/python3.11")),
        ("deploy: {wheels: host}", DeploymentSettings(wheels="host")),
        ("deploy: {wheels: ./my wheels}", DeploymentSettings(wheels="./my wheels")),
    ],
)  # fmt: skip
def test_the_section(text: str, deployment: DeploymentSettings) -> None:
    fleet, found = read(f"{text}\n{GOOD}")
    assert found == [] and fleet is not None and fleet.deployment == deployment


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("deploy: [a]", "F004", "deploy must be a mapping"),
        ("deploy: {foldr: a}", "F002", "did you mean 'folder'"),
        ("deploy: {folder: 3}", "F004", "deploy.folder must be a text"),
        ("deploy: {folder: ~/koordgen}", "F005", "remove `~/`"),
        ("deploy: {folder: ../koordgen}", "F005", "without `..`"),
        ("deploy: {folder: /}", "F005", "for example"),
        ("deploy: {folder: 'a b'}", "F005", "letters, digits"),
        ("deploy: {folder: '$(reboot)'}", "F005", "letters, digits"),
        ("deploy: {folder: --help}", "F005", "letters, digits"),
        ("deploy: {python: '-c'}", "F005", "for example python3.11"),
        ("deploy: {python: 'python3; reboot'}", "F005", "for example python3.11"),
        ("deploy: {service: upstart}", "F005", "possible values: systemd, none"),
        ("deploy: {wheels: pypi}", "F005", "possible values: index, host"),
    ],
)
def test_mistakes_in_the_section(text: str, code: str, words: str) -> None:
    fleet, found = read(f"{text}\n{GOOD}")
    assert fleet is None
    assert [(each[0], each[1]) for each in found] == [(code, 1)] and words in found[0][3]


@pytest.mark.parametrize(
    ("host", "login"),
    [
        ("pi@alice.local", Login("pi", "alice.local", None)),
        ("pi@192.168.1.20:2222", Login("pi", "192.168.1.20", 2222)),
        ('"pi@[fe80::1]:22"', Login("pi", "fe80::1", 22)),
    ],
)
def test_a_host(host: str, login: Login) -> None:
    fleet, found = read(with_host(host))
    assert found == [] and fleet is not None
    assert [robot.login for robot in fleet.robots[:2]] == [login, None]
    assert login.text == host.strip('"')


@pytest.mark.parametrize("host", ["alice.local", "pi@", "pi@a:0", "pi@a:65536", "-oProxyCommand=x@a", "pi@-a", "a b@c"])
def test_a_host_that_is_none(host: str) -> None:
    fleet, found = read(with_host(host))
    assert fleet is None
    assert [each[0] for each in found] == ["F005"] and "USER@NAME" in found[0][3]


def test_bundles_do_not_depend_on_these_keys(tmp_path: Path) -> None:
    program, text = EXAMPLE / "lineform.koord", (EXAMPLE / "fleet.yaml").read_text()
    changed = text.replace("name: alice", "name: alice\n    host: pi@alice.local", 1)
    changed += "\ndeploy: {folder: elsewhere, service: none, wheels: host}\n"
    assert "host:" in changed and changed != text
    bundles = []
    for name, contents in (("plain", text), ("deployed", changed)):
        path = tmp_path / f"{name}.yaml"
        path.write_text(contents)
        bundles.append(plan_file(str(program), None, str(path), {})[1])
    assert bundles[0] == bundles[1]

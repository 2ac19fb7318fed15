"""What a bundle and its computer must be like, each thing wrong in turn."""

from __future__ import annotations

import errno
import os
import platform
import shutil
import struct
import sys
import sysconfig
from collections import namedtuple
from hashlib import sha256
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import pytest

from koordgen.runtime.ops import host
from koordgen.runtime.vehicle.platform import Finding


@pytest.mark.parametrize(("bits", "cores", "state"), [(4, 4, "fail"), (8, 1, "warn"), (8, 4, "ok"), (8, None, "warn")])
def test_the_processor(monkeypatch: pytest.MonkeyPatch, bits: int, cores: int | None, state: str) -> None:
    monkeypatch.setattr(struct, "calcsize", lambda form: bits)
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert host.processor().state == state


def packages(folder: Path, requirements: str, **installed: str) -> Finding:
    (folder / "requirements.txt").write_text(requirements)

    def version(name: str) -> str:
        if name not in installed:
            raise PackageNotFoundError(name)
        return installed[name]

    return host.packages(folder, version)


def test_packages_as_they_were_tested(tmp_path: Path) -> None:
    wanted = "here==1.2.3\nlater>=1.10\n\nother==2; python_version < '3.2'\nthis==4.5; python_version >= '3.10'\n"
    found = packages(tmp_path, wanted, here="1.2.3", later="1.11.0", this="4.5")
    assert (found.state, found.found) == ("ok", "all 3 of requirements.txt are installed")


def test_a_package_for_other_computers_is_not_needed() -> None:
    here, version = platform.machine(), ".".join(platform.python_version_tuple()[:2])
    assert host.needed(f"a==1; python_version <= '{version}' and platform_machine == '{here}'") == "a"
    assert host.needed(f"a==1; python_version <= '{version}' and platform_machine == 'vax'") == ""
    assert host.needed(f"a==1; python_version < '{version}' and platform_machine == '{here}'") == ""
    with pytest.raises(ValueError, match="cannot be parsed"):
        host.needed("a==1; os_name == 'posix'")


def test_packages_that_are_missing_or_others(tmp_path: Path) -> None:
    found = packages(tmp_path, "here==1.2.3\nnever==1\nlater>=1.10\nnor==2\ngit+x\n", here="1.2.4", later="1.9")
    assert (found.state, found.found) == (
        "fail",
        "not installed: never, nor; here is 1.2.4, not 1.2.3; later is 1.9, not 1.10; 'git+x' cannot be parsed",
    )  # fmt: skip
    assert found.why.endswith(f" -m pip install -r {tmp_path / 'requirements.txt'}")
    assert packages(tmp_path, "here==1.2.3\n", here="1.2.4").state == "warn"


@pytest.fixture
def system_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Debian: a Python outside of any virtual environment, marked by its distribution (PEP 668)."""
    (tmp_path / "stdlib").mkdir()
    (tmp_path / "stdlib/EXTERNALLY-MANAGED").write_text("[externally-managed]\n")
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path / name))
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    monkeypatch.setattr(sys, "prefix", "/usr")
    monkeypatch.setattr(sys, "base_prefix", "/usr")


def test_packages_of_a_python_that_the_system_manages(tmp_path: Path, system_python: None) -> None:
    """pip refuses there, so it needs a virtual environment, and the robot's agent must be started with it."""
    folder = tmp_path / "a robot"
    folder.mkdir()
    why = packages(folder, "never==1\n").why
    venv = tmp_path / "venv"
    assert f"/usr/bin/python3 -m venv {venv} && " in why
    assert f"{venv}/bin/python -m pip install -r '{folder / 'requirements.txt'}'" in why
    assert f"start it with {venv}/bin/python" in why and "externally-managed-environment" in why
    assert not (folder / "venv").exists()


def test_a_virtual_environment_of_such_a_python(
    tmp_path: Path, system_python: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", "/home/pi/venv")
    monkeypatch.setattr(sys, "executable", "/home/pi/venv/bin/python")
    requirements = tmp_path / "requirements.txt"
    assert packages(tmp_path, "never==1\n").why == f"/home/pi/venv/bin/python -m pip install -r {requirements}"


def test_an_environment_without_pip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As uv makes it."""
    monkeypatch.setattr(host, "find_spec", lambda name: None)
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    assert host.pip_install("'koordgen[sim]'") == f"uv pip install --python {sys.executable} 'koordgen[sim]'"
    monkeypatch.setattr(shutil, "which", lambda name: None)
    command = f"{sys.executable} -m ensurepip && {sys.executable} -m pip install 'koordgen[sim]'"
    assert host.pip_install("'koordgen[sim]'") == command


def test_a_bundle_without_requirements(tmp_path: Path) -> None:
    assert host.packages(tmp_path).state == "warn"


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    texts = {"program.py": b"print(1)\n", "a/b.py": b"", "settings.json": b"{}"}
    for path, data in texts.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_bytes(data)
    sums = "".join(f"{sha256(data).hexdigest()}  {path}\n" for path, data in texts.items())
    (tmp_path / "SHA256SUMS").write_text(sums)
    return tmp_path


def test_a_whole_bundle(bundle: Path) -> None:
    (bundle / "fleet.key").write_bytes(bytes(32))  # what its user adds
    assert host.files(bundle) == Finding("files", "ok", "3 files as they were built")


def test_a_bundle_that_is_not_as_it_was_built(bundle: Path) -> None:
    (bundle / "settings.json").write_text('{"delta": 1}')
    assert (host.files(bundle).state, host.files(bundle).found) == ("warn", "settings.json is changed")
    (bundle / "program.py").write_text("print(2)\n")
    (bundle / "a/b.py").unlink()
    found = host.files(bundle)
    assert (found.state, found.found) == ("fail", "program.py is changed and 2 more")
    (bundle / "SHA256SUMS").write_bytes(b"\xff\xff")
    assert host.files(bundle).state == "warn"


def test_what_a_missing_file_is_called(bundle: Path) -> None:
    (bundle / "settings.json").unlink()
    assert (host.files(bundle).state, host.files(bundle).found) == ("fail", "settings.json is missing")


@pytest.mark.parametrize(("free", "state"), [(10**8, "ok"), (10**8 - 1, "warn")])
def test_the_disk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, free: int, state: str) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda place: usage(0, 0, free) if place == tmp_path else None)
    assert host.disk(tmp_path / "not/there/yet").state == state
    monkeypatch.setattr(os, "access", lambda *asked: False)
    assert "cannot be written" in (found := host.disk(tmp_path)).found and found.state == "fail"


def test_a_disk_that_is_gone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def broken(place: Any) -> Any:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(shutil, "disk_usage", broken)
    assert host.disk(tmp_path).state == "fail"


@pytest.mark.parametrize(("jump", "state"), [(0.0, "ok"), (0.04, "ok"), (-0.06, "warn"), (3600.0, "warn")])
def test_the_clocks(jump: float, state: str) -> None:
    now = [1000.0, 1.8e9]
    clocks = host.Clocks(lambda: now[0], lambda: now[1])
    now = [1010.0, 1.8e9 + 10.0 + jump]
    assert clocks.finding().state == state


@pytest.mark.parametrize(
    ("known", "told"),
    [(None, "steady"), (True, "steady, synchronised by NTP"), (False, "steady, not synchronised by NTP")],
)
def test_what_the_kernel_says_of_its_clock(known: bool | None, told: str) -> None:
    assert host.Clocks(lambda: 1.0, lambda: 2.0).finding(lambda: known).found == told


def test_the_kernel_is_asked_without_a_change() -> None:
    assert host.ntp() in (None, True, False)

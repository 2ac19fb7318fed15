"""Wheels for robots: which requirements apply to a host, which wheels it can use, and environments made of them."""

from __future__ import annotations

import ensurepip
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.fixtures.deployed import Deployed, deployed, place
from koordgen.cli.base import building
from koordgen.operate.wheels import CannotFetch, WheelPlatform, needed_lines, platform_of, platform_tags, wheel_set

PI = WheelPlatform("aarch64", 36, 11)


def make_wheel(folder: Path, name: str, tag: str = "py3-none-any") -> None:
    """Make a wheel of one module, as small as wheels are."""
    info = f"{name}-1.0.dist-info"
    with zipfile.ZipFile(folder / f"{name}-1.0-{tag}.whl", "w") as file:
        file.writestr(f"{name}.py", "ANSWER = 42\n")
        file.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        file.writestr(f"{info}/WHEEL", f"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: {tag}\n")
        file.writestr(f"{info}/RECORD", f"{name}.py,,\n{info}/METADATA,,\n{info}/WHEEL,,\n{info}/RECORD,,\n")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of wheels, and a cache of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    (pip,) = Path(ensurepip.__file__).parent.glob("_bundled/pip-*.whl")
    shutil.copy(pip, wheels)
    return wheels


def test_lines_are_chosen_for_the_host() -> None:
    text = (
        "a==1.0\nb==2.0; python_version < '3.11'\nb==3.0; python_version >= '3.11'\n"
        "c==1; python_version < '3.14' and platform_machine == 'x86_64'\n"
    )
    assert needed_lines(text, PI) == ["a==1.0", "b==3.0"]
    assert needed_lines(text, WheelPlatform("x86_64", 31, 10)) == ["a==1.0", "b==2.0", "c==1"]
    with pytest.raises(CannotFetch, match="cannot be parsed"):
        needed_lines("git+https://example.com/a\n", PI)


def test_tags_go_from_the_newest_library_to_the_oldest() -> None:
    tags = platform_tags(PI)
    assert tags[0] == "manylinux_2_36_aarch64" and "manylinux_2_17_aarch64" in tags and "manylinux2014_aarch64" in tags
    assert "manylinux_2_16_aarch64" not in tags and not any("x86" in tag for tag in tags)
    assert platform_tags(WheelPlatform("x86_64", None, 11))[0] == "musllinux_1_2_x86_64"


@pytest.mark.parametrize(
    ("machine", "python", "words"),
    [("armv7l", [3, 11, 2], "armv7l"), ("aarch64", [3, 9, 2], "3.9"), ("aarch64", [3, 15, 0], "3.15")],
)
def test_hosts_on_which_no_agent_runs(machine: str, python: list[int], words: str) -> None:
    with pytest.raises(CannotFetch, match=words):
        platform_of({"machine": machine, "libc": ["glibc", "2.36"], "python": python})


def test_a_host_is_told_by_its_inspection() -> None:
    inspected = {"machine": "aarch64", "libc": ["glibc", "2.36"], "python": [3, 11, 2]}
    assert platform_of(inspected) == PI
    assert platform_of({**inspected, "libc": ["musl", ""]}) == WheelPlatform("aarch64", None, 11)


def test_a_set_of_a_folder(folder: Path) -> None:
    make_wheel(folder, "tiny")
    make_wheel(folder, "other")
    found = wheel_set("tiny==1.0\n", PI, folder)
    assert sorted(name.partition("-")[0] for name in found.files) == ["pip", "tiny"]
    assert found.requirements == "tiny==1.0\n" and set(found.digests) == set(found.files)
    assert wheel_set("tiny==1.0\n", PI, folder) == found
    assert wheel_set("other==1.0\n", PI, folder).venv != found.venv


def test_a_wheel_for_another_processor_is_none(folder: Path) -> None:
    make_wheel(folder, "tiny", "cp311-cp311-manylinux_2_17_x86_64")
    with pytest.raises(CannotFetch, match=r"no wheel of tiny==1.0 in .*aarch64, glibc 2.36, Python 3.11"):
        wheel_set("tiny==1.0\n", PI, folder)
    assert wheel_set("tiny==1.0\n", WheelPlatform("x86_64", 31, 11), folder).files


def test_a_folder_without_pip(folder: Path) -> None:
    make_wheel(folder, "tiny")
    next(folder.glob("pip-*")).unlink()
    with pytest.raises(CannotFetch, match="no wheel of pip"):
        wheel_set("tiny==1.0\n", PI, folder)


def test_a_folder_that_is_not_there(folder: Path) -> None:
    with pytest.raises(CannotFetch, match="no such folder"):
        wheel_set("tiny==1.0\n", PI, folder / "none")


@pytest.fixture
def fleet(folder: Path) -> Iterator[Deployed]:
    with deployed(folder.parent, {"alice": "a", "bert": "a"}) as running:
        yield running


@pytest.mark.slow
def test_an_environment_is_made_of_wheels_once(
    fleet: Deployed, folder: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    make_wheel(folder, "tiny")
    monkeypatch.setattr(building, "planned", lambda *_, **__: fleet.planned(requirements="tiny==1.0\n", needs="tiny"))
    fleet.write(version=1, wheels="host")
    assert fleet.deploy() == 1  # the test's own Python lacks it
    assert "No module named 'tiny'" in capfd.readouterr().err
    fleet.write(version=1, wheels="./wheels")
    assert fleet.deploy() == 0, capfd.readouterr().err
    host = fleet.ssh.hosts["a"]
    (venv,) = (place(host) / "venvs").iterdir()
    made = venv.stat().st_ctime_ns
    (name,) = fleet.confirmed()
    assert name is not None
    fleet.write(version=2, wheels="./wheels")
    assert fleet.deploy() == 0
    assert list((place(host) / "venvs").iterdir()) == [venv] and venv.stat().st_ctime_ns == made

"""Package check before a simulation: only packages for this Python count, and one physics engine is enough."""

from __future__ import annotations

import importlib.metadata
import platform
import sys

import pytest

from koordgen.cli.base import building, console

EVERYWHERE = {"casadi", "matplotlib", "mcap", "msgspec", "numpy", "pillow", "pymavlink", "pyserial"}


@pytest.mark.parametrize(
    ("version", "machine", "installed", "missing"),
    [
        ((3, 11), "x86_64", {"ompl", "pybullet"}, ""),
        ((3, 11), "x86_64", {"ompl", "mujoco-core"}, ""),
        ((3, 11), "x86_64", {"ompl"}, "pybullet or mujoco-core"),
        ((3, 13), "x86_64", {"ompl"}, "pybullet or mujoco-core"),
        ((3, 13), "aarch64", {"ompl", "mujoco-core"}, ""),
        ((3, 13), "aarch64", {"mujoco-core"}, "ompl"),
        ((3, 14), "x86_64", {"mujoco-core"}, ""),
    ],
)  # fmt: skip
def test_packages_that_are_missing(
    version: tuple[int, int], machine: str, installed: set[str], missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found(name: str) -> str:
        if name not in EVERYWHERE | installed:
            raise importlib.metadata.PackageNotFoundError(name)
        return "1"

    told = ""
    with monkeypatch.context() as there:
        there.setattr(importlib.metadata, "version", found)
        there.setattr(sys, "version_info", version)
        there.setattr(platform, "machine", lambda: machine)
        try:
            building.require_packages()
        except console.Failure as failure:
            told = str(failure)
    assert told == (f"packages are missing: {missing}" if missing else "")

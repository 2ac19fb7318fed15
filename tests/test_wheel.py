"""The wheel works outside the checkout: built, installed in a bare environment elsewhere, it builds a program."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


NEEDED = ("jinja2", "markupsafe", "pyyaml", "shtab")  # of other people's packages


def copied(name: str, site: Path) -> None:
    """The package as it is installed here: no index is asked, which may be far away."""
    distribution = metadata.distribution(name)
    for file in distribution.files or ():
        if ".." not in file.parts:  # as scripts are
            (site / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(str(distribution.locate_file(file)), site / file)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built without isolation: the build backend is among the locked packages."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)],
        check=True, capture_output=True,
    )  # fmt: skip
    return next(folder.glob("koordgen-*.whl"))


def test_it_carries_templates_targets_runtime_and_explanations(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {
        "koordgen/_data/templates/program.py.j2",
        "koordgen/_data/targets/quad/manifest.toml",
        "koordgen/_data/targets/quad/platform.py",
        "koordgen/_data/targets/car/solver/mpc.c",
        "koordgen/_data/targets/sim/harness.py",
        "koordgen/_data/targets/__init__.py",
        "koordgen/runtime/agent.py",
        "koordgen/runtime/courier.c",
        "koordgen/runtime/gate.c",
        "koordgen/runtime/blake2s.h",
        "koordgen/runtime/ledger.h",
        "koordgen/runtime/mac.h",
        "koordgen/runtime/voice.h",
        "koordgen/_generated/grammar.py",
        "koordgen/explain/K.md",
        "koordgen/explain/F.md",
        "koordgen/explain/B.md",
        "koordgen/explain/topics.md",
    } <= names
    assert not [n for n in names if n.startswith(("tests/", "benchmarks/")) or n.endswith(".pyc")]


def test_it_builds_a_program_in_a_bare_environment(wheel: Path, tmp_path: Path) -> None:
    env = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv")], check=True)
    (site,) = tmp_path.glob("venv/lib/python3*/site-packages")
    for name in NEEDED:
        copied(name, site)
    pip = [sys.executable, "-m", "pip", "--python", str(tmp_path / "venv/bin/python")]
    done = subprocess.run([*pip, "install", "--no-index", str(wheel)], env=env, capture_output=True, text=True)
    assert done.returncode == 0, f"the compiler needs few packages: {done.stderr}"
    program, fleet = tmp_path / "lineform.koord", tmp_path / "fleet.yaml"
    program.write_text((ROOT / "examples/lineform/lineform.koord").read_text())
    fleet.write_text((ROOT / "examples/lineform/fleet.yaml").read_text())
    command = [str(tmp_path / "venv/bin/koordgen"), "build", str(program), "--target", "quad,car,sim"]
    done = subprocess.run([*command, "--fleet", str(fleet)], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    ours = subprocess.run(
        [sys.executable, "-m", "koordgen", *command[1:], "--fleet", str(fleet), "-o", str(tmp_path / "ours")],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert ours.returncode == 0, ours.stderr
    same = subprocess.run(["diff", "-r", "build", "ours"], cwd=tmp_path, capture_output=True, text=True)
    assert (same.returncode, same.stdout) == (0, ""), "the wheel and the checkout build the same bytes"
    ran = subprocess.run(
        [str(tmp_path / "venv/bin/koordgen"), "sim", str(program), "--fleet", str(fleet)],
        cwd=tmp_path, env=env, capture_output=True, text=True,
    )  # fmt: skip
    assert ran.returncode == 5
    assert "pybullet" in ran.stderr
    assert "koordgen[sim]" in ran.stderr

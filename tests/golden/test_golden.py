"""Golden files of generated bundles. `python -m tests.golden.test_golden` writes them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from koordgen.fleet import file as fleet
from koordgen.fleet import manifest
from koordgen.lang import resources
from koordgen.build.bundle.plan import Files, plan, read_ingredients
from koordgen.build.pipeline import check_file
from koordgen.lang.source import Source

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PROGRAMS = {
    "lineform": (ROOT / "examples/lineform/lineform.koord", ROOT / "examples/lineform/fleet.yaml"),
    "kitchen": (HERE / "kitchen/kitchen.koord", ROOT / "examples/lineform/fleet.yaml"),
}


def bundles(name: str) -> dict[str, Files]:
    """Return all bundles of a program: two robots, the fleet's facts, the harness."""
    program, fleet_file = PROGRAMS[name]
    targets = {n: manifest.load(n) for n in manifest.available()}
    source = Source(str(fleet_file), fleet_file.read_text())
    read = fleet.read(source, targets, {}, lambda *told: pytest.fail(str(told)))
    checked = check_file(str(program)).program
    ingredients = read_ingredients(checked, program.read_bytes(), tuple(targets.values()), read, resources.package())
    found = plan(ingredients, list(targets))
    return {n: found[n] for n in ("alice", "bert", "fleet", "sim")}


def readable(name: str) -> dict[str, bytes]:
    """Return the files that differ between programs, and a list of all files."""
    code = ("__main__.py", "program.py", "properties.py", "source/params.json")
    generated = (*code, "README.md", "requirements.txt", "settings.json", "scenario.json", "fleet.json")
    files: dict[str, bytes] = {}
    for bundle, contents in bundles(name).items():
        files[f"{bundle}/FILES"] = "".join(f"{path}\n" for path in sorted(contents)).encode()
        files.update({f"{bundle}/{path}": contents[path] for path in generated if path in contents})
    if name != "lineform":  # the rest is the same but for names
        files = {p: data for p, data in files.items() if p.endswith(("alice/program.py", "sim/properties.py"))}
    return files


@pytest.mark.parametrize("name", PROGRAMS)
def test_generated_files(name: str) -> None:
    wanted = readable(name)
    folder = HERE / name
    standing = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    standing = {p: data for p, data in standing.items() if "__pycache__" not in p and not p.endswith(".koord")}
    assert sorted(standing) == sorted(wanted), "python -m tests.golden.test_golden"
    for path, data in wanted.items():
        assert standing[path].decode() == data.decode(), f"{path}; python -m tests.golden.test_golden writes it anew"


@pytest.mark.parametrize("name", PROGRAMS)
def test_generated_bundles_are_strictly_typed(name: str, tmp_path: Path) -> None:
    built = bundles(name)
    for path, data in {**built["sim"], **built["alice"]}.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(data)
    generated = [name for name in ("program.py", "properties.py") if (tmp_path / name).is_file()]
    # The copied files are checked where they come from, by the same rules; here they give the types.
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), *generated],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


if __name__ == "__main__":
    for program in PROGRAMS:
        for path, data in readable(program).items():
            (HERE / program / path).parent.mkdir(parents=True, exist_ok=True)
            (HERE / program / path).write_bytes(data)

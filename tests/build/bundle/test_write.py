"""Writing of bundles: all or none, and never over the user's files."""

from __future__ import annotations

import py_compile
import subprocess
from pathlib import Path

import pytest

from koordgen.build.bundle.write import SUMS, CannotWrite, Foreign, sums, write


def bundle(**files: str) -> dict[str, bytes]:
    contents = {name.replace("__", "/"): text.encode() for name, text in files.items()}
    return {**contents, SUMS: sums(contents)}


def test_writes_and_replaces_its_own(tmp_path: Path) -> None:
    write({"alice": bundle(a="1", b__c="2")}, tmp_path)
    write({"alice": bundle(a="new"), "bert": bundle(z="3")}, tmp_path)
    assert (tmp_path / "alice/a").read_text() == "new"
    assert not (tmp_path / "alice/b").exists()
    assert (tmp_path / "bert/z").read_text() == "3"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["alice", "bert"]


def test_sums_are_what_sha256sum_checks(tmp_path: Path) -> None:
    write({"alice": bundle(a="1", b__c="2")}, tmp_path)
    subprocess.run(["sha256sum", "--quiet", "-c", SUMS], cwd=tmp_path / "alice", check=True)


def test_leaves_other_bundles_alone(tmp_path: Path) -> None:
    write({"quad": bundle(a="1")}, tmp_path)
    write({"car": bundle(a="2")}, tmp_path)
    assert (tmp_path / "quad/a").read_text() == "1"


def code(text: str) -> dict[str, bytes]:
    contents = {"a.py": text.encode(), "in/b.py": b"3"}
    return {**contents, SUMS: sums(contents)}


def test_byte_code_is_no_obstacle(tmp_path: Path) -> None:
    write({"alice": code("1")}, tmp_path)
    for program in ("a.py", "in/b.py"):
        py_compile.compile(str(tmp_path / "alice" / program), quiet=0)
    assert len(list(tmp_path.rglob("*.pyc"))) == 2
    write({"alice": code("2")}, tmp_path)
    assert (tmp_path / "alice/a.py").read_text() == "2"


@pytest.mark.parametrize(
    "path",
    [
        "alice/notes.txt", "alice/fleet.key", "alice/in/notes.txt", "alice/__pycache__/notes.txt",
        "alice/__pycache__/other.cpython-311.pyc", "alice/in/__pycache__/a.cpython-311.pyc",
        "alice/own/__pycache__/x.pyc",
    ],
)  # fmt: skip
def test_refuses_to_replace_what_the_user_put_there(tmp_path: Path, path: str) -> None:
    write({"alice": code("1"), "bert": bundle(a="1")}, tmp_path)
    (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / path).write_text("mine")
    with pytest.raises(Foreign, match=Path(path).name):
        write({"bert": bundle(a="2"), "alice": bundle(a="2")}, tmp_path)
    assert (tmp_path / path).read_text() == "mine"
    assert (tmp_path / "bert/a").read_text() == "1", "all or nothing"


def test_refuses_to_replace_what_the_user_changed(tmp_path: Path) -> None:
    write({"alice": bundle(a="1")}, tmp_path)
    (tmp_path / "alice/a").write_text("my tuning")
    with pytest.raises(Foreign, match="changed since"):
        write({"alice": bundle(a="2")}, tmp_path)
    assert (tmp_path / "alice/a").read_text() == "my tuning"


def test_refuses_a_folder_of_somebody_elses_and_a_link(tmp_path: Path) -> None:
    (tmp_path / "alice").mkdir()
    (tmp_path / "alice/thesis.tex").write_text("years")
    with pytest.raises(Foreign):
        write({"alice": bundle(a="1")}, tmp_path)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "bert").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(Foreign):
        write({"bert": bundle(a="1")}, tmp_path)


@pytest.mark.parametrize("path", ["alice/data", "alice/in/data", "alice/in/data/more"])
def test_refuses_to_replace_an_empty_folder_of_the_users(tmp_path: Path, path: str) -> None:
    write({"alice": code("1")}, tmp_path)
    (tmp_path / path).mkdir(parents=True)
    with pytest.raises(Foreign, match="data"):
        write({"alice": code("2")}, tmp_path)
    assert (tmp_path / path).is_dir()
    assert (tmp_path / "alice/a.py").read_text() == "1"


def test_refuses_to_replace_a_link_to_a_folder(tmp_path: Path) -> None:
    write({"alice": code("1")}, tmp_path)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "alice/in/logs").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(Foreign, match="logs"):
        write({"alice": code("2")}, tmp_path)


@pytest.mark.parametrize("head", [b"", b"# sums of my data\n"])
def test_refuses_a_folder_with_sums_of_the_users(tmp_path: Path, head: bytes) -> None:
    (tmp_path / "alice").mkdir()
    (tmp_path / "alice/data.csv").write_text("years")
    summed = subprocess.run(["sha256sum", "data.csv"], cwd=tmp_path / "alice", check=True, capture_output=True)
    (tmp_path / "alice" / SUMS).write_bytes(head + summed.stdout)
    with pytest.raises(Foreign, match="not written by koordgen"):
        write({"alice": bundle(a="1")}, tmp_path)
    assert (tmp_path / "alice/data.csv").read_text() == "years"


def dead() -> int:
    """Return the id of a process that has ended."""
    with subprocess.Popen(["true"]) as process:
        process.wait()
        return process.pid


def test_what_a_killed_build_left_is_swept(tmp_path: Path) -> None:
    write({"alice": bundle(a="1")}, tmp_path)
    killed = tmp_path / f".building-{dead()}"
    (killed / "new/bert").mkdir(parents=True)
    (killed / "new/bert/half").write_text("x")
    write({"bert": bundle(a="1")}, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["alice", "bert"]


def test_an_old_bundle_comes_back_from_a_build_that_was_killed_amid_its_renames(tmp_path: Path) -> None:
    write({"alice": bundle(a="1")}, tmp_path)
    killed = tmp_path / f".building-{dead()}"
    (killed / "old").mkdir(parents=True)
    (tmp_path / "alice").rename(killed / "old/alice")
    write({"bert": bundle(a="1")}, tmp_path)
    assert (tmp_path / "alice/a").read_text() == "1"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["alice", "bert"]


def test_a_build_that_runs_is_left_alone(tmp_path: Path) -> None:
    with subprocess.Popen(["sleep", "60"]) as process:
        running = tmp_path / f".building-{process.pid}"
        (running / "new/alice").mkdir(parents=True)
        write({"bert": bundle(a="1")}, tmp_path)
        assert (running / "new/alice").is_dir()
        process.kill()


def test_a_file_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(CannotWrite, match="out"):
        write({"alice": bundle(a="1")}, tmp_path / "out")


def test_a_failed_rename_undoes_those_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write({"alice": bundle(a="1"), "bert": bundle(a="1")}, tmp_path)
    path_rename = Path.rename

    def rename(self: Path, target: Path) -> Path:
        if self.name == "bert" and self.parent.name == "new":
            raise OSError(28, "No space left on device", str(target))
        return path_rename(self, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(CannotWrite, match="No space left"):
        write({"alice": bundle(a="2"), "bert": bundle(a="2")}, tmp_path)
    monkeypatch.undo()
    assert (tmp_path / "alice/a").read_text() == "1"
    assert (tmp_path / "bert/a").read_text() == "1"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["alice", "bert"]


def test_an_unchanged_bundle_is_left_as_it_stands(tmp_path: Path) -> None:
    write({"alice": bundle(a="1"), "bert": bundle(a="1")}, tmp_path)
    before = {name: (tmp_path / name).stat().st_ino for name in ("alice", "bert")}
    write({"alice": bundle(a="1"), "bert": bundle(a="2")}, tmp_path)
    after = {name: (tmp_path / name).stat().st_ino for name in ("alice", "bert")}
    assert before["alice"] == after["alice"]
    assert before["bert"] != after["bert"]


def test_a_bundle_that_lost_a_file_is_made_whole(tmp_path: Path) -> None:
    write({"alice": bundle(a="1", b="2")}, tmp_path)
    (tmp_path / "alice/b").unlink()
    write({"alice": bundle(a="1", b="2")}, tmp_path)
    assert (tmp_path / "alice/b").read_text() == "2"

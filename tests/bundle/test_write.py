"""Writing bundles: all or nothing, and never over what is not ours."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from koordgen.bundle.write import SUMS, CannotWrite, Foreign, sums, write


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


def test_byte_code_is_no_obstacle(tmp_path: Path) -> None:
    write({"alice": bundle(a="1")}, tmp_path)
    (tmp_path / "alice/__pycache__").mkdir()
    (tmp_path / "alice/__pycache__/a.pyc").write_bytes(b"x")
    write({"alice": bundle(a="2")}, tmp_path)
    assert (tmp_path / "alice/a").read_text() == "2"


@pytest.mark.parametrize("path", ["alice/notes.txt", "alice/fleet.key"])
def test_refuses_to_replace_what_the_user_put_there(tmp_path: Path, path: str) -> None:
    write({"alice": bundle(a="1"), "bert": bundle(a="1")}, tmp_path)
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

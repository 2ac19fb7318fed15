"""Command line on real files: exit statuses, messages with a place and a help text, no half-written files."""

from __future__ import annotations

import filecmp
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.cli import main
from koordgen.lang.diagnostics import CATALOGUE
from koordgen.runtime.program import runner
from tests.disk import small_disk

ROOT = Path(__file__).parents[2]
LINEFORM = ROOT / "examples/lineform/lineform.koord"
FLEET = ROOT / "examples/lineform/fleet.yaml"


def koordgen(*arguments: object, **env: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "koordgen", *map(str, arguments)],
        capture_output=True, text=True, cwd=ROOT, env={**os.environ, **env},
    )  # fmt: skip


@pytest.fixture
def printed(tmp_path: Path) -> Path:
    """LineForm as published: its guard lacks the `not`."""
    path = tmp_path / "lineform.koord"
    path.write_text(LINEFORM.read_text().replace("pre: not (pid", "pre: (pid"))
    return path


def test_check_passes_the_corrected_program(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(LINEFORM)]) == 0
    assert capsys.readouterr() == ("", "")


def test_check_refuses_lineform_as_printed(printed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(printed)]) == 1
    told = capsys.readouterr().err
    assert "x[pid + 1]" in told
    assert "N_SYS - 1" in told
    assert "not (" in told, "the fix is named"
    line = next(i for i, text in enumerate(printed.read_text().splitlines(), 1) if "x[pid + 1]" in text)
    assert f"lineform.koord:{line}:" in told


def test_check_json(printed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "--format", "json", str(printed)]) == 1
    found = json.loads(capsys.readouterr().out)["diagnostics"]
    assert found
    keys = {"code", "severity", "message", "file", "line", "column", "end_line", "end_column", "help"}
    assert all(set(d) == keys and d["file"] == str(printed) for d in found)


WARNED = LINEFORM.read_text() + "Never:\n  pre: pid < 0\n  eff: pass\n"


@pytest.mark.parametrize("format", ["json", "sarif"])
def test_standard_output_is_one_document_also_of_a_build_that_passes(format: str, tmp_path: Path) -> None:
    path = tmp_path / "a.koord"
    path.write_text(WARNED)
    out = tmp_path / "out"
    done = koordgen("build", path, "--target", "quad", "-o", out, "--format", format)
    assert done.returncode == 0
    document = json.loads(done.stdout)
    found = document["diagnostics"] if format == "json" else document["runs"][0]["results"]
    assert [d["ruleId" if format == "sarif" else "code"] for d in found] == ["K041"]
    assert str(out / "a/quad") in done.stderr


def test_explain_lists_all_codes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain"]) == 0
    *codes, words = capsys.readouterr().out.splitlines()
    assert codes == [f"{code}  {title}" for code, title in CATALOGUE.items()]
    assert words.startswith("other topics: PROVED, NOT INDUCTIVE, ") and words.endswith(", skip")


@pytest.mark.parametrize("words", ["NOT INDUCTIVE", "not inductive", "VACUOUS", "skip", "not current", "SKIP"])
def test_explain_a_word_of_a_report(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", words]) == 0
    told = capsys.readouterr().out
    assert main(["explain", *words.split()]) == 0
    assert capsys.readouterr().out == told
    assert "More: `koordgen docs " in told and max(map(len, told.splitlines())) <= 80


def test_every_reason_to_skip_has_one_name_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "skip"]) == 0
    assert tuple(re.findall(r"^- `(.*?)`:", capsys.readouterr().out, re.MULTILINE)) == runner.NAMES
    page = (
        (ROOT / "docs/reference/cli.md")
        .read_text(encoding="utf-8")
        .partition("### Skipped rounds")[2]
        .partition("\n### ")[0]
    )
    assert tuple(re.findall(r"^\| `(.*?)` \|", page, re.MULTILINE)) == runner.NAMES


@pytest.mark.parametrize("code", ["K030", "k030"])
def test_explain_a_code(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", code]) == 0
    told = capsys.readouterr().out
    assert told.startswith("K030: index names no robot\n\n")
    assert "\n    TargetUpdate:\n" in told
    assert "```" not in told


@pytest.mark.parametrize(
    ("code", "words"),
    [("K30", "did you mean K030?"), ("wing", "lists all codes"), ("NOT INDUCTIV", "did you mean NOT INDUCTIVE?")],
)
def test_explain_an_unknown_code(code: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", code]) == 2
    told = capsys.readouterr()
    assert words in told.err
    assert told.out == ""


@pytest.mark.parametrize("after", ["parse", "check"])
def test_dump(after: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dump", str(LINEFORM), "--after", after]) == 0
    assert "TargetUpdate" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "No such file"),
        (b"\xff\xfe", "not UTF-8"),
        (b"", "error"),
        (b"using Motion\n", "error"),
        (b"\0", "error"),
    ],
)
def test_unusable_programs(
    tmp_path: Path, content: bytes | None, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.koord"
    if content is not None:
        path.write_bytes(content)
    assert main(["check", str(path)]) == 1
    told = capsys.readouterr().err
    assert words in told
    assert str(path) in told
    assert "Traceback" not in told


def test_a_directory_and_an_unreadable_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(tmp_path)]) == 1
    assert "directory" in capsys.readouterr().err


def test_usage() -> None:
    for arguments in ([], ["fly"], ["check"], ["build", str(LINEFORM)], ["check", str(LINEFORM), "--format", "xml"]):
        assert koordgen(*arguments).returncode == 2, arguments


def test_unknown_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build", str(LINEFORM), "--target", "boat", "-o", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "no target 'boat'" in told
    assert "car, quad" in told
    assert list(tmp_path.iterdir()) == []


def test_build_without_a_fleet(tmp_path: Path) -> None:
    assert main(["build", str(LINEFORM), "--target", "quad,car,sim", "-o", str(tmp_path)]) == 0
    assert sorted(p.name for p in (tmp_path / "lineform").iterdir()) == ["car", "quad", "sim"]
    run = subprocess.run([sys.executable, str(tmp_path / "lineform/quad")], capture_output=True, text=True)
    assert run.returncode == 1
    assert "--fleet" in run.stderr


def test_build_with_a_fleet_holds_the_same_bytes_under_sim(tmp_path: Path) -> None:
    command = ["build", str(LINEFORM), "--target", "quad,car,sim", "--fleet", str(FLEET), "-o", str(tmp_path)]
    assert main(command) == 0
    app = tmp_path / "lineform"
    robots = ["alice", "bert", "cleo", "dora", "emil"]
    assert sorted(p.name for p in app.iterdir()) == sorted([*robots, "fleet", "sim"])
    for robot in robots:
        files = sorted(str(p.relative_to(app / robot)) for p in (app / robot).rglob("*") if p.is_file())
        match, mismatch, errors = filecmp.cmpfiles(app / robot, app / "sim/agents" / robot, files, shallow=False)
        assert match == files
        assert not mismatch + errors
        subprocess.run(["sha256sum", "--quiet", "-c", "SHA256SUMS"], cwd=app / robot, check=True)


def test_a_build_for_a_fleet_needs_no_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build", str(LINEFORM), "--fleet", str(FLEET), "-o", str(tmp_path)]) == 0
    robots = ["alice", "bert", "cleo", "dora", "emil"]
    assert sorted(p.name for p in (tmp_path / "lineform").iterdir()) == [*robots, "fleet"]
    assert capsys.readouterr().err == ""


def test_a_target_that_leaves_robots_out_says_which(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["build", str(LINEFORM), "--fleet", str(FLEET), "-o", str(tmp_path), "--target"]
    assert main([*command, "quad"]) == 0
    assert "note: --target quad leaves out bert, dora; " in capsys.readouterr().err
    assert main([*command, "sim"]) == 0
    assert capsys.readouterr().err == ""


def test_a_build_without_fleet_and_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build", str(LINEFORM), "-o", str(tmp_path)]) == 2
    assert "neither --fleet nor --target" in capsys.readouterr().err


def test_an_insecure_fleet_needs_no_key(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(FLEET.read_text() + "\ninsecure: true\n")
    assert main(["build", str(LINEFORM), "--target", "quad", "--fleet", str(fleet), "-o", str(tmp_path)]) == 0
    alice = tmp_path / "lineform/alice"
    assert "key" not in (alice / "README.md").read_text()
    settings = json.loads((alice / "settings.json").read_text())
    assert (settings["key_file"], settings["insecure"]) == (None, True)


def test_two_builds_are_the_same_bytes_whatever_the_hash_seed(tmp_path: Path) -> None:
    for seed in ("1", "2"):
        out = tmp_path / seed
        done = koordgen("build", LINEFORM, "--target", "quad,car,sim", "--fleet", FLEET, "-o", out, PYTHONHASHSEED=seed)
        assert done.returncode == 0, done.stderr
    one, two = ({p.relative_to(tmp_path / s): p.read_bytes() for p in (tmp_path / s).rglob("*") if p.is_file()}
                for s in "12")  # fmt: skip
    assert one == two


def test_a_fleet_file_with_mistakes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(FLEET.read_text().replace("name: bert", "name: alice").replace("delta:", "dleta:"))
    command = ["build", str(LINEFORM), "--target", "quad", "--fleet", str(fleet), "-o", str(tmp_path / "out")]
    assert main(command) == 1
    told = capsys.readouterr().err
    assert f"{fleet}:3:1: error[F002]" in told
    assert "already robot 0's" in told
    assert told.endswith("2 errors; `koordgen explain F002` tells more\n")
    assert told.count("koordgen explain") == 1
    assert not (tmp_path / "out").exists()


def test_a_port_that_the_target_does_not_offer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.koord"
    path.write_text(LINEFORM.read_text().replace("Point position", "Point position\n    float altitude"))
    assert main(["build", str(path), "--target", "quad,car", "-o", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert "target car offers no sensor Motion.altitude" in told
    assert "target quad offers no sensor Motion.altitude" in told
    assert "a.koord:5:" in told


PARAMS = "param float margin = 0.5\nparam int laps = 3\nparam Point home = Point(0, 0, 1)\n"


def test_params_go_into_the_program_and_its_hash(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.koord"
    path.write_text(PARAMS + LINEFORM.read_text())
    texts = []
    for value in ("0.5", "0.8"):
        out = tmp_path / value
        given = ["--param", f"margin={value}", "--param", "laps=-4", "--param", "home=1,2,-3"]
        assert main(["build", str(path), "--target", "quad", "-o", str(out), *given]) == 0
        texts.append((out / "a/quad/program.py").read_text())
    assert "PARAM_MARGIN: float = 0.8  # line 1" in texts[1]
    assert "PARAM_LAPS: int = -4  # line 2" in texts[1]
    assert "PARAM_HOME: Point = Point(1.0, 2.0, -3.0)  # line 3" in texts[1]
    hashes = [next(line for line in text.splitlines() if "program_hash=" in line) for text in texts]
    assert hashes[0] != hashes[1]


@pytest.mark.parametrize("param", ["margin", "mragin=1", "margin=fast", "laps=0.5", "home=1,2", "margin=nan"])
def test_wrong_params(tmp_path: Path, param: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.koord"
    path.write_text(PARAMS + LINEFORM.read_text())
    assert main(["build", str(path), "--target", "quad", "-o", str(tmp_path / "out"), "--param", param]) == 2
    assert param.partition("=")[0] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_output_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["build", str(LINEFORM), "--target", "quad", "-o", str(tmp_path / "file")]) == 5
    assert str(tmp_path / "file") in capsys.readouterr().err


def test_an_output_that_is_not_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["build", str(LINEFORM), "--target", "quad", "-o", str(tmp_path)]
    assert main(command) == 0
    key = tmp_path / "lineform/quad/fleet.key"
    key.write_bytes(b"k" * 32)
    assert main(command) == 5
    assert "fleet.key" in capsys.readouterr().err
    assert key.read_bytes() == b"k" * 32


def test_key_new(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fleet.key"
    assert main(["key", "new", str(path)]) == 0
    assert path.stat().st_mode & 0o777 == 0o600
    key = path.read_bytes()
    assert len(key) == 32
    assert key.hex() not in "".join(capsys.readouterr())
    assert main(["key", "new", str(path)]) == 5
    assert path.read_bytes() == key


def test_a_key_that_does_not_get_to_the_disk_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(28, os.strerror(28))

    path = tmp_path / "fleet.key"
    monkeypatch.setattr("os.fsync", full)
    assert main(["key", "new", str(path)]) == 5
    assert capsys.readouterr().err == f"error: {path}: No space left on device\n"
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    assert main(["key", "new", str(path)]) == 0


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path / "small", "64k") as disk:
        yield disk


def test_a_full_disk(full_disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build", str(LINEFORM), "--target", "quad,car", "-o", str(full_disk)]) == 5
    assert "No space left" in capsys.readouterr().err
    assert list((full_disk / "lineform").iterdir()) == [] if (full_disk / "lineform").exists() else True


def test_a_key_on_a_full_disk_leaves_nothing(full_disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, other = full_disk / "fleet.key", full_disk / "other"
    with other.open("wb", buffering=0) as file, pytest.raises(OSError):
        while True:
            file.write(bytes(4096))
    assert main(["key", "new", str(path)]) == 5
    assert "No space left" in capsys.readouterr().err
    assert not path.exists()
    other.unlink()
    assert main(["key", "new", str(path)]) == 0


def test_check_imports_nothing_heavy() -> None:
    code = (
        "import sys; from koordgen.cli import main; status = main(['check', sys.argv[1]]);"
        "print(sorted(set(sys.modules) & {'jinja2', 'yaml', 'json', 'numpy', 'msgspec', 'z3', 'casadi', 'ompl',"
        " 'pybullet', 'pymavlink', 'tomllib', 'koordgen.lang.explain', 'koordgen.cli.base.sarif'})); sys.exit(status)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(LINEFORM)], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr


def test_build_imports_no_robot_package(tmp_path: Path) -> None:
    code = (
        "import sys; from koordgen.cli import main; status = main(['build', sys.argv[1], '--target', 'quad,car',"
        " '-o', sys.argv[2]]); print(sorted(set(sys.modules) & {'numpy', 'msgspec', 'z3', 'casadi', 'ompl',"
        " 'pybullet', 'pymavlink', 'yaml', 'koordgen.lang.explain', 'koordgen.cli.base.sarif'}), file=sys.stderr);"
        " sys.exit(status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(LINEFORM), str(tmp_path)], capture_output=True, text=True, cwd=ROOT
    )
    assert (done.returncode, done.stderr.strip()) == (0, "[]")


def test_an_error_of_the_compiler_is_not_the_users(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("koordgen.build.pipeline.check", lambda *_: 1 / 0)
    assert main(["check", str(LINEFORM)]) == 70
    assert "bug of koordgen" in capsys.readouterr().err


def test_outputs_of_others_survive(tmp_path: Path) -> None:
    (tmp_path / "lineform/quad").mkdir(parents=True)
    (tmp_path / "lineform/quad/thesis.tex").write_text("years")
    assert main(["build", str(LINEFORM), "--target", "quad", "-o", str(tmp_path)]) == 5
    assert (tmp_path / "lineform/quad/thesis.tex").read_text() == "years"

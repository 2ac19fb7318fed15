"""Every code is explained, in one form, and every example does what its explanation says."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.build.bundle.budget import check_budget, check_link
from koordgen.build.bundle.drivers import check_drivers, driver_files
from koordgen.build.bundle.functions import check_functions, functions_file
from koordgen.build.bundle.port_calls import check_calls
from koordgen.build.bundle.ports import check_ports
from koordgen.build.pipeline import Rejected, check_alone, check_system, read_fleet, read_source
from koordgen.cli import main
from koordgen.fleet import file as fleet
from koordgen.fleet import manifest
from koordgen.fleet.medium import Medium
from koordgen.fleet.settings import DriverClass
from koordgen.lang import explain
from koordgen.lang.analyze.program import check
from koordgen.lang.diagnostics import CATALOGUE, Diagnostic, together
from koordgen.lang.explain import CodeExplanation, explanation, show
from koordgen.lang.ir.decl import Program
from koordgen.lang.source import Source, Span
from koordgen.lang.syntax.parse import parse
from tests.build.squad_files import fleet_files

FOLDER = Path(explain.__file__).parent
RULES = FOLDER.parent / "analyze" / "rules"


def codes(*letters: str) -> list[str]:
    return [code for code in CATALOGUE if code.startswith(letters)]


def of_program(text: str) -> tuple[Program | None, list[str]]:
    source = Source("example.koord", text)
    tree, unread = parse(source)
    program, found = check(tree, source)
    return None if unread else program, [d.code for d in together(unread, found)]


def examples(found: CodeExplanation) -> Iterator[tuple[str, str, set[str]]]:
    """Each example with the line that leads to it and the codes that it must give."""
    yield found.wrong_note, found.wrong, {found.code}
    yield found.right_note, found.right, set()


def headings(path: Path) -> list[str]:
    return re.findall(r"^## (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)


def test_the_files_hold_the_catalogue_in_its_order_and_no_titles() -> None:
    pages = [headings(path) for path in (*(FOLDER / f"{letter}.md" for letter in "KFB"), *RULES.glob("*.md"))]
    order = {code: place for place, code in enumerate(CATALOGUE)}
    assert sorted([code for page in pages for code in page], key=order.__getitem__) == list(CATALOGUE)
    for page in pages:
        assert page == sorted(page, key=order.__getitem__)


def test_a_rule_of_the_analysis_has_one_file_with_its_explanation_beside_it() -> None:
    """A code that a rule's page explains is reported by that rule, or is named in the first line of another's."""
    first = {path.stem: path.read_text(encoding="utf-8").split("\n")[0] for path in RULES.glob("*.py")}
    reported = {path.stem: codes_in(path) for path in RULES.glob("*.py")}
    for page in RULES.glob("*.md"):
        assert set(headings(page)) <= set(re.findall(r"K\d{3}", first[page.stem])), page
    for name, found in reported.items():
        assert found <= set(re.findall(r"K\d{3}", first[name])), f"{name}.py: its first line names its codes"
    explained = {code for page in RULES.glob("*.md") for code in headings(page)}
    for path in (RULES.parents[1] / "check").rglob("*.py"):
        # K030: an index of a tuple, which is a matter of types
        assert not codes_in(path) & explained - {"K030"}, f"{path}: a rule of the analysis reports this code"


def codes_in(path: Path) -> set[str]:
    """Return the codes that a module reports: the strings of that form in it, but for its docstrings and comments."""
    return set(re.findall(r'"(K\d{3})"', path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("code", CATALOGUE)
def test_an_explanation_has_its_parts(code: str) -> None:
    found = explanation(code)
    rule, robots, *rest = found.markdown.split("\n\n")
    assert len(rule) > 40
    assert robots.startswith("On robots: ")
    assert len(robots) > 60
    assert [part.split("\n")[0] for part in rest if part.startswith(("Wrong", "Right"))] == [
        found.wrong_note, found.right_note,
    ]  # fmt: skip
    assert all(note.endswith(":") for note in (found.wrong_note, found.right_note))
    shown = show(found)
    assert shown.startswith(f"{code}: {CATALOGUE[code]}\n\n{rule}")
    assert all(f"    {line}\n" in f"{shown}\n" for line in (found.wrong + found.right).splitlines())
    assert max(map(len, shown.splitlines())) <= 80, "fits a terminal"


def test_a_code_that_is_not() -> None:
    with pytest.raises(KeyError):
        explanation("K000")


@pytest.mark.parametrize("code", codes("K"))
def test_examples_of_programs(code: str) -> None:
    for note, text, wanted in examples(explanation(code)):
        assert set(of_program(text)[1]) == wanted, note


@pytest.mark.parametrize("code", codes("F00"))
def test_examples_of_fleet_files(code: str) -> None:
    targets = {name: manifest.load(name) for name in manifest.available()}
    for note, text, wanted in examples(explanation(code)):
        found: list[str] = []

        def report(code: str, message: str, span: Span, help: str, found: list[str] = found) -> None:
            found.append(code)

        read = fleet.read(Source("fleet.yaml", text), targets, {}, report)
        assert set(found) == wanted, note
        assert (read is None) == bool(wanted)


def test_examples_of_a_file_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("lineform.koord").write_text(explanation("F101").right, encoding="utf-8")
    for _, text, wanted in examples(explanation("F100")):
        assert main(shlex.split(text)[1:]) == (1 if wanted else 0)
        assert ("error[F100]" in capsys.readouterr().err) == bool(wanted)


def test_examples_of_an_encoding(tmp_path: Path) -> None:
    path = tmp_path / "a.koord"
    found = explanation("F101")
    assert "Latin-1" in found.wrong_note
    assert "UTF-8" in found.right_note
    path.write_text(found.wrong, encoding="latin-1")
    with pytest.raises(Rejected) as rejected:
        read_source(str(path))
    assert [d.code for _, d in rejected.value.found] == ["F101"]
    path.write_text(found.right, encoding="utf-8")
    assert of_program(read_source(str(path)).text)[1] == []


def with_driver(program: Program, note: str, folder: Path) -> list[Diagnostic]:
    """What the build tells of a driver that has the sensors of the note."""
    given = re.search(r"whose (\w+) has the sensors `(.*)`", note)
    if not given:
        return []
    methods = "  def sense(self): return {}\n  def command(self, actuators): pass\n"
    (folder / "own.py").write_text(f"class Own:\n  sensors = {given[2]}\n{methods}")
    drivers = {given[1]: DriverClass("own", "Own")}
    return check_drivers(program, drivers, driver_files(drivers, program, [folder]), ())


# The other application of the fleet in the examples of a code. It is called `mapping` and runs on the same robot.
OTHERS = {
    "B012": "export:\n  List<int> done\nallwrite: List<int> done max 20\nGo:\n  pre: True\n  eff: done = []\n",
    "B013": "using Motion:\n  sensors: Point position\n  actuators: Point target\n"
    "Go:\n  pre: True\n  eff: Motion.target = Motion.position\n",
}


@pytest.mark.parametrize("code", OTHERS)
def test_examples_of_applications(code: str, tmp_path: Path) -> None:
    head = "delta: 0.1\ninsecure: true\norigin: {latitude: 0, longitude: 0, altitude: 0}\n"
    head += "geofence: {lo: [-1, -1, 0], hi: [1, 1, 2]}\n"
    head += "robots: [{name: ann, target: quad, address: 127.0.0.1:9}]\n"
    head += "applications:\n  - {name: mapping, program: mapping.koord}\n  - {name: task, program: task.koord"
    (tmp_path / "mapping.koord").write_text(OTHERS[code])
    for note, text, wanted in examples(explanation(code)):
        (tmp_path / "task.koord").write_text(text)
        bound = ", import: {Mapping: mapping}" if "import Mapping" in text else ""
        (tmp_path / "fleet.yaml").write_text(f"{head}{bound}}}\n")
        try:
            told = [d.code for part in check_system(str(tmp_path / "fleet.yaml")).parts for d in part.diagnostics]
        except Rejected as rejected:
            told = [d.code for _, d in rejected.found]
        assert set(told) == wanted, note


def test_examples_of_squads(tmp_path: Path) -> None:
    targets = {name: manifest.load(name) for name in manifest.available()}
    path, found = str(fleet_files(tmp_path)), explanation("B014")
    assert found.wrong_note == "Wrong, if the fleet provides `Motion` with `Point position` and `Point target`:"
    for note, text, wanted in examples(found):
        program, before = of_program(text)
        assert program is not None and before == []
        (tmp_path / "app.koord").write_text(text)
        told = set[str]()
        try:
            read_fleet(path, targets, program, str(tmp_path / "app.koord"), squads=True)
        except Rejected as rejected:
            told = {d.code for _, d in rejected.found}
        assert told == wanted, note


@pytest.mark.parametrize("code", [code for code in codes("B") if code not in (*OTHERS, "B014")])
def test_examples_of_builds(code: str, tmp_path: Path) -> None:
    found = explanation(code)
    target = re.search(r"--target (\w+)", found.wrong_note)
    robots = re.search(r"of (\d+) robots", found.wrong_note)
    assert target or robots, "says what it is built for"
    for note, text, wanted in examples(found):
        program, before = of_program(text)
        assert program is not None
        assert before == []
        told = check_ports(program, [manifest.load(target[1])] if target else [])
        told += check_alone(program)
        told += check_functions(program, functions_file(program, tmp_path, None))
        told += with_driver(program, found.wrong_note, tmp_path)
        told += check_budget(program, int(robots[1]) if robots else 1)
        linked = Medium() if "on a link of 6 Mbit/s" in found.wrong_note else None
        told += check_link(program, int(robots[1]) if robots else 1, delta=0.1, link=linked)
        told += check_calls(program, int(robots[1]) if robots else 1, delta=0.1, budget=0.01)
        assert {d.code for d in told} == wanted, note

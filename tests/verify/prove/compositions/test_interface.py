"""Obligations that an interface adds to the proof of an application, and messages that name both sides."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from koordgen.lang.semantics.composition import Application, System
from koordgen.verify.prove.obligations.count import expected
from koordgen.verify.prove.obligations.generate import obligations
from koordgen.verify.prove.obligations.interface import ALONE, in_scope
from koordgen.verify.prove.report.composition import (
    document_of,
    files_of,
    prove_application,
    prove_system,
    question_of,
    text_of,
)
from koordgen.verify.prove.report.show import AttackCount, Attacks
from koordgen.verify.prove.smt.obligation import OF_INTERFACE
from koordgen.verify.prove.smt.smtlib import document
from koordgen.verify.prove.smt.solve import Limits, Solver
from tests.lang.semantics.compositions import compiled
from tests.verify.prove.compositions.randomly import random_composition
from tests.verify.prove.compositions.systems import KNOWN, SENSOR

LISTS = """
export:
  write List<int> done
    guarantee Kept: len(done) <= len(done')
  int place[N_SYS]
    guarantee Inside: forall i in ID: near(place[i]) and place[i] in ID or place[i] < limit + N_SYS
fun near(int a) -> bool:
  return a >= -limit
param int limit = 2
allwrite: List<int> done max 20
allread: int place[N_SYS]
Go:
  pre: place[pid] < limit
  eff: place[pid] = place[pid] + 1
initially: limit > 0
"""
READER = """
import Lists:
  write List<int> done max 20
  int place[Lists.N_SYS]
param int limit = 9
local: int here
fun near(int a) -> bool:
  return a > 100
Add:
  pre: len(done) < limit
  eff: done.append(3)
See:
  pre: Lists.pid >= 0
  eff: here = place[Lists.pid]
invariant All: len(place) == Lists.N_SYS
invariant Two: forall i in ID: forall j in ID: i == j or Lists.pid[i] != Lists.pid[j] or Lists.pid[i] == -1
invariant Low: forall i in ID: Lists.pid[i] >= -1 and Lists.pid[i] < Lists.N_SYS
"""


@pytest.fixture(scope="module")
def solver() -> Iterator[Solver]:
    with Solver("z3", Limits(query=5.0, total=10_000.0)) as running:
        yield running


def lists(reader: str = READER) -> System:
    owner = Application("lists", compiled("lists", LISTS), (0, 1))
    return System((owner, Application("reader", compiled("reader", reader), (1, 2), (("Lists", "lists"),))), 3)


def unattacked() -> Attacks:
    class Anything(dict[str, AttackCount]):
        def __missing__(self, name: str) -> AttackCount:
            return AttackCount(0, "no attack")

    return Anything()


def test_an_application_without_exports_and_imports_has_the_obligations_of_its_program() -> None:
    alone = compiled("alone", SENSOR.format(assumed="speed' > 1"))
    other = compiled("other", SENSOR.format(assumed="speed' < 2"))
    system = System((Application("alone", alone, (0, 1)), Application("other", other, (0, 1))), 2)
    program, interface = in_scope(system, 0)
    assert program is alone and interface is ALONE
    texts = [
        [document(o, lambda *_: "") for o in obligations(p, interface=i)]
        for p, i in ((alone, ALONE), (program, interface))
    ]
    assert texts[0] == texts[1]
    assert question_of(system, 0).interface is ALONE


def test_composing_adds_the_obligations_of_the_interface_only() -> None:
    system = KNOWN["an exporter's invariant that a guarantee protects"].system()
    program, interface = in_scope(system, 0)
    alone = {o.name for o in obligations(program)}
    composed = obligations(program, interface=interface)
    assert {o.name for o in composed if o.kind not in OF_INTERFACE} == alone
    assert {o.name: o.kind for o in composed if o.name not in alone} == {
        "guarantee counter.Positive-first-values": "guarantee",
        "guarantee counter.Positive-Up": "guarantee",
        "Low-other-applications": "interference",
    }


def made(system: System, index: int) -> tuple[Counter[str], Counter[str]]:
    """Return the names of an application's obligations, and the names that a count from the IR alone expects."""
    program, interface = in_scope(system, index)
    kinds = ("base", "event", "environment", "loop", *OF_INTERFACE)
    names = [o.name for o in obligations(program, None, None, "little", interface=interface) if o.kind in kinds]
    return Counter(names), expected(program, interface=interface)


@pytest.mark.parametrize("name", KNOWN)
def test_all_obligations_of_an_application_are_made(name: str) -> None:
    for index in range(2):
        found, counted = made(KNOWN[name].system(), index)
        assert found == counted


def test_all_obligations_of_random_compositions_are_made() -> None:
    for seed in range(10):
        system = random_composition(seed)
        for index in range(len(system.applications)):
            found, counted = made(system, index)
            assert found == counted, f"seed {seed}, application {index}"


def test_other_applications_do_not_change_the_proof_of_one() -> None:
    """An importer's obligations depend on what it imports, not on who else runs, nor on the exporter's invariants."""
    pair = KNOWN["an invariant about an imported variable with a guarantee"].system()
    second = pair.applications[1]
    more = compiled("counter", KNOWN["an exporter's invariant that a guarantee protects"].counter)
    third = Application("third", compiled("third", SENSOR.format(assumed="speed' > 1")), (0, 1))
    larger = System((Application("counter", more, (0, 1)), second, third), 2)
    texts = []
    for system in (pair, larger):
        program, interface = in_scope(system, 1)
        texts.append([document(o, lambda *_: "") for o in obligations(program, interface=interface)])
    assert texts[0] == texts[1]


def test_what_views_give_is_known_of_imports(solver: Solver) -> None:
    verdicts = {v.invariant: v for v in prove_application(lists(), 1, solver)}
    assert [verdicts[name].verdict for name in ("All", "Two", "Low", "(well-defined)")] == ["PROVED"] * 4


def test_a_guarantee_is_moved_with_the_exporters_params_and_functions(solver: Solver) -> None:
    program = in_scope(lists(), 1).program
    assert [p.name for p in program.params] == ["limit", "Lists.N_SYS", "Lists.limit"]
    assert [f.name for f in program.functions] == ["near", "Lists.near"]
    exporter = {v.invariant: v.verdict for v in prove_application(lists(), 0, solver)}
    assert exporter["guarantee lists.Inside"] == "PROVED"
    named = READER + "invariant Here: forall i in ID: here[i] < 9 + Lists.N_SYS\ninitially: limit == 9\n"
    assert {v.invariant: v.verdict for v in prove_application(lists(named), 1, solver)}["Here"] != "PROVED"
    fixed = question_of(lists(), 1, {"lists": {"limit": compiled("lists", LISTS).params[0].default}})
    assert fixed.params is not None and set(fixed.params) == {"Lists.limit"}


def test_a_plain_append_breaks_a_guarantee_and_the_message_says_how_to_mend_it(solver: Solver) -> None:
    found = prove_system(lists(), solver)
    reader = {v.invariant: v for v in found.applications[1].verdicts}
    broken = reader["guarantee lists.Kept"]
    assert broken.verdict == "NOT INDUCTIVE" and broken.explanation is not None
    assert broken.explanation.hint == (
        "another robot may have written done since the round's start, and Add overwrites its value: write done under "
        "`atomic`"
    )
    owner = {v.invariant: v for v in found.applications[0].verdicts}["guarantee lists.Kept"]
    assert (owner.verdict, owner.reason) == ("UNKNOWN", "lists keeps the guarantee; of reader this is not proved")
    mended = prove_system(lists(READER.replace("done.append", "atomic: done.append")), solver)
    assert {v.verdict for part in mended.applications for v in part.verdicts} == {"PROVED"}


def test_text_and_data_name_the_application_and_the_guarantee(solver: Solver) -> None:
    found = prove_system(lists(), solver)
    attacks = [unattacked(), unattacked()]
    text = text_of(found, attacks)
    assert "lists: lists.koord, for every number of robots" in text and "reader: reader.koord" in text
    assert "NOT INDUCTIVE  guarantee lists.Kept" in text and "Add of robot" in text and "(lists.koord:4)" in text
    counts = found.applications[1].counts()
    assert f"{counts['own']} obligations of its own, {counts['interface']} of its exports and imports" in text
    assert "composition: no obligations" in text
    entries = document_of(found, attacks)["invariants"]
    entry = next(e for e in entries if (e["application"], e["name"]) == ("reader", "guarantee lists.Kept"))
    assert entry["counterexample"]["file"] == "lists.koord" and entry["obligations"][0]["of"] == "interface"
    assert {o["of"] for e in entries for o in e["obligations"]} == {"interface", "application"}


def test_each_file_names_its_application(solver: Solver, tmp_path: Path) -> None:
    found = prove_system(KNOWN["assumptions that agree"].system(), solver)
    files = files_of(found, lambda file, line: f"line {line} of {file}")
    assert {
        "together-initially-0.smt2",
        "together-environment-0.smt2",
        "counter-Few-Go.smt2",
        "user-Few-Go.smt2",
    } <= set(files)
    together = files["together-environment-0.smt2"].decode()
    assert "(counter.koord:4: line 4 of counter.koord)" in together and "(user.koord:4:" in together
    broken = files_of(prove_system(lists(), solver), lambda *_: "")
    assert "lists.koord:4" in broken["reader-guarantee-lists-Kept-Add.smt2"].decode()


def test_a_contradiction_names_both_programs(solver: Solver) -> None:
    found = prove_system(KNOWN["assumptions that contradict one another"].system(), solver)
    (verdict,) = found.applications[0].verdicts
    assert verdict.verdict == "VACUOUS"
    assert "assume of Motion (counter.koord:4) and assume of Motion (user.koord:4)" in verdict.reason


def test_axioms_about_one_spec_function_must_agree(solver: Solver) -> None:
    owner = (
        "export:\n  int n\nallwrite: int n\nspec fun good(int a) -> bool\naxiom All: good(a)\n"
        "Go:\n  pre: n < 1\n  eff: n = n\n"
    )
    user = (
        "import Owner:\n  int n\n  spec fun good(int a) -> bool\nlocal: int k\naxiom None: not good(b)\n"
        "Go:\n  pre: n < 1\n  eff: k = n\ninvariant Any: forall i in ID: k[i] == k[i]\n"
    )
    applications = (
        Application("owner", compiled("owner", owner), (0,)),
        Application("user", compiled("user", user), (1,), (("Owner", "owner"),)),
    )
    found = prove_system(System(applications, 2), solver)
    verdicts = {v.invariant: v for v in found.applications[1].verdicts}
    assert verdicts["Any"].verdict == "VACUOUS" and "axiom owner All" in verdicts["Any"].reason

"""Summary of a run with squads: one verdict on all of its fleets."""

from __future__ import annotations

import pytest

from koordgen.runtime.trace.schema import Verdict as Found
from koordgen.runtime.trace.schema import Violation
from targets.sim.judging.summary import Summary, Verdict, add_fleet, squads_of

NEAR = Violation(2.0, "property", ("ann",), "invariant Near does not hold", "Near", "triangle.koord:9")
SLOW = Violation(3.0, "fault", ("alpha.ann",), "a.koord: late", host="the host was busy")


def summary(verdict: Verdict, *violations: Violation, why: str = "because") -> Summary:
    found = [Found(9.0, "invariant", "Near", "triangle.koord:9", "held", robots=("ann",))]
    return Summary(
        "app", "0", 1, 9.0, 9.0, verdict, why, list(violations), found, [], [], None, 0.0, 0, 1.0, 0, 0
    )  # fmt: skip


@pytest.mark.parametrize(
    ("outer", "inner", "verdict", "why"),
    [
        (summary("held"), summary("held"), "held", "because"),
        (summary("held"), summary("violated", NEAR), "violated", "at 2.00 s alpha.ann: alpha: invariant Near does not"),
        (summary("host overloaded", SLOW), summary("violated", NEAR), "violated", "alpha: invariant Near"),
        (
            summary("held"),
            summary("host overloaded", Violation(2.0, "property", ("ann",), "Near", line="t:9", host="it was busy")),
            "host overloaded",
            "it was busy. The run does not judge the program",
        ),
        (summary("interrupted"), summary("violated", NEAR), "interrupted", "because"),
        (
            summary("held"),
            summary("held", why="good; not judged to the end: invariant Far (a:1), unchecked"),
            "held",
            "because; not judged to the end: alpha: invariant Far (a:1), unchecked",
        ),
    ],
)
def test_the_verdict_is_that_on_all_fleets(outer: Summary, inner: Summary, verdict: str, why: str) -> None:
    whole = Summary(**{field: getattr(outer, field) for field in outer.__struct_fields__})
    whole.violations, whole.properties = list(outer.violations), list(outer.properties)
    add_fleet(whole, "alpha", inner)
    assert whole.verdict == verdict and why in whole.why
    assert whole.properties[-1].name == "alpha: Near" and whole.properties[-1].robots == ("alpha.ann",)
    assert [v.t for v in whole.violations] == sorted(v.t for v in (*outer.violations, *inner.violations))
    assert squads_of(whole).keys() == {"alpha"} and squads_of(outer) == {}

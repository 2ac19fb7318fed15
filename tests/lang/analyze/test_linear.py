"""The decision procedure against enumeration: what it proves holds of every robot, what it shows is an example."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from koordgen.lang.analyze.facts import linear
from koordgen.lang.analyze.facts.decide import find, unsat
from koordgen.lang.analyze.facts.linear import (
    FALSE,
    N_SYS,
    PID,
    TRUE,
    And,
    AtLeastZero,
    BoolFact,
    ConditionalTerm,
    Formula,
    Length,
    Linear,
    Or,
    Quotient,
    Remainder,
    combine,
    constant,
    equal,
    less,
    negate,
    scale,
    truth,
    variable,
)

small = st.integers(-4, 4)
simple = st.builds(
    lambda p, n, c: combine(combine(scale(variable(PID), p), scale(variable(N_SYS), n)), constant(c)),
    st.integers(-2, 2),
    st.integers(-1, 1),
    small,
)
quotients = st.builds(lambda e, d: variable(Quotient(e, d)), simple, st.integers(1, 4))
remainders = st.builds(lambda e, d: variable(Remainder(e, d)), simple, st.just(variable(N_SYS)))
choices = st.builds(lambda c, a, b: variable(ConditionalTerm(AtLeastZero(c), a, b)), simple, simple, simple)
terms = st.one_of(simple, simple, st.builds(combine, simple, st.one_of(quotients, remainders, choices)))
atoms = st.one_of(
    st.builds(AtLeastZero, terms),
    st.builds(equal, terms, terms),
    st.builds(lambda a, b: negate(equal(a, b)), terms, terms),
)
formulas: st.SearchStrategy[Formula] = st.recursive(
    atoms,
    lambda inner: st.one_of(
        st.builds(lambda a, b: And((a, b)), inner, inner),
        st.builds(lambda a, b: Or((a, b)), inner, inner),
        st.builds(negate, inner),
    ),
    max_leaves=5,
)
FLEETS = [{PID: pid, N_SYS: size} for size in range(1, 13) for pid in range(size)]


@settings(max_examples=400, deadline=None)
@given(formulas)
def test_what_is_unsat_has_no_robot(formula: Formula) -> None:
    if unsat((formula,)):
        assert not any(truth(formula, values) for values in FLEETS)


@settings(max_examples=400, deadline=None)
@given(formulas)
def test_an_example_is_one(formula: Formula) -> None:
    example = find((formula,), {})
    if example is None:
        assert not any(truth(formula, values) for values in FLEETS if values[N_SYS] <= 5)
    else:
        assert example.certain
        assert truth(formula, example.values)
        assert 0 <= example.values[PID] < example.values[N_SYS]


@settings(max_examples=300, deadline=None)
@given(st.lists(st.builds(AtLeastZero, simple), min_size=1, max_size=4))
def test_conjunctions_with_small_factors_are_decided(rows: list[Formula]) -> None:
    """What the checker lives on: x[pid + 1] and the like are never left open."""
    assert unsat(rows) or find(rows, {}) is not None


@given(formulas, st.sampled_from(FLEETS))
def test_a_formula_and_its_negation_differ(formula: Formula, values: dict[str, int]) -> None:
    assert truth(negate(formula), values) is (not truth(formula, values))


@settings(max_examples=300, deadline=None)
@given(
    st.recursive(
        st.builds(AtLeastZero, simple), lambda f: st.one_of(st.builds(lambda a, b: And((a, b)), f, f), f.map(negate))
    ),
    small,
    st.sampled_from(FLEETS),
)
def test_what_held_before_a_step_is_known_of_the_value_after_it(
    formula: Formula, by: int, values: dict[str, int]
) -> None:
    """`pid = pid + by`, if one could write it."""
    after = {**values, PID: values[PID] + by}
    assert truth(linear.shifted(formula, PID, by), after) is truth(formula, values)


def test_a_length_is_never_negative() -> None:
    size = variable(Length("local xs"))
    assert unsat((less(size, constant(0)),))
    assert not unsat((less(size, constant(1)),))


def test_facts_contradict_themselves_only() -> None:
    on, off = BoolFact("local on", True), BoolFact("local on", False)
    assert unsat((on, off))
    assert unsat((Or((And((on, FALSE)), off)), on))
    assert not unsat((on, BoolFact("local ready", False)))
    assert not unsat((linear.UNKNOWN, negate(linear.UNKNOWN)))


def test_an_example_that_depends_on_what_is_unknown_is_not_certain() -> None:
    example = find((BoolFact("local on", True), less(constant(0), variable(PID))), {})
    assert example is not None and not example.certain and example.values[PID] > 0


def test_params_keep_their_values_in_examples_and_are_free_in_proofs() -> None:
    k = variable("param k")
    assert not unsat((less(variable(N_SYS), k),))
    assert find((less(variable(N_SYS), k),), {"param k": 0}) is None


def test_giving_up_claims_nothing() -> None:
    """More branches than the budget: not proved, though it is false."""
    twins = [
        Or((equal(variable(f"param a{i}"), constant(0)), equal(variable(f"param a{i}"), constant(1))))
        for i in range(20)
    ]
    total = Linear(tuple((f"param a{i}", 1) for i in range(20)), -21)
    assert not unsat((*twins, AtLeastZero(total)))
    assert unsat((*twins[:2], AtLeastZero(Linear((("param a0", 1), ("param a1", 1)), -3))))


def test_terms_read_as_a_person_writes_them() -> None:
    last = combine(variable(N_SYS), constant(-1))
    assert linear.show(last) == "N_SYS - 1"
    assert linear.show(combine(last, variable(PID), -2)) == "N_SYS - 2 * pid - 1"
    assert linear.show(constant(-3)) == "-3"
    assert TRUE != FALSE

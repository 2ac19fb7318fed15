"""`--vary`: parsing, even coverage of ranges, and cells that are compared in pairs."""

from __future__ import annotations

import pytest

from koordgen.experiment.campaign import plan, vary
from koordgen.experiment.campaign.vary import BadVary, NumberRange, Seeds, ValueList


def test_what_is_varied_is_read() -> None:
    assert vary.parse(["seed,loss=0:0.3"]) == (Seeds(1), NumberRange("loss", 0.0, 0.3))
    assert vary.parse(["seed=5:70,delay=0,0.02,0.1,jitter=0:1"]) == (
        Seeds(5, 70), ValueList("delay", ("0", "0.02", "0.1")), NumberRange("jitter", 0.0, 1.0),
    )  # fmt: skip
    assert vary.parse(["loss=0,0.1,seed", "param.eps=0.5"]) == (
        ValueList("loss", ("0", "0.1")), Seeds(1), ValueList("param.eps", ("0.5",)),
    )  # fmt: skip
    assert vary.parse(["seed=3,9"]) == (ValueList("seed", ("3", "9")),)
    assert vary.parse([]) == ()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "neither"), ("loss", "neither"), ("loss=", "neither"), ("=3", "neither"), ("seed,0.1", "neither"),
        ("loss=0.3:0", "must be less than the second"), ("loss=0:many", "'many' is not a finite number"),
        ("loss=0:inf", "'inf'"),
        ("seed=1:x", "whole number"), ("seed=9:1", "less than the first seed"), ("seed=1.5", "whole number"),
        ("seed,seed=3", "seed is varied twice"), ("loss=0,,1", "neither"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_quoted(text: str, said: str) -> None:
    with pytest.raises(BadVary, match=said):
        vary.parse([text])


def test_too_many_combinations_are_refused() -> None:
    many = ",".join(map(str, range(400)))
    with pytest.raises(BadVary, match="combinations"):
        vary.parse([f"loss={many},delay={many}"])


def test_too_many_ranges_are_refused() -> None:
    with pytest.raises(BadVary, match="more than 12 ranges"):
        vary.parse([f"r{k}=0:1" for k in range(13)])


def test_how_many_runs_there_are_by_themselves() -> None:
    assert vary.natural(vary.parse(["seed=1:70"])) == 70
    assert vary.natural(vary.parse(["seed=1:5,loss=0,0.1"])) == 10
    assert vary.natural(vary.parse(["loss=0,0.1,delay=1,2,3"])) == 6
    assert vary.natural(()) == 1
    assert vary.natural(vary.parse(["seed"])) is None and vary.natural(vary.parse(["seed=1:5,loss=0:1"])) is None


def test_cells_have_the_same_seeds_and_draws() -> None:
    found = vary.values(vary.parse(["seed=7:9,loss=0:0.3,mode=a,b"]), 6)
    assert [run["seed"] for run in found] == ["7", "7", "8", "8", "9", "9"]
    assert [run["mode"] for run in found] == ["a", "b"] * 3
    assert all(one["loss"] == other["loss"] for one, other in zip(found[::2], found[1::2], strict=True))
    assert len({run["loss"] for run in found}) == 3
    assert list(found[0]) == ["seed", "loss", "mode"]


def test_seeds_that_do_not_suffice_are_told() -> None:
    with pytest.raises(BadVary, match="too few seeds for 4 runs"):
        vary.values(vary.parse(["seed=1:3"]), 4)


def test_ranges_are_covered_evenly_by_every_beginning() -> None:
    """Of each 20 runs in a row some fall in every tenth of each range, and in every quarter of a plane."""
    found = vary.values(vary.parse(["loss=0:1,delay=2:4"]), 200)
    points = [(float(run["loss"]), (float(run["delay"]) - 2) / 2) for run in found]
    for first in (0, 50, 100):
        some = points[first : first + 20]
        for axis in (0, 1):
            assert {int(10 * p[axis]) for p in some} == set(range(10))
        assert {(p[0] > 0.5, p[1] > 0.5) for p in some} == {(a, b) for a in (False, True) for b in (False, True)}
    assert found == vary.values(vary.parse(["loss=0:1,delay=2:4"]), 200)
    assert found[:50] == vary.values(vary.parse(["loss=0:1,delay=2:4"]), 50)


def test_where_values_go() -> None:
    (run,) = plan.runs(vary.parse(["seed=4:4,param.eps=0.5,boot=1,loss=0.1"]), 1, {"boot", "firmware"})
    assert (run.params, run.settings, run.flags) == ({"eps": "0.5"}, {"boot": "1"}, {"seed": "4", "loss": "0.1"})
    assert run.name == "0000"

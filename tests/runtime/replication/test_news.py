"""Of whom there was no news, by what is held of each robot's closings round by round."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from koordgen.runtime.replication.news import News

Arrivals = st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), min_size=1, max_size=30)


@given(Arrivals)
def test_a_complete_round_need_not_be_looked_at(
    arrivals: list[tuple[bool, bool, bool]],
) -> None:
    looked, said = News(3), News(3)
    held = [0, 0, 0]
    for round_, arrived in enumerate(arrivals, 1):
        held = [round_ if news else before for news, before in zip(arrived, held, strict=True)]
        looked.note(held, round_)
        if all(h == round_ for h in held):
            said.complete(round_)
        else:
            said.note(held, round_)
        if not all(arrived):
            since = range(round_ + 2)
            assert [said.silent((0, 1, 2), s) for s in since] == [looked.silent((0, 1, 2), s) for s in since]


def test_a_robot_whose_time_begins_anew_has_news_at_once() -> None:
    news = News(2)
    news.complete(7)
    news.note([7, 7], 8)
    assert news.silent((0, 1), 7) == [] and news.silent((0, 1), 8) == [0, 1]
    news.note([12, 7], 12)
    assert news.silent((0, 1), 12) == [1]
    news.renew(1)
    news.note([12, 7], 13)
    assert news.silent((0, 1), 12) == []

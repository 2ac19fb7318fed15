"""How a robot gets the store of the others: asked for piece by piece, from one member after another."""

from __future__ import annotations

from random import Random

import msgspec

from koordgen.runtime.net.pieces import cut
from koordgen.runtime.net.wire import Head, State, StatePiece, View, Want
from koordgen.runtime.replication.comeback import BURST, KEPT, PATIENCE, Comeback, Store
from koordgen.runtime.replication.views import Out

VIEW = View(4, 30, (0, 2, 4))
CLEO = 2
ROOM = 100


def answer(store: Store, sender: int, want: Want, present: State) -> list[Out]:
    return store.answer(sender, want, present.applied, lambda: present, ROOM)


def head(pid: int) -> Head:
    return Head(0, bytes(8), bytes(8), pid, bytes(8), bytes(8), 0, 0, None, ())


def state(applied: int, size: int = 2000) -> State:
    data = Random(applied).randbytes(size)
    return State(VIEW, applied, (msgspec.Raw(msgspec.msgpack.encode(data)),), (-1,) * 3, (0,) * 3)


def wanted(outs: list[Out]) -> tuple[list[int], Want]:
    [(to, kind, fields)] = outs
    assert kind is Want
    return list(to), Want(head(CLEO), *fields)


def pieces(outs: list[Out], sender: int = 0) -> list[StatePiece]:
    return [StatePiece(head(sender), *fields) for to, kind, fields in outs if kind is StatePiece and to == (CLEO,)]


def test_who_is_out_asks_everyone_to_be_let_in() -> None:
    comeback = Comeback(CLEO, 3)
    out = View(3, 20, (0, 2, -1))
    assert comeback.incarnation(out) == -1
    to, want = wanted(comeback.poll(1, out))
    assert to == [0, 1] and (want.view, want.incarnation) == (3, -1)
    assert comeback.incarnation(VIEW) == 4
    assert comeback.incarnation(View(3, 20, (0, 2, 3))) == -1, "a life from before it fell out is none"


def gather(comeback: Comeback, stores: dict[int, Store], now: dict[int, State], rng: Random, loss: float) -> int:
    """Until it has the store; how many ticks that took."""
    for tick in range(1, 500):
        to, want = wanted(comeback.poll(tick, VIEW))
        for pid in to:
            if rng.random() < loss or pid not in stores:
                continue
            answers = pieces(answer(stores[pid], CLEO, want, now[pid]), pid)
            assert len(answers) <= BURST
            rng.shuffle(answers)
            for piece in answers:
                found = comeback.take(piece, tick) if rng.random() >= loss else None
                assert not isinstance(found, str)
                if found is not None:
                    assert found in (state(s.applied) for s in now.values()) or found.applied < now[pid].applied
                    assert found == state(found.applied)
                    return tick
        for pid, held in now.items():
            if rng.random() < 0.5:
                now[pid] = state(held.applied + 1)  # a round is applied meanwhile
    raise AssertionError("the store never came")


def test_a_store_in_many_pieces_comes_whole_though_it_changes_meanwhile() -> None:
    for seed in range(10):
        for loss, most in ((0.0, 3), (0.3, 40)):
            stores, now = {0: Store(), 1: Store()}, {0: state(40), 1: state(41)}
            assert gather(Comeback(CLEO, 3), stores, now, Random(seed), loss) <= most


def test_a_member_that_does_not_answer_is_not_asked_for_long() -> None:
    took = gather(Comeback(CLEO, 3), {1: Store()}, {1: state(41)}, Random(1), 0.0)
    assert PATIENCE < took <= 3 * PATIENCE


def test_who_has_begun_to_gather_gets_the_rest_of_the_same_store() -> None:
    store, comeback = Store(), Comeback(CLEO, 3)
    _, want = wanted(comeback.poll(1, VIEW))
    first = pieces(answer(store, CLEO, want, state(40)))
    for piece in first[:10]:
        assert comeback.take(piece, 1) is None
    _, want = wanted(comeback.poll(2, VIEW))
    rest = pieces(answer(store, CLEO, want, state(45)))
    assert {p.round for p in rest} == {40} and len(rest) == first[0].count - 10
    assert not {p.index for p in rest} & {p.index for p in first[:10]}


def test_only_the_last_stores_are_kept_and_who_gathers_an_older_one_begins_anew() -> None:
    store, comeback = Store(), Comeback(CLEO, 3)
    _, want = wanted(comeback.poll(1, VIEW))
    comeback.take(pieces(answer(store, CLEO, want, state(40)))[0], 1)
    other = Want(head(1), 4, 2, 0, b"", b"")
    for applied in range(41, 41 + KEPT):
        answer(store, 1, other, state(applied))
    _, want = wanted(comeback.poll(2, VIEW))
    newer = pieces(answer(store, CLEO, want, state(50)))
    assert {p.round for p in newer} == {50}
    assert comeback.take(newer[0], 2) == "piece of something else"
    ticks = range(3, 4 + 2 * PATIENCE)
    assert any(wanted(comeback.poll(t, VIEW))[1].digest == b"" for t in ticks), (
        "after a while without news it begins anew"
    )


def test_what_is_no_store_is_refused_and_gathered_anew() -> None:
    comeback = Comeback(CLEO, 3)
    for blob in (b"no store", b"\xa2\xff\xfe", msgspec.msgpack.encode([1, 2, 3])):
        [piece] = cut(blob, ROOM)
        assert comeback.take(StatePiece(head(0), 40, *piece), 1) == "store does not fit"
        assert comeback.gathering is None
    [good] = cut(msgspec.msgpack.encode(state(40, 10)), ROOM)
    assert comeback.take(StatePiece(head(0), 40, *good), 2) == state(40, 10)


def test_alone_in_a_view_there_is_nobody_to_ask() -> None:
    assert Comeback(0, 0).poll(1, View(1, 5, (1,))) == []

"""What one event sees: cells that begin anew with other values, and cells of another kind."""

from __future__ import annotations

import pytest

from koordgen.runtime.program.program import Cell, Frame, Slots, Transaction
from koordgen.runtime.values.containers import OutOfRange

FRAME = Frame(1, 3, {"count": 4}, {"x": (5, 6, 7), "total": 8}, {}, {"Motion.target": 9})


def test_a_shown_value_is_no_write() -> None:
    cell = Cell(1)
    cell.value = 2
    assert cell.line
    cell.show(3)
    assert (cell.value, cell.line) == (3, 0)


def test_shown_slots_are_those_of_another_robot() -> None:
    slots = Slots((1, 2), 0)
    slots.own = 3
    assert slots.line
    slots.show([4, 5, 6], 2)
    assert (slots.all, slots.own, slots.line) == ((4, 5, 6), 6, 0)
    slots.own = 7
    assert slots.all == (4, 5, 7)
    with pytest.raises(OutOfRange):
        slots[3]


def test_what_is_shown_is_no_news() -> None:
    state = Transaction(FRAME)
    count, x = state.local("count"), state.slots("x")
    count.show(10)
    x.show((1, 2, 3), 0)
    assert state.written_values() == {}
    count.value = 11
    assert state.written_values() == {"count": 11}


def test_a_subclass_gives_cells_of_its_own_kind() -> None:
    class Doubled(Cell[int]):
        __slots__ = ()

    class Own(Transaction):
        def local(self, name: str) -> Cell[int]:
            cell = self.written[name] = Doubled(2 * super().local(name).value)
            return cell

    state = Own(FRAME)
    count, total = state.local("count"), state.shared("total")
    assert (type(count), count.value, type(total)) == (Doubled, 8, Cell)
    count.value = 1
    assert state.written_values() == {"count": 1}

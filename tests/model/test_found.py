"""What exploration and reading have found in the protocol: the shortest course of each, on the real objects.

A course that still goes wrong is marked as such, strictly: who mends it takes the mark away.
"""

from __future__ import annotations

from koordgen.runtime.net.wire import (
    Accept,
    Accepted,
    Decided,
    Entry,
    Prepare,
    Promise,
    RejoinRequest,
    RoundMessage,
    SnapshotFragment,
    View,
)
from koordgen.runtime.replication.state_machine import StateMachine
from koordgen.runtime.replication.views import Report, choose
from tests.model.lab import Fleet

BEGIN = View(0, 1, (0, 0, 0))


def everyone(fleet: Fleet, now: float, times: int = 3, but: tuple[int, ...] = ()) -> None:
    """All robots that are there talk without loss."""
    for _ in range(times):
        for pid in range(fleet.n):
            if pid not in but:
                for flight in fleet.to(pid, but):
                    fleet.deliver(flight)
                fleet.poll(pid, now)
    fleet.take(lambda f: f.to in but or f.message.head.pid in but)


def test_who_said_to_have_applied_what_nobody_has_any_more_does_not_keep_the_others_from_a_view() -> None:
    """Robot 0 applied round 5 alone, said so, and lost its store. Robots 1 and 2 have round 4. Nobody can have found
    round 5 stable, so the next view may begin with it."""
    words = {0: Report(0, 5, False), 1: Report(0, 4, True), 2: Report(0, 4, True)}
    assert choose(BEGIN, words) == View(1, 5, (1, 0, 0))


def test_that_robot_is_let_in_again() -> None:
    wishes = [""] * 3
    fleet = Fleet(3, lambda pid: wishes[pid])
    everyone(fleet, 0.0)
    everyone(fleet, 1.0)
    # Robot 0 hears the entries of round 3, nobody hears its own; it says so, and dies.
    for pid in range(3):
        fleet.poll(pid, 2.0)
    fleet.take(lambda f: f.message.head.pid == 0)
    for flight in fleet.take(lambda f: f.to == 0):
        fleet.deliver(flight)
    fleet.poll(0, 2.1)
    assert fleet.robots[0].kept.applied == 3
    fleet.restart(0)
    fleet.flights.clear()
    for tick in range(100):
        everyone(fleet, 2.2 + tick / 5)
    assert all(r.state is not None and r.state.applied > 15 for r in fleet.robots)


def rounds_of_all(fleet: Fleet, last: int) -> None:
    """Rounds 1 to `last` go well."""
    for round_ in range(1, last + 1):
        everyone(fleet, round_ - 1.0)


def test_a_robot_takes_no_store_while_it_has_promised_to_apply_nothing() -> None:
    """Robot 2 is let in by view 1, promises its successor having no store (so not counted in its end), and must not say
    afterwards that it has applied a round which that successor leaves out."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    fleet.restart(2)
    view = View(1, 4, (0, 0, 1))
    robot = fleet.robots[2]
    fleet.poll(2, 3.0)
    robot.adopt(view)
    fleet.robots[0].adopt(view)
    head = fleet.robots[1].wire.head
    fleet.flights.clear()
    robot.rounds.receive([Prepare(head, 129, view)])
    (promise,) = [f.message for f in fleet.flights if isinstance(f.message, Promise)]
    assert promise.applied <= 3 and not promise.has_store
    # The store comes: robot 0's, who has applied round 4 since.
    giver = fleet.robots[0]
    assert giver.state is not None
    giver.state.applied = 4
    giver.rounds.receive([RejoinRequest(robot.wire.head, 1, 1, 0, b"", b"")])
    (fragment,) = [f.message for f in fleet.flights if isinstance(f.message, SnapshotFragment)]
    robot.rounds.receive([fragment])
    assert robot.kept.applied == promise.applied


def test_who_is_let_in_during_a_round_that_the_others_have_applied_runs_no_event_in_it() -> None:
    wishes = [""] * 3
    fleet = Fleet(3, lambda pid: wishes[pid])
    rounds_of_all(fleet, 3)
    for tick in range(60):  # robot 2 is gone, and out
        everyone(fleet, 3.0 + tick / 5, but=(2,))
    round_ = 16
    assert fleet.robots[0].replica.views.view.members == (0, 0, -1)
    fleet.restart(2)
    wishes[2] = "plain"
    now = float(round_)
    everyone(fleet, now, but=(2,))  # robots 0 and 1 have applied round 17 ...
    for slot in range(5):  # ... and in it let robot 2 in
        everyone(fleet, now + slot * 0.1, times=4)
    for tick in range(40):
        everyone(fleet, now + 1 + tick / 5)
    robot = fleet.robots[2]
    assert robot.state is not None and robot.state.shared["mine"][2] > 0
    wishes[2] = ""
    for tick in range(20):
        everyone(fleet, now + 10 + tick / 5)
    assert robot.state.shared["mine"][2] == robot.program.locals["events"]


def test_an_output_waits_until_the_own_word_is_kept_too() -> None:
    """Robot 0's event of round 4 reaches robot 1 only, which says to have applied it; robot 0 moves, and dies before it
    has said anything itself. Robot 1 falls silent. Robots 0 and 2 must go on with round 4 in the history, or wait."""
    wishes = [""] * 3
    fleet = Fleet(3, lambda pid: wishes[pid])
    rounds_of_all(fleet, 3)
    wishes[0] = "plain"
    for pid in range(3):
        fleet.poll(pid, 3.0)
    fleet.take(lambda f: f.to == 2)  # robot 2 hears nothing of round 4
    for to in (1, 0):
        for flight in fleet.to(to):
            fleet.deliver(flight)
        fleet.poll(to, 3.1)
    wishes[0] = ""
    fleet.restart(0)
    fleet.flights.clear()
    for tick in range(60):
        everyone(fleet, 3.2 + tick / 5, but=(1,))  # raises Violation where the output is forgotten
    for tick in range(60):
        everyone(fleet, 15.2 + tick / 5)
    robot = fleet.robots[0]
    assert robot.state is not None and robot.state.shared["mine"][0] == robot.program.locals["events"]


def test_the_death_of_the_only_one_that_applied_a_view_s_last_round_does_not_end_the_mission() -> None:
    """Robot 0 alone has applied round 4, and view 1, of all three, begins with round 5. Robot 0 dies before the others
    have its entry of round 4. Two of three robots have kept their store, and all three talk."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    for pid in range(3):
        fleet.poll(pid, 3.0)
    fleet.take(lambda f: f.message.head.pid == 0)
    for flight in fleet.take(lambda f: f.to == 0):
        fleet.deliver(flight)
    fleet.poll(0, 3.1)
    promises = {p: r.replica.promise_report() for p, r in enumerate(fleet.robots)}
    assert [w.applied for w in promises.values()] == [4, 3, 3]
    view = choose(BEGIN, promises)
    assert view == View(1, 4, (1, 0, 0))
    for robot in fleet.robots:
        robot.adopt(view)
    fleet.restart(0)
    fleet.flights.clear()
    for tick in range(100):
        everyone(fleet, 3.2 + tick / 5)
    assert all(r.state is not None and r.state.applied > 15 for r in fleet.robots)


def test_a_store_that_was_handed_over_can_be_gone_back_to() -> None:
    """Robot 2 gets the store after round 3 and applies round 4 alone; view 2 begins with round 4 all the same."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    giver = fleet.robots[0].state
    assert giver is not None
    snapshot = giver.snapshot()
    state = StateMachine.from_snapshot(fleet.layout, 2, snapshot)
    assert state is not None and state.applied == snapshot.applied
    for pid in range(2):
        assert state.append(Entry(pid, 0, snapshot.applied + 1, snapshot.applied + 1), 5) is None
    state.close(snapshot.applied + 1, {}, stopped=False)
    state.apply_rounds()
    assert state.applied == snapshot.applied + 1
    assert state.rewind(View(2, snapshot.applied + 1, (0, 0, 2)))


def test_who_takes_back_its_store_takes_back_what_it_keeps_to_have_said() -> None:
    """Else it would say after a restart that it has applied in the new view what it has not."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 4)
    robot = fleet.robots[0]
    assert robot.kept.applied == 4
    robot.adopt(View(1, 4, (1, 0, 0)))
    assert robot.state is not None and robot.state.applied == 3
    assert (robot.kept.view.number, robot.kept.applied) == (1, 3)


def test_a_view_is_not_decided_before_a_majority_has_the_rounds_before_it() -> None:
    """Robot 0 alone has applied round 4 and promises so to robot 1; robot 2 is not heard, so round 4 may be stable.
    View 1 begins with round 5. Robot 0 dies, and its entry of round 4 with it; then all three talk."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    for pid in range(3):
        fleet.poll(pid, 3.0)
    fleet.take(lambda f: f.message.head.pid == 0)
    for flight in fleet.take(lambda f: f.to == 0):
        fleet.deliver(flight)
    fleet.poll(0, 3.1)
    fleet.flights.clear()
    prepare = Prepare(fleet.robots[1].wire.head, 129, BEGIN)
    proposer = fleet.robots[1].replica.views
    proposer.tick = 100
    proposal = proposer._begin(fleet.robots[1].replica.promise_report(), {0, 1})
    assert proposal.ballot == prepare.ballot
    for _ in range(10):  # robots 0 and 1 hear each other; robot 0 hears no decision
        fleet.robots[0].rounds.receive([prepare])
        for flight in fleet.take(lambda f: f.to == 1 and f.message.head.pid == 0):
            fleet.deliver(flight)
        for flight in fleet.take(lambda f: f.to == 0 and not isinstance(f.message, (Decided, RoundMessage))):
            fleet.deliver(flight)
    fleet.restart(0)
    fleet.flights.clear()
    for tick in range(150):
        everyone(fleet, 3.2 + tick / 5)
    assert all(r.state is not None and r.state.applied > 15 for r in fleet.robots)


def test_who_lags_behind_the_beginning_of_a_view_catches_up_when_all_others_came_in_anew() -> None:
    """Robots 0 and 2 have applied rounds 4 and 5, robot 1 neither; view 1 begins with round 5, so robots 0 and 2 take
    their stores back. Robot 1 needs their entries of round 4."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    for now in (3.0, 4.0, 4.6):
        for _ in range(3):
            for pid in range(3):
                for flight in fleet.to(pid) if pid != 1 else ():
                    fleet.deliver(flight)
                fleet.poll(pid, now)
        fleet.flights.clear()
    assert [r.state.applied for r in fleet.robots if r.state is not None] == [5, 3, 5]
    for robot in fleet.robots:
        robot.adopt(View(1, 5, (1, 0, 1)))
    for tick in range(100):
        everyone(fleet, 4.8 + tick / 5)
    assert all(r.state is not None and r.state.applied > 15 for r in fleet.robots)
    assert fleet.robots[0].replica.views.view.number < 5


def test_who_is_left_out_keeps_its_store_aside_for_the_case_that_all_others_lose_theirs() -> None:
    """View 1 goes on without robot 1; robot 0 dies, and robot 2 had not yet gathered a store. Robot 1 has the one of
    the round before view 1, and the next view can begin with it."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    robot = fleet.robots[1]
    replica = robot.replica
    robot.adopt(View(1, 4, (0, -1, 1)))
    word = replica.promise_report()
    assert (replica.is_out, word.view, word.applied, word.has_store) == (True, 1, 3, True)
    words = {0: Report(1, 4, False), 1: word, 2: Report(1, 3, False)}
    following = choose(replica.views.view, words)
    assert following == View(2, 4, (2, 2, 2))
    robot.adopt(following)
    assert replica.state is not None and replica.state.applied == 3
    robot.adopt(View(4, 9, (2, -1, 2)))  # what it then has is of a view that it does not know
    assert replica.is_out and not replica.promise_report().has_store


def test_who_has_no_store_votes_for_no_view_that_leaves_it_out() -> None:
    """View 1 goes on without robot 2, which has no store. Robot 1 alone has applied round 5, robot 0 is not heard: with
    robot 2's vote, view 2 of robots 0 and 1 would begin with round 6, in robot 1's hands alone."""
    fleet = Fleet(3)
    rounds_of_all(fleet, 3)
    robot = fleet.robots[2]
    replica = robot.replica
    robot.adopt(View(1, 6, (0, 0, -1)))
    assert replica.is_out
    fleet.flights.clear()

    def votes(ballot: int, value: View) -> bool:
        robot.rounds.receive([Accept(fleet.robots[1].wire.head, ballot, value)])
        return any(isinstance(f.message, Accepted) for f in fleet.to(1))

    assert not votes(129, View(2, 6, (0, 0, -1)))
    assert votes(257, View(2, 6, (0, 0, 2)))

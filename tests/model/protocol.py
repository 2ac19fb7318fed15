"""The protocol of the shared memory as a model: what three robots can do next, from any state they can be in.

The rules themselves are the runtime's (`promise`, `accept`, `choose`, `majority`, `commit_index`, `arbitrate`
with `winner`, `Rejoin.incarnation`), called here. The model adds who knows what, and every course of the network:

- What was ever said stays said, and is heard whenever its receiver makes use of it, once, twice or never. So a message
  may be lost, doubled, late or overtaken, and a partition is that nobody makes use of the other side's.
- A robot that is down does nothing; so a crash is the loss of what is not kept, and the restart follows at once. It may
  take entries with it that nobody else has.
- Time is left out: any member may be doubted, and a round may be closed, at any moment.
- An empty entry is made up when somebody needs it and its author could have sent it; before, it is not stored.
- An output leaves as soon as it may, and a round is announced when it is applied: to wait makes less possible.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from koordgen.runtime.net.wire import MAX_ROBOTS, View
from koordgen.runtime.replication import views
from koordgen.runtime.replication.progress import majority
from koordgen.runtime.replication.views import Report
from tests.model.rounds import Rounds
from tests.model.state import (
    Life,
    N,
    Robot,
    State,
    Step,
    Violation,
    changed,
)


class Protocol(Rounds):
    """All that can happen: rounds, and how one view follows another."""

    def steps(self, state: State) -> Iterator[Step]:
        """Everything that can happen next, in words, and where it leads. Raises Violation."""
        for pid in range(N):
            yield from self._own(state, pid)
            yield from self._ballots(state, pid)
            if state.crashes < self.bounds.crashes:
                yield from self._crash(state, pid)

    def _ballots(self, state: State, pid: int) -> Iterator[Step]:
        robot = state.robots[pid]
        for number in range(robot.view + 1, len(state.decided)):
            yield f"robot {pid} hears of view {number}", self.adopt(state, pid, number)
        number = robot.view + 1
        bound = robot.vote.promised // MAX_ROBOTS if robot.vote.number == number else 0
        if number < len(state.decided) and not self.bounds.rivals:
            return
        if pid in self.bounds.proposers and number <= self.bounds.views and bound < self.bounds.ballots:
            after = self.begin(state, pid)
            if after is not None:
                yield f"robot {pid} begins a ballot for view {number}", after
        for other, proposer in enumerate(state.robots):
            if proposer.ballot and other != pid and proposer.view == robot.view:
                after = self.promise(state, pid, proposer.ballot)
                if after is not None:
                    yield f"robot {pid} promises robot {other} ({robot.applied} applied)", after
        if robot.ballot:
            for whose, after in self.put(state, pid):
                yield f"robot {pid} puts a view to the vote, having the promises of {whose}", after
        for put in state.puts:
            after = self.vote(state, pid, *put)
            if after is not None:
                yield f"robot {pid} votes for {put[2]}", after

    def begin(self, state: State, pid: int) -> State | None:
        robot = state.robots[pid]
        number = robot.view + 1
        if not robot.store or robot.vote.number > number:
            return None
        bound = robot.vote.promised if robot.vote.number == number else 0
        ballot = (bound // MAX_ROBOTS + 1) * MAX_ROBOTS + pid
        vote = views.promise(robot.vote, number, ballot)
        assert vote is not None
        return self.settled(state._replace(robots=changed(state.robots, pid, robot._replace(vote=vote, ballot=ballot))))

    def _word(self, robot: Robot) -> Report:
        return Report(robot.view, robot.said, robot.store, robot.vote.voted, robot.vote.value)

    def promise(self, state: State, pid: int, ballot: int) -> State | None:
        robot = state.robots[pid]
        vote = views.promise(robot.vote, robot.view + 1, ballot)
        if vote is None or (robot.view + 1, ballot) in {p[:2] for p in state.puts}:
            return None
        robot = robot._replace(vote=vote)
        promise = (robot.view + 1, ballot, pid, self._word(robot))
        if promise in state.promises:
            return None
        robots = changed(state.robots, pid, robot)
        return self.settled(state._replace(robots=robots, promises=state.promises | {promise}))

    def put(self, state: State, pid: int) -> Iterator[tuple[list[int], State]]:
        robot = state.robots[pid]
        number, ballot = robot.view + 1, robot.ballot
        if any(put[:2] == (number, ballot) for put in state.puts):
            return
        found = [(p[2], p[3]) for p in state.promises if p[:2] == (number, ballot)]
        done = set()
        for count in range(1, N):
            for some in combinations(found, count):
                words = {pid: self._word(robot), **dict(some)}
                if len(words) != count + 1:
                    continue
                value = self._choose(state.decided[robot.view], words)
                if value is None or value in done:
                    continue
                done.add(value)
                vote, held = views.accept(robot.vote, ballot, value), self._gather(state, pid, value)
                if vote is not None and held is not None:
                    robots = changed(state.robots, pid, robot._replace(vote=vote, held=held))
                    after = state._replace(
                        robots=robots,
                        puts=state.puts | {(number, ballot, value)},
                        votes=state.votes | {(number, ballot, pid)},
                    )
                    yield sorted(words), self._counted_votes(after, number, ballot, value)

    def _choose(self, view: View, words: dict[int, Report]) -> View | None:
        key = view, tuple(sorted(words.items(), key=lambda item: item[0]))
        if key not in self._chosen:
            self._chosen[key] = views.choose(view, words)
        return self._chosen[key]

    def vote(self, state: State, pid: int, number: int, ballot: int, value: View) -> State | None:
        robot = state.robots[pid]
        if number <= robot.view or (number, ballot, pid) in state.votes:
            return None
        vote, held = views.accept(robot.vote, ballot, value), self._gather(state, pid, value)
        if vote is None or held is None:
            return None
        robots = changed(state.robots, pid, robot._replace(vote=vote, held=held))
        after = state._replace(robots=robots, votes=state.votes | {(number, ballot, pid)})
        return self._counted_votes(after, number, ballot, value)

    def _counted_votes(self, state: State, number: int, ballot: int, value: View) -> State:
        if sum(v[:2] == (number, ballot) for v in state.votes) < majority(N):
            return self.settled(state)
        if number < len(state.decided):
            if state.decided[number] != value:
                raise Violation(f"P5: two views {number} are decided: {state.decided[number]} and {value}")
            return self.settled(state)
        before = state.histories[number - 1]
        if len(before) < value.since - 1:
            raise Violation(f"P2: {value} begins after a round that nobody has applied")
        state = state._replace(decided=(*state.decided, value), histories=(*state.histories, before[: value.since - 1]))
        for pid, _, round_ in state.final:
            if round_ >= value.since:
                raise Violation(f"P3: robot {pid} acted on its event of round {round_}, which {value} leaves out")
        return self.settled(state)

    def _gather(self, state: State, pid: int, value: View) -> int | None:
        """Up to which round a robot has the entries when it votes for a view; None: it must not vote yet."""
        robot = state.robots[pid]
        if not self.rules.holders or not robot.store:
            return robot.held
        if value.number != robot.view + 1 or value.members[pid] < 0:
            if self.rules.stays:
                return None  # it would lose its store by it
            if value.number != robot.view + 1:
                return robot.held
        for round_ in range(max(robot.applied, robot.held) + 1, value.since):
            counts = next(v for v in reversed(state.decided[: robot.view + 1]) if v.since <= round_)
            for author, incarnation in enumerate(counts.members):
                if incarnation >= 0 and not self._closing(state, state.lives, author, incarnation, round_)[1]:
                    return None
        return max(robot.held, value.since - 1) if value.since - 1 > robot.applied else 0

    def adopt(self, state: State, pid: int, number: int) -> State:
        """Go by a decided view: on with the store where it stays what it was, else without."""
        robot, lives = state.robots[pid], state.lives
        before, view = state.decided[robot.view], state.decided[number]
        next_ = robot.store and number == robot.view + 1
        if next_ and view.members[pid] == before.members[pid]:
            robot = robot._replace(view=number, ballot=0)
        elif next_ and view.members[pid] == number and robot.applied >= view.since - 1:
            # It had gone further, and comes in anew with the store that it had then.
            self._same_life(state, pid, state.histories[number][: view.since - 1])
            robot = Robot(True, number, view.since - 1, robot.view, robot.vote, said=min(robot.said, view.since - 1))
            lives = changed(lives, pid, (*lives[pid], Life(number, view.since)))
        else:
            base = robot.view if robot.store else robot.base
            robot = Robot(False, number, 0, base, robot.vote, 0, 0, min(robot.said, view.since - 1))
        state = state._replace(robots=changed(state.robots, pid, robot), lives=lives)
        return self.settled(state._replace(words=self._say(state, pid, robot)))

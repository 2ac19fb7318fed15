"""The model's rounds: events, closings, applying, what is stable, what leaves a robot; crash, and coming back."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

from koordgen.runtime.net.wire import Contribution, View
from koordgen.runtime.replication import progress
from koordgen.runtime.replication.apply import arbitrate
from koordgen.runtime.replication.messages import Vote
from koordgen.runtime.replication.progress import Progress
from koordgen.runtime.replication.rejoin import Rejoin
from tests.model.state import (
    AS_THEY_ARE,
    COMMIT,
    KINDS,
    SKIP,
    Bounds,
    Life,
    N,
    Robot,
    Rules,
    State,
    Step,
    Violation,
    changed,
)


class Rounds:
    """What robots do while the view stays as it is."""

    def __init__(self, bounds: Bounds, rules: Rules = AS_THEY_ARE) -> None:
        self.bounds = bounds
        self.rules = rules
        self._stable: dict[tuple[Any, ...], bool] = {}
        self._counted: dict[tuple[Any, ...], tuple[tuple[int, int], ...]] = {}
        self._chosen: dict[tuple[Any, ...], View | None] = {}

    # What one robot does with rounds.

    def _own(self, state: State, pid: int) -> Iterator[Step]:
        robot = state.robots[pid]
        if robot.store:
            if robot.applied < self.bounds.rounds:
                for after in self.apply(state, pid):
                    yield f"robot {pid} applies round {robot.applied + 1}", after
            view = state.decided[robot.view]
            free = not robot.pending and not self._frozen(robot) and view.members[pid] >= 0
            if free and pid in self.bounds.actors:
                for round_ in self._open(state, pid):
                    for kind in self.bounds.kinds:
                        after = self._event(state, pid, round_, kind)
                        yield f"robot {pid} closes round {round_} with {KINDS[kind]}", after
        else:
            for giver, after in self.stores(state, pid):
                yield f"robot {pid} gets the store from robot {giver}", after

    def _frozen(self, robot: Robot) -> bool:
        return robot.vote.number > robot.view

    def _open(self, state: State, pid: int) -> list[int]:
        """The rounds in which it may run an event: the one it is current for and has not closed."""
        robot, life = state.robots[pid], state.lives[pid][-1]
        closed = life.first - 1 + len(life.kinds)
        found = [robot.applied + 1] if closed <= robot.applied < self.bounds.rounds else []
        if self.rules.again and robot.base >= 0 and robot.view and not any(life.kinds) and robot.applied:
            found.append(robot.applied)
        return found

    def _event(self, state: State, pid: int, round_: int, kind: int) -> State:
        robot, life = state.robots[pid], state.lives[pid][-1]
        kinds = (*life.kinds, *(SKIP,) * (round_ - life.first - len(life.kinds)), kind)[: round_ - life.first + 1]
        lives = changed(state.lives, pid, (*state.lives[pid][:-1], life._replace(kinds=kinds)))
        robots = changed(state.robots, pid, robot._replace(pending=round_))
        return self.settled(state._replace(lives=lives, robots=robots))

    def apply(self, state: State, pid: int) -> Iterator[State]:
        """The next round, where all closings can be had."""
        robot = state.robots[pid]
        round_ = robot.applied + 1
        if self.rules.freezes and self._frozen(robot) and robot.applied >= state.decided[robot.view].since - 1:
            return
        counts = next(v for v in reversed(state.decided[: robot.view + 1]) if v.since <= round_)
        choices, lives = [], state.lives
        for author, incarnation in enumerate(counts.members):
            if incarnation >= 0:
                lives, kinds = self._closing(state, lives, author, incarnation, round_)
                if not kinds:
                    return
                choices.append([(author, incarnation, kind) for kind in kinds])
        for closings in product(*choices):
            yield self._apply(state._replace(lives=lives), pid, round_, closings)

    def _closing(
        self, state: State, lives: tuple[tuple[Life, ...], ...], author: int, incarnation: int, round_: int
    ) -> tuple[tuple[tuple[Life, ...], ...], list[int]]:
        """What an author closed a round with, by what can be heard; made up, if it is silent and could have sent it."""
        found = []
        for life in lives[author]:
            at = round_ - life.first
            if life.incarnation == incarnation and 0 <= at < min(len(life.kinds), life.heard):
                found.append(life.kinds[at])
        if found or self.incarnation(state, author) != incarnation:
            return lives, found
        robot = state.robots[author]
        if not robot.store and round_ < state.decided[robot.view].since:
            return lives, []
        known = lives[author]
        if known[-1].incarnation != incarnation:
            known = (*known, Life(incarnation, state.decided[robot.view].since))
        life = known[-1]
        if len(life.kinds) > round_ - life.first or round_ < life.first:
            return lives, []
        kinds = (*life.kinds, *(SKIP,) * (round_ - life.first + 1 - len(life.kinds)))
        return changed(lives, author, (*known[:-1], life._replace(kinds=kinds))), [SKIP]

    def incarnation(self, state: State, pid: int) -> int:
        """Under which it closes rounds now; -1: it does not."""
        robot = state.robots[pid]
        view = state.decided[robot.view]
        return view.members[pid] if robot.store else Rejoin(pid, robot.base).incarnation(view)

    def _apply(self, state: State, pid: int, round_: int, closings: tuple[tuple[int, int, int], ...]) -> State:
        robot = state.robots[pid]
        entry = self._entry(closings, round_)
        history = state.histories[robot.view]
        if len(history) >= round_:
            if history[round_ - 1] != entry:
                raise Violation(f"P2: round {round_}: robot {pid} counts {entry}, others {history[round_ - 1]}")
            histories = state.histories
        else:
            histories = changed(state.histories, robot.view, (*history, entry))
        pending = robot.pending
        mine = (pid, state.decided[robot.view].members[pid])
        if pending == round_ and mine not in entry:
            pending = 0  # its commit gave way
        held = robot.held if robot.held > round_ else 0
        robot = robot._replace(applied=round_, pending=pending, said=round_, held=held)
        words = self._say(state, pid, robot)
        state = state._replace(robots=changed(state.robots, pid, robot), histories=histories, words=words)
        return self.settled(state)

    def _entry(self, closings: tuple[tuple[int, int, int], ...], round_: int) -> tuple[tuple[int, int], ...]:
        """Whose event counts, by the rule that the runtime uses."""
        key = closings, round_
        found = self._counted.get(key)
        if found is None:
            events = [
                Contribution(a, a, 0 if kind == COMMIT else -1, kind != SKIP, False, ()) for a, _, kind in closings
            ]
            commits, others = arbitrate(events, round_, N)
            if len(commits) > 1:
                raise Violation(f"P1: round {round_}: more than one commit of {closings} counts")
            counted = {e.instance for e in (*commits, *others) if e.acted}
            found = tuple(sorted((a, i) for a, i, _ in closings if a in counted))
            self._counted[key] = found
        return found

    def _say(self, state: State, pid: int, robot: Robot) -> tuple[tuple[int, ...], ...]:
        words = state.words[pid]
        words = (*words, *(-1,) * (robot.view + 1 - len(words)))
        return changed(state.words, pid, changed(words, robot.view, max(words[robot.view], robot.said)))

    def settled(self, state: State) -> State:
        """With all outputs gone that may go, and without messages that nobody can use any more."""
        for pid, robot in enumerate(state.robots):
            due = 0 < robot.pending <= robot.applied
            if due and (not self.rules.waits or self._is_stable(state, pid)):
                state = self._flush(state, pid)
        return self._tidy(state)

    def _tidy(self, state: State) -> State:
        """Without what makes no difference any more: ballots for a view that is decided, histories and words of views
        by which nobody goes."""
        oldest = min(r.view for r in state.robots)
        over = oldest if self.bounds.rivals else len(state.decided) - 1
        robots = state.robots
        for pid, robot in enumerate(robots):
            if 0 < robot.vote.number <= over and (robot.vote.promised or robot.ballot):
                vote = Vote(robot.vote.number) if robot.vote.number > robot.view else Vote()
                robots = changed(robots, pid, robot._replace(vote=vote, ballot=0))
        live = {(r.view + 1, r.ballot) for r in robots if r.ballot}
        put = {(n, b) for n, b, _ in state.puts}
        return state._replace(
            robots=robots,
            promises=frozenset([p for p in state.promises if p[:2] in live and p[:2] not in put]),
            puts=frozenset([p for p in state.puts if p[0] > over]),
            votes=frozenset([v for v in state.votes if v[0] > over]),
            histories=((),) * oldest + state.histories[oldest:],
            words=tuple([(-1,) * oldest + words[oldest:] for words in state.words]) if oldest else state.words,
        )

    def _is_stable(self, state: State, pid: int) -> bool:
        robot = state.robots[pid]
        heard = tuple(
            (w, words[w]) for p, words in enumerate(state.words) if p != pid
            for w in (min(robot.view, len(words) - 1),)
        )  # fmt: skip
        key = state.decided[robot.view], robot.applied, heard, robot.pending
        found = self._stable.get(key)
        if found is None:
            peers = [Progress() for _ in heard]
            for peer, (view, applied) in zip(peers, heard, strict=True):
                peer.report(view, applied, (), 0, again=False)
            found = self._stable[key] = robot.pending <= progress.commit_index(peers, key[0], robot.applied)
        return found

    def _flush(self, state: State, pid: int) -> State:
        robot = state.robots[pid]
        event = (pid, state.decided[robot.view].members[pid], robot.pending)
        for view in state.decided[robot.view + 1 :]:
            if view.since <= robot.pending:
                raise Violation(f"P3: robot {pid} acts on its event of round {robot.pending}, which {view} leaves out")
        robots = changed(state.robots, pid, robot._replace(pending=0))
        state = state._replace(robots=robots, final=state.final | {event})
        self._all_counted(state)
        return state

    def _all_counted(self, state: State) -> None:
        """P3: what has left a robot is in the history that goes on."""
        history = state.histories[-1]
        for pid, incarnation, round_ in state.final:
            if round_ <= len(history) and (pid, incarnation) not in history[round_ - 1]:
                raise Violation(f"P3: robot {pid} acted on its event of round {round_}, which {history} leaves out")

    # Crash, and coming back.

    def _crash(self, state: State, pid: int) -> Iterator[Step]:
        robot, lives = state.robots[pid], state.lives
        vote = Vote() if self.rules.forgets_vote else robot.vote
        said = 0 if self.rules.forgets_said else robot.said
        down = Robot(False, robot.view, 0, robot.view, vote, 0, 0, said)
        after = state._replace(robots=changed(state.robots, pid, down), crashes=state.crashes + 1)
        words = f"robot {pid} dies and starts anew"
        yield words, self.settled(after)
        incarnation = self.incarnation(state, pid)
        if incarnation >= 0 and lives[pid][-1].incarnation == incarnation:
            life = lives[pid][-1]
            for more in range(1, self.bounds.rounds - (life.first - 1 + len(life.kinds)) + 1):
                longer = life._replace(kinds=(*life.kinds, *(SKIP,) * more))
                yield (
                    f"{words}, having closed {more} more rounds with nothing",
                    self.settled(after._replace(lives=changed(lives, pid, (*lives[pid][:-1], longer)))),
                )
        cut = tuple(
            tuple(self._cut(after, author, life, life is known[-1]) for life in known)
            for author, known in enumerate(lives)
        )
        if cut != lives:
            yield f"{words}; what nobody else had heard of it is lost", self.settled(after._replace(lives=cut))

    def _cut(self, state: State, author: int, life: Life, last: bool) -> Life:
        """What remains of a life's closings: those its author has, or else those that someone has applied."""
        if last and self.incarnation(state, author) == life.incarnation:
            return life
        held = max((max(r.applied, r.held) for r in state.robots if r.store), default=0) - life.first + 1
        return life if held >= min(len(life.kinds), life.heard) else life._replace(heard=max(0, held))

    def stores(self, state: State, pid: int) -> Iterator[tuple[int, State]]:
        robot = state.robots[pid]
        view = state.decided[robot.view]
        incarnation = self.incarnation(state, pid)
        if robot.store or incarnation < 0 or (self.rules.refuses and self._frozen(robot)):
            return
        given = set()
        for giver, other in enumerate(state.robots):
            able = other.store and other.view == robot.view and other.applied >= view.since - 1
            if able and other.applied not in given:
                given.add(other.applied)
                yield giver, self._resume(state, pid, incarnation, other.applied)

    def _resume(self, state: State, pid: int, incarnation: int, applied: int) -> State:
        robot, known = state.robots[pid], state.lives[pid]
        self._same_life(state, pid, state.histories[robot.view][:applied])
        if known[-1].incarnation != incarnation:
            known = (*known, Life(incarnation, state.decided[robot.view].since))
        life = known[-1]
        kinds = (*life.kinds, *(SKIP,) * (applied - life.first + 1 - len(life.kinds)))
        robot = robot._replace(store=True, applied=applied, said=applied)
        lives = changed(state.lives, pid, (*known[:-1], life._replace(kinds=kinds)))
        words = self._say(state, pid, robot)
        return self.settled(state._replace(robots=changed(state.robots, pid, robot), lives=lives, words=words))

    def _same_life(self, state: State, pid: int, history: tuple[tuple[tuple[int, int], ...], ...]) -> None:
        """P4: the variables that it kept of its last counted round are those of the event that counted."""
        counted = [(r, i) for r, entry in enumerate(history, 1) for p, i in entry if p == pid]
        if counted:
            round_, incarnation = counted[-1]
            kept = [
                life.incarnation for life in state.lives[pid]
                if 0 <= round_ - life.first < len(life.kinds) and life.kinds[round_ - life.first]
            ]  # fmt: skip
            if not kept or kept[-1] != incarnation:
                raise Violation(f"P4: robot {pid} comes back to round {round_} as {incarnation}, and it kept {kept}")

"""The control port: who has the key stops a robot, afresh, soon also at 30 % loss; floods cost nothing."""

from __future__ import annotations

import json
import math
import random
import socket
from typing import Any

import msgspec
import pytest

from benchmarks.fixtures.fleet import KEY, settings
from koordgen.operate.estop import Stopping
from koordgen.runtime.config.settings import Peer, Settings
from koordgen.runtime.net.metrics import Metrics
from koordgen.runtime.net.seal import CONTROL, MEMORY, seal
from koordgen.runtime.net.transport import CannotOpen
from koordgen.runtime.ops.control import LINGER, MOST_AT_ONCE, Control
from koordgen.runtime.ops.orders import (
    CHALLENGE_LIFE,
    LONG,
    SHORT,
    Ask,
    AskStatus,
    Offer,
    Order,
    StatusPart,
    StopAnswer,
    StopOrder,
    decode,
    encode,
)
from koordgen.runtime.ops.status import StatusRequest, ask, show

NONCE = b"nonce-01"
OTHER = bytes(32)


class Wires:
    """A socket of which the test holds the other end."""

    def __init__(self) -> None:
        self.arrived: list[bytes] = []
        self.answers: list[bytes] = []

    def receive(self) -> tuple[bytes, Any] | None:
        return (self.arrived.pop(0), "somebody") if self.arrived else None

    def send(self, datagram: bytes, address: Any) -> None:
        assert address == "somebody"
        self.answers.append(datagram)

    def close(self) -> None:
        pass


class Robot:
    def __init__(self, secret: bytes = bytes(32), **changes: Any) -> None:
        self.wires = Wires()
        self.control = Control(self.wires, settings(1, 3, **changes), KEY, secret)
        self.now = 50.0
        self.phase = "running"
        self.reports = 0

    def report(self) -> dict[str, Any]:
        self.reports += 1
        return {"robot": "bert", "reports": self.reports}

    def poll(self) -> bool:
        return self.control.poll(self.now, self.phase, self.report)

    def get(self, *datagrams: bytes) -> list[Order | str]:
        """What it answers, and that no answer is longer than its question."""
        self.wires.arrived += datagrams
        self.wires.answers.clear()
        self.poll()
        if len(datagrams) == 1:
            assert sum(map(len, self.wires.answers)) <= len(datagrams[0])
        return [decode(answer, KEY) for answer in self.wires.answers]

    def ask(self, order: Order, key: bytes | None = KEY) -> list[Order | str]:
        return self.get(encode(order, key))

    def challenge(self) -> bytes:
        (offer,) = self.ask(Ask(0, NONCE))
        assert isinstance(offer, Offer)
        return offer.challenge


def test_ask_offer_stop_stopped() -> None:
    robot = Robot()
    (offer,) = robot.ask(Ask(0, NONCE))
    assert isinstance(offer, Offer)
    assert (offer.nonce, offer.pid, offer.robot) == (NONCE, 1, "bert")
    assert not robot.poll(), "asking stops nobody"
    assert robot.ask(StopOrder(NONCE, offer.challenge)) == [StopAnswer(NONCE, 1, "stopping")]
    assert robot.poll()
    robot.phase = "stopped"
    assert robot.ask(StopOrder(NONCE, offer.challenge)) == [StopAnswer(NONCE, 1, "stopped")], (
        "the answer may have been lost"
    )
    assert robot.control.rejected == {}


def test_the_process_stays_until_its_answer_was_heard() -> None:
    robot = Robot()
    assert not robot.control.lingers(robot.now)
    robot.ask(StopOrder(NONCE, robot.challenge()))
    assert robot.control.lingers(robot.now + LINGER / 2)
    assert not robot.control.lingers(robot.now + LINGER)


def test_a_recorded_stop_stops_nobody_after_a_restart() -> None:
    before = Robot(secret=b"a" * 32)
    recorded = encode(StopOrder(NONCE, before.challenge()), KEY)
    before.get(recorded)
    assert before.poll()
    after = Robot(secret=b"b" * 32)
    assert after.get(recorded) == [] and not after.poll()
    assert after.control.rejected == {"not our challenge": 1}


def test_a_stop_that_was_held_back_is_too_old() -> None:
    robot = Robot()
    recorded = encode(StopOrder(NONCE, robot.challenge()), KEY)
    robot.now += CHALLENGE_LIFE + 0.1
    assert robot.get(recorded) == [] and not robot.poll()
    assert robot.control.rejected == {"an old challenge": 1}


def test_another_robots_challenge_is_not_ours() -> None:
    stop = StopOrder(NONCE, Robot(secret=b"a" * 32).challenge())
    assert Robot(secret=b"b" * 32).ask(stop) == []


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (encode(Ask(0, NONCE), OTHER), "not authentic"),
        (encode(Ask(0, NONCE), None), "not authentic"),
        (encode(Ask(7, NONCE), KEY), "another application"),
        (encode(AskStatus(7, NONCE, bytes(24), 0), KEY), "another application"),
        (encode(AskStatus(0, NONCE, bytes(24), 0), KEY), "not our challenge"),
        (seal(KEY, CONTROL, b"\1\4\0\0" + NONCE + bytes(LONG - 28)), "malformed"),
        (encode(Offer(NONCE, 1, bytes(24), "bert"), KEY), "an answer to nobody"),
        (encode(StopAnswer(NONCE, 1, "stopping"), KEY), "an answer to nobody"),
        (encode(StopOrder(NONCE, bytes(24)), KEY), "not our challenge"),
        (seal(KEY, MEMORY, encode(Ask(0, NONCE), KEY)[:-16]), "not authentic"),
        (seal(KEY, CONTROL, b"\1\0\0\0" + NONCE), "malformed"),
        (seal(KEY, CONTROL, b"\1\x63".ljust(SHORT - 16)), "malformed"),
        (seal(KEY, CONTROL, b"\1"), "malformed"),
        (seal(KEY, CONTROL, b"\1\5\0"), "malformed"),
        (seal(KEY, CONTROL, b"\2".ljust(SHORT - 16)), "another format version"),
        (bytes(LONG + 1), "oversize"),
        (b"", "not authentic"),
    ],
)
def test_what_is_not_listened_to(datagram: bytes, reason: str) -> None:
    robot = Robot()
    assert robot.get(datagram) == [] and not robot.poll()
    assert robot.control.rejected == {reason: 1}


@pytest.mark.parametrize(
    "order",
    [
        Ask(65535, NONCE),
        Offer(NONCE, 127, bytes(range(24)), "a" * 32),
        StopOrder(NONCE, bytes(24)),
        StopAnswer(NONCE, 0, "stopped"),
        AskStatus(1, NONCE, bytes(range(24)), 3),
        StatusPart(NONCE, 0, 1, b"{}\0\0"),
        StatusPart(NONCE, 65535, 65535, b"x" * 1170),
    ],
)
def test_orders_arrive_as_they_were(order: Order) -> None:
    datagram = encode(order, KEY)
    assert decode(datagram, KEY) == order
    assert len(datagram) == {AskStatus: LONG, StatusPart: len(datagram)}.get(type(order), SHORT) <= LONG


def test_garbage_is_never_listened_to() -> None:
    rng, robot = random.Random(1), Robot()
    stop = encode(StopOrder(NONCE, robot.challenge()), KEY)
    sources = [stop, encode(Ask(0, NONCE), KEY), encode(AskStatus(0, NONCE, robot.challenge(), 0), KEY)]
    for _ in range(4000):
        data = bytearray(rng.choice(sources))
        match rng.randrange(3):
            case 0:
                for _ in range(rng.randint(1, 5)):
                    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            case 1:
                del data[rng.randrange(len(data)) :]
            case _:
                data = bytearray(rng.randbytes(rng.randrange(1400)))
        if bytes(data) not in sources:
            assert robot.get(bytes(data)) == []
    assert not robot.poll() and robot.reports == 0
    assert set(robot.control.rejected) == {"not authentic", "oversize"}


def test_what_has_the_key_but_no_sense_never_raises() -> None:
    rng, robot = random.Random(2), Robot()
    for _ in range(4000):
        payload = bytes([1, rng.randrange(7)]) + rng.randbytes(rng.choice((0, 3, SHORT - 18, LONG - 18)))
        answers = robot.get(seal(KEY, CONTROL, payload))
        assert len(answers) <= 1
    assert not robot.poll()


def test_a_flood_is_taken_in_bites() -> None:
    robot = Robot()
    robot.wires.arrived = [bytes(SHORT)] * 1000 + [encode(Ask(0, NONCE), KEY)]
    robot.poll()
    assert len(robot.wires.arrived) == 1001 - MOST_AT_ONCE
    for _ in range(4):
        robot.poll()
    assert len(robot.wires.answers) == 1


# --- in time


def time_to_stop(seed: int, loss: float, period: float = 0.02, delay: float = 0.002, jitter: float = 0.01) -> float:
    """Seconds from the first call to the turn of the agent's loop in which it learns of the stop."""
    rng = random.Random(seed)
    robot, stopping = Robot(secret=rng.randbytes(32)), Stopping(0, KEY, rng.randbytes(8))
    under_way: list[tuple[float, bool, bytes]] = []
    began = robot.now
    next_call, next_poll = began, began + period * rng.random()

    def send(datagram: bytes, to_robot: bool, now: float) -> None:
        if rng.random() >= loss:
            under_way.append((now + delay + jitter * rng.random(), to_robot, datagram))

    while True:
        now = min([next_call, next_poll, *(at for at, _, _ in under_way)])
        for each in sorted(d for d in under_way if d[0] <= now):
            under_way.remove(each)
            if each[1]:
                robot.wires.arrived.append(each[2])
            elif stopping.receive(each[2], now):
                next_call = now
        if next_call <= now:
            send(stopping.datagram(now), True, now)
            next_call = now + 0.01
        if next_poll <= now:
            robot.now, next_poll = now, now + period
            if robot.poll():
                return now - began
            for answer in robot.wires.answers:
                send(answer, False, now)
            robot.wires.answers.clear()
        assert now < began + 3


@pytest.mark.parametrize(("loss", "most"), [(0.0, 0.08), (0.3, 0.2)])
def test_a_stop_is_soon_there(loss: float, most: float) -> None:
    took = sorted(time_to_stop(seed, loss) for seed in range(1000))
    assert took[-1] <= most, f"p50 {took[500]:.3f} p99 {took[990]:.3f} max {took[-1]:.3f}"


def test_at_two_thirds_lost_it_gets_there_too() -> None:
    assert all(time_to_stop(seed, 0.66) < 2.0 for seed in range(200))


def test_an_agent_that_began_anew_amid_the_call_is_stopped_too() -> None:
    stopping, old, new = Stopping(0, KEY, NONCE), Robot(secret=b"a" * 32), Robot(secret=b"b" * 32)
    old.get(stopping.datagram(0.0))
    assert stopping.receive(old.wires.answers[0], 0.01)
    now = 0.02
    while not stopping.phase and now < 1.0:
        new.get(stopping.datagram(now))
        for answer in new.wires.answers:
            stopping.receive(answer, now)
        now += 0.01
    assert stopping.phase == "stopping" and new.poll()


def test_the_caller_believes_no_recorded_answer() -> None:
    stopping = Stopping(0, KEY, NONCE)
    for order, key in (
        (StopAnswer(b"nonce-00", 1, "stopping"), KEY),
        (StopAnswer(NONCE, 1, "stopping"), OTHER),
        (Offer(b"nonce-00", 1, bytes(24), "bert"), KEY),
    ):
        assert not stopping.receive(encode(order, key), 0.0)
    assert not stopping.phase and isinstance(decode(stopping.datagram(0.0), KEY), Ask)


# --- status


def ask_through(robot: Robot, asking: StatusRequest, lose: random.Random | None = None) -> dict[str, Any] | None:
    for _ in range(50):
        for datagram in asking.datagrams():
            robot.get(datagram)
            for answer in robot.wires.answers:
                if lose is None or lose.random() > 0.3:
                    asking.receive(answer)
        if asking.answer is not None:
            return asking.answer
    return None


def test_a_status_is_of_one_moment_however_long_it_is() -> None:
    robot = Robot()
    robot.report = lambda: {"long": list(range(2000)), "text": "ü"}  # type: ignore[method-assign]
    assert len(json.dumps(robot.report())) > 5 * LONG
    assert ask_through(robot, StatusRequest(0, KEY, NONCE), random.Random(3)) == robot.report()


def test_a_question_asked_again_costs_no_new_report() -> None:
    robot = Robot()
    challenge = robot.challenge()
    for _ in range(5):
        robot.ask(AskStatus(0, NONCE, challenge, 0))
    assert robot.reports == 1
    assert robot.ask(AskStatus(0, NONCE, challenge, 9)) == []
    assert robot.control.rejected.pop("no such part") == 1
    flood = [encode(AskStatus(0, bytes([i]) * 8, challenge, 0), KEY) for i in range(100)]
    robot.get(*flood)
    assert robot.reports == 2 and robot.control.rejected == {"too many questions": 99}


def test_a_report_that_cannot_be_made_harms_nobody() -> None:
    robot = Robot()
    challenge = robot.challenge()
    for wrong in (lambda: {"a": 1 // 0}, lambda: {"a": object()}):
        robot.report = wrong  # type: ignore[method-assign]
        assert robot.ask(AskStatus(0, NONCE, challenge, 0)) == []
    assert robot.control.rejected == {"no report can be made": 2}


def test_a_recorded_question_learns_nothing() -> None:
    """Nor does it cost a report: its challenge is old, or of an earlier process."""
    robot = Robot(secret=b"a" * 32)
    recorded = encode(AskStatus(0, NONCE, robot.challenge(), 0), KEY)
    assert len(robot.get(recorded)) == 1
    robot.now += CHALLENGE_LIFE + 0.1
    assert robot.get(recorded) == []
    after = Robot(secret=b"b" * 32)
    assert after.get(recorded) == [] and after.reports == 0
    assert (robot.control.rejected, after.control.rejected) == ({"an old challenge": 1}, {"not our challenge": 1})


def test_pieces_of_two_moments_are_asked_for_again() -> None:
    asking = StatusRequest(0, KEY, NONCE)
    asking.receive(encode(Offer(NONCE, 1, bytes(24), "bert"), KEY))
    asking.receive(encode(StatusPart(NONCE, 0, 2, b'{"a": '), KEY))
    asking.receive(encode(StatusPart(NONCE, 1, 2, b'"}'), KEY))
    assert asking.answer is None and len(asking.datagrams()) == 1
    asking.receive(encode(StatusPart(NONCE, 3, 2, b"{}"), KEY))
    asking.receive(encode(StatusPart(b"nonce-00", 0, 1, b"{}"), KEY))
    assert asking.answer is None


# --- sockets


def at_free_port(**changes: Any) -> Settings:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return settings(1, 3, control=probe.getsockname()[1], **changes)


def test_a_taken_port_is_named() -> None:
    here = at_free_port()
    first = Control.open(here, KEY)
    with pytest.raises(CannotOpen, match=rf"127.0.0.1:{here.control}, the control port of robot bert.*`control`"):
        Control.open(here, KEY)
    first.close()
    Control.open(here, KEY).close()


def test_a_host_without_address_is_named() -> None:
    peers = (Peer("alice", "no.such.invalid", 47100),)
    with pytest.raises(CannotOpen, match="robot alice: no address for no"):
        Control.open(msgspec.structs.replace(settings(0, 1), peers=peers), KEY)


def test_nobody_answers_where_nobody_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("koordgen.runtime.ops.status.TIMEOUT", 0.05)
    monkeypatch.setattr("koordgen.runtime.ops.status.REPEAT", 0.01)
    assert ask(at_free_port(), KEY) is None


def test_a_report_is_shown_as_a_table() -> None:

    metrics = Metrics(1, 3)
    metrics.heard([(0, 1, 0.001)], 1.0)
    metrics.heard([(0, 3, 0.002)], 1.5)
    metrics.round(1, 0.001, "Move", None, True)
    metrics.round(2, 0.001, None, "waits for cleo", False)
    head: dict[str, Any] = {"robot": "bert", "pid": 1, "app": "line", "release": "", "phase": "running", "round": 2}
    near = {"of": "invariant", "name": "Near", "line": "line.koord:7", "since": 12, "why": "x[1] = 3"}
    head["monitors"] = {"counts": {"violated": 1, "held": 2}, "violated": [near]}
    report = {**head, "names": ["alice", "bert", "cleo"], **metrics.snapshot(2.0, {"not authentic": 4})}
    told = show(report)
    assert "bert  pid 1 of 3, line: running, round 2" in told
    assert "rounds    2, current in 50.0 %, 1 events" in told
    assert "alice         50.0 %" in told and "never" in told
    assert "       4  not authentic" in told and "       1  waits for cleo" in told
    assert "properties, by the robot's monitors: 2 held, 1 violated" in told
    assert "  violated since round 12: invariant Near (line.koord:7): x[1] = 3" in told
    assert not math.isnan(json.loads(json.dumps(report))["late_ms"]["p50"])

"""Planner process, started by `process.py` as `python child.py FOLDER...`.

The process searches the FOLDERs for modules.

The process receives an order that names the planner, then answers questions until its standard input ends. The standard
input ends when the agent ends, also if the agent crashes.

If a planner does not return, the system's alarm signal ends the process. This works even if the planner lets no other
thread run and the agent has died.
"""

from __future__ import annotations

import os
import signal
import sys

HANGING = 2.0  # seconds by which a call may exceed its time limit before the alarm ends the process


def main() -> None:
    """Answer the agent's questions until the agent has ended."""
    answers = os.dup(1)
    os.dup2(2, 1)  # output that a user's planner prints goes to standard error
    import msgspec

    from targets.planning.ask import BadPlanner, Judge, judging
    from targets.planning.pipe import Answer, Order, Question, Unframed, framed

    def send(answer: Answer) -> None:
        left = memoryview(framed(answer))
        while left:
            left = left[os.write(answers, left) :]

    def ordered(message: bytes) -> Judge | None:
        order = msgspec.msgpack.decode(message, type=Order)
        try:
            asked = judging(order.judge, order.name, order.world)
        except BadPlanner as error:
            send(Answer(0, (), str(error)))
            return None
        send(Answer(0, (), ""))
        return asked

    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    incoming, asked = Unframed(), None
    while data := os.read(0, 1 << 16):
        for message in incoming.feed(data):
            if asked is None:
                asked = ordered(message)
                if asked is None:
                    return
                continue
            question = msgspec.msgpack.decode(message, type=Question)
            signal.setitimer(signal.ITIMER_REAL, question.seconds + HANGING)
            answer = asked.serve(question)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            send(answer)


if __name__ == "__main__":
    sys.path[:1] = sys.argv[1:]  # modules are searched for in the FOLDERs, not in this file's folder
    try:
        main()
    except BrokenPipeError:
        pass
    finally:
        sys.stderr.flush()
        os._exit(0)  # ends without waiting for threads and exit handlers of a user's planner

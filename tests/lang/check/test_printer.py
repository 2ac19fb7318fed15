"""The printer shows the tree as it is."""

from __future__ import annotations

from koordgen.lang.ir.printer import show
from koordgen.lang.ir.verify import verify
from tests.lang.check.sound import SOUND

SHOWN = """program app (app.koord)
extern type Ticket
record Task
  target: Point = Point(0.0, 0.0, 0.0)
  id: int = 3
param k: int = 2
fun once(n: int) -> int
  let old_n: int = n
  while True
    invariant ((n >= old_n) and (exists i in range(0, 5, 1): (i <= n)))
    if (n > 3)
      return n
    n := (n + 1: int)
fun twice(n: int) -> int
  return (once(n) * 2: int)
extern fun fee(ticket: Ticket, all: List<int>[N_SYS]) -> int
  requires (len(all) > 0)
  ensures (result >= 0)
spec fun fair(a: int) -> bool
module Motion
  sensor position: Point
  actuator target: Point
  actuator path: List<Point> max 4096
  callable planner: PathPlanner
  assume (Motion.position' in Rect(Motion.position, Motion.target))
module Log
  stream stdout: stream
allread x: Point[N_SYS] = Point(0.0, 0.0, 0.0)
allread seen: List<int>[N_SYS] max 8 = List<int>{}
allwrite level: float = (int -> float k)
allwrite tasks: List<Task> max 64 = List<Task>{}
local count: int = 0
local on: bool = False
local ticket: Ticket = Ticket{}
local names: Map<int, string> max 4, 16 = Map<int, string>{}
local mine: Task = Task{Point(0.0, 0.0, 0.0), 3}
lock 0: tasks
init
  x[pid] := Motion.position
event Go
  when (on and ((0 <= count) and (count < k)))
  let goal: Point = ((x[count]? / level: Point) if (level != (int -> float 0)) else Motion.position: Point)
  if (count > 3)
    Motion.target := (goal * (int -> float 2): Point)
    stop
  elif (pid == 0)
    count := ((max(count, 1): int) % 7: int)
  else
    on := (not on)
event Take under lock 0
  when (len(tasks) > 0)
  for task: Task in tasks
    if (task.id == pid)
      mine := task
      tasks := removed(tasks, task)
      break
event Pay
  when True
  count := twice(fee(ticket, seen))
  mine := (mine with id = count)
  names := map_with(names, 3, 'three')
  Log.stdout << 'paid', str(count)
  Motion.path := Motion.planner(mine.target)
initially: (forall i in ID: (count[i] == 0))
invariant Near: (forall i in ID: (forall j in ID: (distance(Motion.position[i], x[j]) > (int -> float k))))
axiom All: fair(3)
"""


def test_the_checkers_program_is_well_formed_and_reads_as_text() -> None:
    verify(SOUND)
    assert show(SOUND) == SHOWN

"""A program with something of everything, as the checker leaves it."""

from __future__ import annotations

from koordgen.lang.analyze.program import check
from koordgen.lang.ir import decl
from koordgen.lang.source import Source
from koordgen.lang.syntax.parse import parse

TEXT = """using Motion:
  sensors: Point position
  actuators: Point target
    List<Point> path
  PathPlanner planner
  assume position' in Rect(position, target)
using Log:
  stream stdout
def Task:
  Point target
  int id = 3
extern type Ticket
extern fun fee(Ticket ticket, List<int> all[N_SYS]) -> int:
  requires: len(all) > 0
  ensures: result >= 0
spec fun fair(int a) -> bool
fun twice(int n) -> int:
  return once(n) * 2
fun once(int n) -> int:
  while True:
    invariant n >= old(n) and exists i in range(5): i <= n
    if n > 3:
      return n
    n += 1
param int k = 2
allread: Point x[N_SYS]
  List<int> seen[N_SYS] max 8
allwrite: float level = k
  List<Task> tasks
local: int count
  bool on
  Ticket ticket
  Map<int, string> names max 4, 16
  Task mine
init: x[pid] = Motion.position
Go:
  pre: on and 0 <= count < k
  eff:
    Point goal = x[count] / level if level != 0 else Motion.position
    if count > 3:
      Motion.target = goal * 2
      stop
    elif pid == 0: count = max(count, 1) % 7
    else: on = not on
Take:
  pre: len(tasks) > 0
  eff: atomic:
    for task in tasks:
      if task.id == pid:
        mine = task
        tasks.remove(task)
        break
Pay:
  pre: True
  eff:
    count = twice(fee(ticket, seen))
    mine.id = count
    names[3] = "three"
    Log.stdout << "paid" << count
    Motion.path = Motion.planner(mine.target)
initially: forall i in ID: count[i] == 0
invariant Near: forall i, j in ID: distance(Motion.position[i], x[j]) > k
axiom All: fair(3)
"""


def program() -> decl.Program:
    source = Source("dir/app.koord", TEXT)
    tree, found = parse(source)
    assert not found, found
    checked, found = check(tree, source)
    assert checked is not None, found
    return checked


SOUND = program()

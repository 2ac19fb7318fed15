"""Rows of a whole run in bounded memory: a table that grows too large drops every second row.

So the remaining rows still cover the whole run. Violations, causes and the mission's end are kept."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import msgspec

from koordgen.runtime.trace.schema import Header, TraceRecord
from targets.sim.view.data.rows import FAULT, SKIPPED, Chunk, Rows

# Limits of rows: per robot (or writer of a variable), and in total. Together they need 5 MB.
MOST_POSES, ALL_POSES = 4000, 40_000
MOST_SHARED, SHARED_BYTES = 600, 1_200_000
MOST_LOCALS, LOCALS_BYTES, LOCALS_OF_ONE = 600, 600_000, 4
MOST_ROUNDS, ALL_ROUNDS = 3000, 16_000
ALL_OTHERS = 4000
ALL_SCANS = 300
MOST_MAPS = 60
LONGEST = 3000  # bytes of a value that is shown
Row = list[Any]


class History:
    """Collector that thins out rows as they arrive; `whole` returns the remaining ones."""

    def __init__(self, header: Header) -> None:
        robots = max(1, len(header.robots))
        maps = {v.name for v in header.shared if v.type == "GridMap"}
        series = max(1, sum(robots if v.kind == "allread" else 1 for v in header.shared if v.name not in maps))
        self._maps = maps
        self._poses = [_Thinned(min(MOST_POSES, ALL_POSES // robots)) for _ in header.robots]
        self._members: dict[tuple[int, str], _Thinned] = {}
        self._most_of_member = min(MOST_POSES, ALL_POSES // robots) // 4
        self._rounds = [_Rounds(min(MOST_ROUNDS, ALL_ROUNDS // robots)) for _ in header.robots]
        self._shared: dict[tuple[str, int], _Values] = {}
        self._locals: dict[tuple[int, str], _Values] = {}
        self._bytes = SHARED_BYTES // series
        self._one_for_all = {v.name for v in header.shared if v.kind == "allwrite"}
        self._of_robots = {
            table: [_Thinned(ALL_OTHERS // robots) for _ in header.robots]
            for table in ("phases", "logs", "paths", "late", "links")
        }
        self._of_robots["scans"] = [_Thinned(ALL_SCANS // robots) for _ in header.robots]
        self._near = _Thinned(ALL_OTHERS)
        self._kept: Chunk = {"marks": [], "markers": [], "obstacles": []}

    def extend(self, chunk: Chunk) -> None:
        """Add rows, each table's in order of time."""
        for table, rows in chunk.items():
            match table:
                case "poses":
                    for row in rows:
                        self._poses[row[0]].add(row)
                case "members":
                    for row in rows:
                        self._members.setdefault((row[0], row[2]), _Thinned(self._most_of_member)).add(row)
                case "rounds":
                    for row in rows:
                        self._rounds[row[0]].add(row)
                case "shared":
                    for row in rows:
                        self._share(row)
                case "locals":
                    for row in rows:
                        self._local(row)
                case "near":
                    for row in rows:
                        self._near.add(row)
                case "marks" | "markers" | "obstacles":
                    self._kept[table] += rows[: max(0, ALL_OTHERS - len(self._kept[table]))]
                case _:
                    for row in rows:
                        self._of_robots[table][row[0]].add(row)

    def _share(self, row: Row) -> None:
        name, writer = row[0], row[1]
        key = (name, -1 if name in self._one_for_all else writer)
        if key not in self._shared:
            if len(self._shared) >= ALL_OTHERS:
                return
            many = MOST_MAPS if name in self._maps else MOST_SHARED
            self._shared[key] = _Values(many, self._bytes)
        self._shared[key].add(row)

    def _local(self, row: Row) -> None:
        key = row[0], row[3]
        if key not in self._locals:
            if len(self._locals) >= ALL_OTHERS:
                return
            self._locals[key] = _Values(MOST_LOCALS, LOCALS_BYTES // (LOCALS_OF_ONE * len(self._poses)))
        self._locals[key].add(row)

    def whole(self) -> Chunk:
        """Return all remaining rows, by table."""
        by_robot: dict[str, Sequence[_Thinned | _Rounds]] = {
            "poses": self._poses,
            "rounds": self._rounds,
            **self._of_robots,
        }
        return {
            **{table: [row for each in series for row in each.rows()] for table, series in by_robot.items()},
            "shared": sorted((row for s in self._shared.values() for row in s.rows()), key=lambda row: float(row[2])),
            "locals": sorted((row for s in self._locals.values() for row in s.rows()), key=lambda row: float(row[1])),
            "near": list(self._near.rows()),
            **({"members": [row for each in self._members.values() for row in each.rows()]} if self._members else {}),
            **{table: list(rows) for table, rows in self._kept.items()},
        }


class _Thinned:
    """At most `most` rows plus the last one: every 2^k-th row of those added."""

    def __init__(self, most: int) -> None:
        self._most = max(16, most)
        self._rows: list[Row] = []
        self._every = 1
        self._came = 0
        self._last: Row | None = None

    def add(self, row: Row) -> None:
        self._last = row
        if self._came % self._every == 0:
            self._rows.append(row)
            self._last = None
        self._came += 1
        if len(self._rows) > self._most:
            self._halve()

    def _halve(self) -> None:
        self._every *= 2
        self._last = self._last or self._rows[-1]
        self._rows = self._rows[::2]
        if self._rows[-1] is self._last:
            self._last = None

    def rows(self) -> Iterator[Row]:
        yield from self._rows
        if self._last is not None:
            yield self._last


class _Values(_Thinned):
    """Rows of a variable: unchanged values are left out, long ones are cut, all take at most `most_bytes`."""

    def __init__(self, most: int, most_bytes: int) -> None:
        super().__init__(most)
        self._most_bytes = most_bytes
        self._bytes = 0
        self._before: Any = None

    def add(self, row: Row) -> None:
        text = msgspec.json.encode(row[4])
        if text == self._before:
            return
        self._before = text
        if len(text) > LONGEST and not _is_map(row[4]):
            row = [*row[:4], {"cut": text[:LONGEST].decode("utf-8", "ignore")}]
        super().add(row)
        self._bytes += len(text) // self._every
        if self._bytes > self._most_bytes and len(self._rows) > 4:
            self._halve()

    def _halve(self) -> None:
        super()._halve()
        self._bytes //= 2


class _Rounds:
    """Rounds, with successive equal results joined into one row.

    If there are too many, neighbours are joined."""

    def __init__(self, most: int) -> None:
        self._most = max(16, most)
        self._rows: list[Row] = []

    def add(self, row: Row) -> None:
        if self._rows and self._rows[-1][4:] == row[4:]:
            last = self._rows[-1]
            last[2], last[3] = row[2], last[3] + row[3]
            return
        self._rows.append(list(row))
        if len(self._rows) > self._most:
            pairs = zip(self._rows[::2], self._rows[1::2], strict=False)
            odd = self._rows[-1:] if len(self._rows) % 2 else []
            self._rows = [*(_joined(a, b) for a, b in pairs), *odd]

    def rows(self) -> Iterable[Row]:
        return self._rows


def _joined(a: Row, b: Row) -> Row:
    """Join two rows of rounds. The row keeps the worse result, but an event rather than a skip."""
    a_ranks = a[4] == FAULT or (a[4] != SKIPPED and b[4] != FAULT)
    outcome, what = (a if a_ranks else b)[4:]
    return [a[0], a[1], b[2], a[3] + b[3], outcome, what]


def _is_map(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 6 and isinstance(value[5], str)


def gathered(header: Header, records: Iterable[TraceRecord]) -> Chunk:
    """Return the rows of a whole trace, read once."""
    rows, history = Rows(header), History(header)
    for number, record in enumerate(records):
        if not isinstance(record, Header):
            rows.add(record, record.t)
        if number % 5000 == 0:
            history.extend(rows.taken())
    rows.end()
    history.extend(rows.taken())
    return history.whole()

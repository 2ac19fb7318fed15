"""Topological order of a dependency graph, and its cycles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping


def topological_order(edges: Mapping[str, Iterable[str]]) -> tuple[list[str], list[list[str]]]:
    """Return all names in topological order, and cycles of the graph: `[a, b]` for a -> b -> a.

    Each name comes after the names that its edges point to. If the graph has cycles, at least one is returned; if
    several cycles share names, some of them may be left out. Edges to names that are not keys are ignored.
    """
    done: list[str] = []
    cycles: list[list[str]] = []
    depth: dict[str, int] = {}  # name -> its index in `path`; -1 if the name is in `done`
    caught: set[str] = set()
    for root in edges:
        if root in depth:
            continue
        path, pending = [root], [_targets(root, edges)]
        depth[root] = 0
        while path:
            target = next(pending[-1], None)
            if target is None:
                name = path.pop()
                pending.pop()
                depth[name] = -1
                done.append(name)
            elif target not in depth:
                depth[target] = len(path)
                path.append(target)
                pending.append(_targets(target, edges))
            elif depth[target] >= 0:
                cycle = path[depth[target] :]
                if not caught.issuperset(cycle):
                    caught.update(cycle)
                    cycles.append(cycle)
    return done, cycles


def _targets(name: str, edges: Mapping[str, Iterable[str]]) -> Iterator[str]:
    return iter([target for target in edges[name] if target in edges])

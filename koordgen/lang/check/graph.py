"""What depends on what, in an order in which everything stands behind what it needs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping


def ordered(edges: Mapping[str, Iterable[str]]) -> tuple[list[str], list[list[str]]]:
    """All names, each behind those it points to, and cycles, `[a, b]` for a -> b -> a: none when there is none, but not
    all where they share names. Edges to names that are no keys do not count."""
    done: list[str] = []
    cycles: list[list[str]] = []
    depth: dict[str, int] = {}  # of the names on the path from a root; -1: done
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

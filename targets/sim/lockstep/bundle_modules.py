"""Modules of one robot's bundle in a shared process: its program, drivers, functions and planners.

Bundles have modules of the same names with different content. Each robot's modules are in `sys.modules` only while its
code runs. The runtime and the targets are shared: they are the same in all bundles of a sim bundle."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import IO

SHARED = ("koordgen", "targets", "__main__")


class BundleModules:
    """Context manager in which code of one robot's bundle runs.

    The user's code gets a `time` module that reads the run's clock and does not sleep, and its output goes into
    `log`."""

    def __init__(self, bundle: Path, clock: Callable[[], float], today: Callable[[], float], log: IO[str]) -> None:
        self._path = str(bundle)
        self._names = {p.stem for p in bundle.iterdir() if p.suffix == ".py" or p.is_dir()}.difference(SHARED)
        self._clock = _clock_module(clock, today)
        self._log = log
        self._modules: dict[str, ModuleType] = {}
        self._count = 0
        self._hidden: dict[str, ModuleType] = {}
        self._streams = sys.stdout, sys.stderr
        self.idle = self._names <= _generated(bundle)  # no user code: nothing to switch after loading

    def __enter__(self) -> None:
        sys.path.insert(0, self._path)
        for name in self._names | {"time"}:
            if name in sys.modules:
                self._hidden[name] = sys.modules.pop(name)
        sys.modules.update(self._modules, time=self._clock)
        self._count = len(sys.modules)
        self._streams = sys.stdout, sys.stderr
        sys.stdout = sys.stderr = self._log

    def __exit__(self, *error: object) -> None:
        sys.stdout, sys.stderr = self._streams
        if len(sys.modules) != self._count:  # new modules were imported
            self._modules = {n: m for n, m in sys.modules.items() if n.partition(".")[0] in self._names}
        for name in self._modules:
            sys.modules.pop(name, None)
        sys.modules.update(self._hidden)
        self._hidden.clear()
        if self._path in sys.path:
            sys.path.remove(self._path)


def _generated(bundle: Path) -> set[str]:
    """Return the names of the generated modules that a bundle may have. `source` has a folder for each application."""
    applications = [folder.name for folder in (bundle / "source").glob("*")]
    programs = [f"{module}_{name}" for module in ("program", "properties") for name in applications]
    return {"program", "properties", "applications", "squad", "source", *programs}


def _clock_module(clock: Callable[[], float], today: Callable[[], float]) -> ModuleType:
    """Return a `time` module for the user's code."""
    module = ModuleType("time", time.__doc__)
    module.__dict__.update({k: v for k, v in vars(time).items() if not k.startswith("__")})
    for name, clock_time in (("monotonic", clock), ("perf_counter", clock), ("process_time", clock), ("time", today)):
        setattr(module, name, clock_time)
        setattr(module, f"{name}_ns", lambda clock_time=clock_time: round(clock_time() * 1e9))
    module.__dict__["sleep"] = lambda seconds: None
    return module

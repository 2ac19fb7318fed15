"""C code under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from koordgen.runtime.native.loader import COMPILERS

COMPILER = next((found for name in COMPILERS if (found := shutil.which(name))), None)
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
_LIBRARY = ("-shared", "-fPIC", "-O3")


def run(driver: str, source: Path, flags: Sequence[str], folder: Path, count: int) -> None:
    """Compile a driver of this folder, which includes the source, as strictly as can be, and let it go `count` steps
    from each of two seeds. Raises CalledProcessError."""
    program = folder / "driver"
    own = [flag for flag in flags if flag not in _LIBRARY and not flag.startswith("-l")]
    strict = ["-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    sanitizers = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    files = ["-I", str(source.parent), "-o", str(program), str(Path(__file__).with_name(driver)), "-lm"]
    subprocess.run([str(COMPILER), *own, *strict, *sanitizers, *files], check=True)
    for seed in ("1", "2"):
        subprocess.run([program, str(count), seed], check=True, timeout=300)

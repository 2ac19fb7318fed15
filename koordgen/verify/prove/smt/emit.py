"""Offline proof folder: one SMT-LIB file per obligation, and a script that checks all files."""

from __future__ import annotations

import re
from collections.abc import Iterable

from koordgen.verify.prove.smt.obligation import Obligation
from koordgen.verify.prove.smt.smtlib import Line, document

# The script reads the expected answer from each file. If a solver prints anything else, the file counts as not proved.
RUN = """\
#!/bin/sh
# Checks every obligation in this folder with a solver for SMT-LIB 2.6. Each file contains the expected answer.
# usage: sh run.sh [SOLVER [OPTION...]]      (default: z3; the name of a file is appended)
# status: 0 all as expected, 3 some are not, 5 the solver is not installed
cd "$(dirname "$0")" || exit 5
[ $# -gt 0 ] || set -- z3
command -v "$1" >/dev/null || { echo "run.sh: $1 is not installed" >&2; exit 5; }
all=0 wrong=0
for file in *.smt2; do
  wanted=$(sed -n 's/^(set-info :status \\([a-z]*\\))$/\\1/p' "$file")
  found=$("$@" "$file" 2>&1)
  all=$((all + 1))
  if [ "$found" = "$wanted" ]; then
    echo "ok    $file: $found"
  else
    wrong=$((wrong + 1))
    echo "WRONG $file: $(echo "$found" | head -n 1), where $wanted is expected"
  fi
done
echo "$all obligations, $wrong not as expected"
[ "$wrong" -eq 0 ] || exit 3
"""


def folder(obligations: Iterable[Obligation], line: Line) -> dict[str, bytes]:
    """Return the files of a proof folder by name. Equal obligations always give equal bytes."""
    files = {"run.sh": RUN.encode()}
    for obligation in obligations:
        name = file_name(obligation)
        unique, number = name, 2
        while f"{unique}.smt2" in files:
            unique, number = f"{name}-{number}", number + 1
        files[f"{unique}.smt2"] = document(obligation, line).encode()
    return files


def file_name(obligation: Obligation) -> str:
    """Return the name of an obligation's file, without its ending."""
    return re.sub(r"[^A-Za-z0-9_]+", "-", obligation.name).strip("-")

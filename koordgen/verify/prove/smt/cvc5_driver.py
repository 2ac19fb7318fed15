"""Server for the Python package cvc5, which reads commands on standard input like cvc5's executable.

The file runs in a separate process and imports nothing of koordgen. The command `(reset)` creates a new solver, so that
options can be set again.
"""

from __future__ import annotations

import os

import cvc5


def commands() -> None:
    manager = cvc5.TermManager()
    solver = cvc5.Solver(manager)
    symbols = cvc5.SymbolManager(manager)
    pending = ""
    while chunk := os.read(0, 1 << 16):
        pending += chunk.decode()
        while (end := boundary(pending)) >= 0:
            text, pending = pending[:end], pending[end:]
            if text.startswith("(reset)"):
                solver = cvc5.Solver(manager)
                solver.setOption("incremental", "true")
                symbols = cvc5.SymbolManager(manager)
                text = text.removeprefix("(reset)")
            run(solver, symbols, text)


def boundary(text: str) -> int:
    """Return the position after the next complete query in a text; -1 if no query is complete.

    Each query ends with an `echo` command."""
    start = text.find('(echo "')
    end = text.find(")\n", start) if start >= 0 else -1
    return end + 2 if end >= 0 else -1


def run(solver: cvc5.Solver, symbols: cvc5.SymbolManager, text: str) -> None:
    parser = cvc5.InputParser(solver, symbols)
    parser.setStringInput(cvc5.InputLanguage.SMT_LIB_2_6, text, "query")
    answer = ""
    try:
        while not (command := parser.nextCommand()).isNull():
            answer += command.invoke(solver, symbols)
    except Exception as error:
        print(answer + f'(error "{" ".join(str(error).split())}")')
        echo = text[text.rindex('(echo "') :]
        answer = echo.removeprefix('(echo "').removesuffix('")\n') + "\n"
    print(answer, end="", flush=True)


if __name__ == "__main__":
    commands()

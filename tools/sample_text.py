"""Draw docstrings, comments and messages of a room at random, to be judged by a reader.

    python tools/sample_text.py FOLDER [--seed SEED] [--count COUNT]

Each text is printed alone, without its context: an engineer who has never seen the project reads it once and calls it
plain, needs a second reading, or calls it a riddle. A room is accepted with 36 plain texts of 40 and no riddle.

A text is a docstring, a block of comment lines, or a string of at least four words that is an argument of a call or is
returned: a message. Generated files are left out. Prints the seed, and how many texts there are.

Exit status: 0, or 2 if the folder has no Python file.
"""

from __future__ import annotations

import argparse
import ast
import io
import random
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_FEWEST_WORDS = 4  # least number of words of a message; shorter strings are names, keys and fragments


def texts(path: Path) -> Iterator[tuple[int, str, str]]:
    """Yield each text of a file: its line, its kind, the text."""
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    docstrings = set()
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node):
            first = node.body[0]
            assert isinstance(first, ast.Expr)
            docstrings.add(id(first.value))
            yield first.lineno, "docstring", ast.get_docstring(node) or ""
    yield from _comments(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Call, ast.Return, ast.Assign)):
            values = node.args if isinstance(node, ast.Call) else [node.value] if node.value is not None else []
            for value in values:
                message = _message(value)
                if id(value) not in docstrings and len(message.split()) >= _FEWEST_WORDS:
                    yield value.lineno, "message", message


def _message(node: ast.expr) -> str:
    """Return the text of a string as a user sees it, with placeholders as `{...}`; "" if the node is no string."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_piece(value) for value in node.values)
    return ""


def _piece(value: ast.expr) -> str:
    if isinstance(value, ast.FormattedValue):
        return f"{{{ast.unparse(value.value)}}}"
    return str(value.value) if isinstance(value, ast.Constant) else ""


def _comments(source: str) -> Iterator[tuple[int, str, str]]:
    """Yield blocks of comments; lines below one another are one block."""
    block: list[str] = []
    start = last = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        text = token.string.lstrip("# ")
        if token.type != tokenize.COMMENT or text.startswith(("noqa", "type:", "fmt:", "!")):
            continue
        line = token.start[0]
        if block and line == last + 1 and token.line.lstrip().startswith("#"):
            block.append(text)
        else:
            if block:
                yield start, "comment", " ".join(block)
            block, start = [text], line
        last = line
    if block:
        yield start, "comment", " ".join(block)


def main(arguments: list[str] | None = None) -> int:
    """Print the sample."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40)
    given = parser.parse_args(arguments)
    files = sorted(path for path in given.folder.rglob("*.py") if "_generated" not in path.parts)
    found = [(path, *text) for path in files for text in texts(path)]
    if not found:
        print(f"{given.folder} has no Python file with a text", file=sys.stderr)
        return 2
    chosen = random.Random(given.seed).sample(found, min(given.count, len(found)))
    print(f"{given.folder}: {len(chosen)} of {len(found)} texts, seed {given.seed}\n")
    for number, (path, line, kind, text) in enumerate(chosen, 1):
        print(f"{number}. [{kind}] {path.name}:{line}\n{text}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

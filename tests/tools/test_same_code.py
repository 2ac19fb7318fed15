"""Test of tools/same_code.py on small repositories of two commits."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tools.same_code import main

Files = dict[str, str]
Compare = Callable[..., tuple[int, str]]

LINK = '''\
"""Links between robots."""

from __future__ import annotations

from os.path import join
from typing import TYPE_CHECKING

from app.limits import LIMIT
from app.text import shown as told

if TYPE_CHECKING:
    from app.text import Line

__all__ = ["Link", "open_link"]


class Link:
    """One link."""

    def __init__(self, path: str) -> None:
        self.path = join(path, "link")

    def send(self, line: Line) -> str:
        return told(line)[:LIMIT]


def open_link(path: str) -> Link:
    """Open a link."""
    from app.text import Line

    return Link(path or str(Line()))
'''
LIMITS = "LIMIT = 3\nOTHER = 4\n"
TEXT = "class Line:\n    pass\n\n\ndef shown(line: Line) -> str:\n    return str(line)\n"
APP: Files = {"app/__init__.py": "", "app/link.py": LINK, "app/limits.py": LIMITS, "app/text.py": TEXT}

MOVED: Files = {
    "app/__init__.py": "",
    "app/net/__init__.py": "",
    "app/net/link.py": LINK.replace("from app.limits import LIMIT", "from .. import sizes")
    .replace("[:LIMIT]", "[:sizes.LIMIT]")
    .replace("from app.text import shown as told", "import app.net.text")
    .replace("told(line)", "app.net.text.shown(line)")
    .replace("from app.text import Line", "from app.net.text import Line"),
    "app/sizes.py": LIMITS,
    "app/net/text.py": TEXT,
}


def git(folder: Path, *arguments: str) -> None:
    who = ["-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", *who, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def compare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Compare:
    """Commit two trees, and compare them. Return the exit status, and the output."""
    repository = tmp_path / "repository"
    repository.mkdir()
    monkeypatch.chdir(repository)
    git(repository, "init", "-q")

    def run(
        old: Files, new: Files, *paths: str, renames: str | None = None, text: str | None = None
    ) -> tuple[int, str]:
        for files in (old, new):
            if (repository / ".git/index").exists():
                git(repository, "rm", "-rqf", "--ignore-unmatch", ".")
            for path, content in files.items():
                (repository / path).parent.mkdir(parents=True, exist_ok=True)
                (repository / path).write_text(content)
            git(repository, "add", "-A")
            git(repository, "commit", "-qm", "Change", "--allow-empty")
        options = []
        for name, rules in (("renames", renames), ("text", text)):
            if rules is not None:
                (tmp_path / name).write_text(rules)
                options += [f"--{name}", str(tmp_path / name)]
        status = main(["HEAD~1", "HEAD", *paths, *options])
        printed = capsys.readouterr()
        return status, printed.out + printed.err

    return run


def test_a_move_passes_however_the_names_are_imported(compare: Compare) -> None:
    status, printed = compare(APP, MOVED)
    assert status == 0, printed
    assert "the same code" in printed


def test_imports_of_one_block_have_no_order(compare: Compare) -> None:
    """Sorted imports change their order when a module's path changes."""
    old = {
        "a.py": "def first() -> int:\n    return 1\n",
        "b.py": "def second() -> int:\n    return 2\n",
        "user.py": "def use() -> int:\n    import a\n    import b\n    return a.first() - b.second()\n",
    }
    new = {
        "z/a.py": old["a.py"],
        "b.py": old["b.py"],
        "user.py": "def use() -> int:\n    import b\n    from z import a\n    return a.first() - b.second()\n",
    }
    assert compare(old, new)[0] == 0
    swapped = new | {"user.py": new["user.py"].replace("a.first() - b.second()", "b.second() - a.first()")}
    assert compare(old, swapped)[0] == 1


def test_options_may_stand_before_paths(compare: Compare, tmp_path: Path) -> None:
    compare(APP, MOVED)
    (tmp_path / "empty").write_text("")
    assert main(["HEAD~1", "HEAD", "--text", str(tmp_path / "empty"), "app"]) == 0


def test_a_move_with_a_changed_constant_fails_with_both_places(compare: Compare) -> None:
    status, printed = compare(APP, {**MOVED, "app/sizes.py": "\n" + LIMITS.replace("3", "5")})
    assert status == 1
    assert "app/limits.py:1 -> app/sizes.py:2: assignment LIMIT differs: old int 3, new int 5" in printed
    assert "1 differences" in printed


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("[:sizes.LIMIT]", "[:sizes.OTHER]", "class Link differs"),
        ('join(path, "link")', 'join("link", path)', "class Link differs"),
        ("from os.path import join", "from posixpath import join", "class Link differs"),
        ("    from app.net.text import Line\n\n", "    from app.sizes import OTHER as Line\n\n", "open_link differs"),
        ("from __future__ import annotations\n", "", "from __future__"),
        ('"open_link"]', '"shut_link"]', "__all__ names shut_link"),
        ("path or str", "path and str", "open_link differs: old Or, new And"),
        ("\n\ndef open_link", "\n\nEXTRA = 1\n\n\ndef open_link", "assignment EXTRA is new"),
        ("import app.net.text\n", "", "class Link differs"),
    ],
)  # fmt: skip
def test_a_move_that_changes_something_fails(compare: Compare, old: str, new: str, told: str) -> None:
    link = MOVED["app/net/link.py"]
    assert old in link
    status, printed = compare(APP, {**MOVED, "app/net/link.py": link.replace(old, new)})
    assert (status, told in printed) == (1, True), printed


def test_a_definition_that_is_gone_fails(compare: Compare) -> None:
    status, printed = compare(APP, {**MOVED, "app/sizes.py": "LIMIT = 3\n"})
    assert status == 1 and "app/limits.py:2 -> nowhere: assignment OTHER is gone" in printed


def test_a_rename_passes_only_with_the_file(compare: Compare) -> None:
    renamed = {path: text.replace("Link", "Channel").replace("told", "text") for path, text in APP.items()}
    renamed["app/link.py"] = renamed["app/link.py"].replace("self.path", "self.folder").replace("LIMIT", "MOST")
    renamed["app/limits.py"] = LIMITS.replace("LIMIT", "MOST")
    names = "# classes\nLink Channel\nLIMIT MOST\n"
    assert compare(APP, renamed)[0] == 1
    status, printed = compare(APP, renamed, renames=names)
    assert status == 1 and "identifier path, then identifier folder" in printed
    # The parameter `path` of open_link and __init__ keeps its name.
    assert compare(APP, renamed, renames=names + "path folder app/text.py\n")[0] == 1
    full = {p: t.replace("path: str", "folder: str").replace("path or", "folder or") for p, t in renamed.items()}
    full["app/link.py"] = (
        full["app/link.py"].replace("join(path", "join(folder").replace("Channel(path", "Channel(folder")
    )
    status, printed = compare(APP, full, renames=names + "path folder\n", text="")
    assert status == 0, printed


def test_a_rename_is_of_each_occurrence(compare: Compare) -> None:
    old = {"a.py": "class A:\n    def take(self): ...\n\n\ndef f(a):\n    return a.take(), a.take\n"}
    new = {"a.py": old["a.py"].replace("def take", "def get").replace("a.take()", "a.get()")}
    assert compare(old, new, renames="take get")[0] == 1
    assert compare(old, {"a.py": old["a.py"].replace("take", "get")}, renames="take get")[0] == 0


@pytest.mark.parametrize(
    "text",
    [
        "def f(old, new):\n    return old, new\n",
        "old = 1\nnew = 2\n",
        "class A:\n    def __init__(self):\n        self.old, self.new = 1, 2\n",
        "class A:\n    def old(self): ...\n    def new(self): ...\n",
    ],
)
def test_a_rename_must_not_join_two_names(compare: Compare, text: str) -> None:
    status, printed = compare({"a.py": text}, {"a.py": text.replace("old", "new")}, renames="old new")
    assert status == 1 and "the renames make 2 names of one scope new" in printed


def test_a_docstring_may_change_with_a_text_file_only(compare: Compare) -> None:
    changed = {
        path: text.replace("One link.", "A link.").replace("Links between", "Link of") for path, text in APP.items()
    }
    status, printed = compare(APP, changed)
    assert status == 1 and "'One link.', then 'A link.'" in printed
    assert compare(APP, changed, text="")[0] == 0
    assert compare(APP, {**changed, "app/limits.py": "LIMIT = 4\nOTHER = 4\n"}, text="")[0] == 1


def test_comments_and_layout_may_change(compare: Compare) -> None:
    changed = LINK.replace("import join", "import (\n    join,  # of folders\n)").replace("= join", "= \\\n   join")
    assert compare(APP, {**APP, "app/link.py": changed})[0] == 0


def test_strings_change_as_listed_and_in_one_direction(compare: Compare) -> None:
    old = {"a.py": 'TABLE = {"x": "app.old.f"}\n\n\ndef f(n):\n    return f"{n} gave way"\n'}
    new = {"a.py": old["a.py"].replace("app.old.f", "app.new.f").replace(" gave way", " lost")}
    rules = '["app.old.f", "app.new.f"]\n\n# messages\n[" gave way", " lost"]\n'
    assert compare(old, new)[0] == compare(old, new, text='["app.old.f", "app.new.f"]')[0] == 1
    assert compare(old, new, text=rules)[0] == 0
    status, printed = compare(new, old, text=rules)
    assert status == 1 and "has the string 'app.new.f', then 'app.old.f'" in printed


def test_equal_definitions_find_their_partners_by_their_neighbours(compare: Compare) -> None:
    body = "def size():\n    return BASE\n\n\ndef {}():\n    return size()\n"
    old = {"a.py": "BASE = 1\n" + body.format("a"), "b.py": "BASE = 2\n" + body.format("b")}
    assert compare(old, {"x.py": old["b.py"], "y.py": old["a.py"]})[0] == 0
    swapped = {"x.py": "BASE = 1\n" + body.format("b"), "y.py": "BASE = 2\n" + body.format("a")}
    status, printed = compare(old, swapped)
    assert status == 1 and "refers to function size" in printed


def test_definitions_of_one_name_must_not_meet_in_one_module(compare: Compare) -> None:
    old = {"a.py": "def f():\n    return 1\n", "b.py": "def f():\n    return 2\n"}
    status, printed = compare(old, {"a.py": old["a.py"] + "\n\n" + old["b.py"]})
    assert status == 1 and "b.py:1 -> a.py:5: function f hides that at a.py:1" in printed


def test_a_name_from_another_module_is_another_name(compare: Compare) -> None:
    old = {
        "a.py": "LIMIT = 1\n",
        "b.py": "LIMIT = 2\n",
        "c.py": "from a import LIMIT\n\n\ndef f():\n    return LIMIT\n",
    }
    status, printed = compare(old, {**old, "c.py": old["c.py"].replace("from a", "from b")})
    assert (
        status == 1
        and "c.py:5 -> c.py:5: function f refers to assignment LIMIT at a.py:1, then to that at b.py:1" in printed
    )
    through = {**old, "d.py": "from a import *\n", "c.py": old["c.py"].replace("from a", "from d")}
    assert compare(old, through)[0] == 0


def test_a_parameter_is_not_the_module_variable_of_its_name(compare: Compare) -> None:
    old = {"a.py": "n = 1\n\n\ndef f(m):\n    return [n for k in range(m)]\n"}
    assert compare(old, {"a.py": old["a.py"].replace("for k", "for n")}, renames="k n")[0] == 1
    assert compare(old, {"a.py": old["a.py"].replace("(m)", "(n)")}, renames="m n")[0] == 1


def test_paths_limit_what_is_compared(compare: Compare) -> None:
    changed = {**APP, "app/limits.py": "LIMIT = 9\nOTHER = 4\n"}
    assert compare(APP, changed, "app/link.py")[0] == 0
    assert compare(APP, changed, "app/link.py", "app/limits.py")[0] == compare(APP, changed, "app")[0] == 1


@pytest.mark.parametrize(
    ("rules", "told"),
    [
        ({"renames": "one\n"}, "renames:1: expected `OLD_NAME NEW_NAME [PATH]`"),
        ({"text": '["a"]\n'}, "text:1: expected a JSON list of two strings"),
        ({"text": '["a", 1]\n'}, "text:1: expected a JSON list of two strings"),
    ],
)
def test_files_of_rules_that_cannot_be_read(compare: Compare, rules: dict[str, str], told: str) -> None:
    status, printed = compare(APP, APP, **rules)
    assert status == 2 and told in printed


def test_commits_that_cannot_be_read(compare: Compare, capsys: pytest.CaptureFixture[str]) -> None:
    status, printed = compare({"a.py": "x = 1\n"}, {"a.py": "x = = 1\n"})
    assert status == 2 and "a.py" in printed
    assert main(["HEAD~1", "nothing"]) == 2
    assert "nothing" in capsys.readouterr().err

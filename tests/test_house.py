"""House rules that a linter does not know: size of files, swallowed errors, hidden time and chance, machine paths."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Callable, Iterator

import pytest

from tests.house import PACKAGE, ROOT, imports, package_files, place, text_files
from tools.house.structure import MAX_FILE_LINES

MAY_CATCH_ALL = ("jobs/", "nodes/", "cli/")  # there an exception becomes an event or an exit status
MAY_READ_TIME = ("base/clock.py",)
PYTHON_FOLDERS = (PACKAGE, "tests", "tools")
FOREIGN = re.compile(
    r"(?<![\w.~-])/(?:root|work|tmp|home/\w+)/|files\.python" + r"hosted|deb\.deb" + r"ian\.org|registry\.npm" + "js"
)
BLOCK = ("init", "step")
SEEDED = {"BitGenerator", "Generator", "PCG64", "Philox", "SeedSequence", "default_rng"}

Check = Callable[[str, str], list[str]]


def too_long(source: str, inside: str) -> list[str]:
    count = len(source.splitlines())
    return [f"{inside} has {count} lines, more than {MAX_FILE_LINES}"] if count > MAX_FILE_LINES else []


def swallowed(source: str, inside: str) -> list[str]:
    """Bare excepts anywhere; catch-alls outside the places that turn them into an event, unless they raise again."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ExceptHandler):
            continue
        caught = ast.unparse(node.type) if node.type else ""
        if not caught:
            found.append(f"{inside}:{node.lineno} bare except")
        elif not re.search(r"\b(Base)?Exception\b", caught) or ast.unparse(node.body[-1]) == "raise":
            continue
        elif not inside.startswith(MAY_CATCH_ALL):
            found.append(f"{inside}:{node.lineno} catches {caught}")
        elif isinstance(node.body[0], ast.Pass):
            found.append(f"{inside}:{node.lineno} swallows {caught}")
    return found


def prints(source: str, inside: str) -> list[str]:
    """Words for a person come from the command line; a node's process may say one on stderr."""
    if inside.startswith("cli/"):
        return []
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    found = []
    for call in calls:
        aside = inside.startswith("nodes/") and any(ast.unparse(word) == "file=sys.stderr" for word in call.keywords)
        if getattr(call.func, "id", "") == "print" and not aside:
            found.append(f"{inside}:{call.lineno} prints")
    return found


def undocumented(source: str, inside: str) -> list[str]:
    """Modules and public functions say what they are for; a Block's init and step are described by the contract."""
    tree = ast.parse(source)
    found = [] if ast.get_docstring(tree) or not tree.body else [f"{inside} has no docstring"]
    for node in (node for node in tree.body if isinstance(node, ast.FunctionDef)):
        if not (node.name in BLOCK or node.name.startswith("_") or ast.get_docstring(node)):
            found.append(f"{inside}:{node.lineno} {node.name} has no docstring")
    return found


def hidden_chance(source: str, inside: str) -> list[str]:
    """Time and chance are arguments: no wall time outside the clock, no generator without a seed."""
    named = [(line, name) for line, name in imports(source) if name.startswith("random.") and name != "random.Random"]
    found = [f"{inside}:{line} imports {name}" for line, name in named]
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Attribute):
            continue
        text = ast.unparse(node)
        if re.fullmatch(r"random\.\w+", text) and node.attr != "Random":
            found.append(f"{inside}:{node.lineno} {text} draws from a global generator")
        if re.fullmatch(r"(np|numpy)\.random\.\w+", text) and node.attr not in SEEDED:
            found.append(f"{inside}:{node.lineno} {text} draws from a global generator")
        if re.fullmatch(r"time\.time(_ns)?", text) and inside not in MAY_READ_TIME:
            found.append(f"{inside}:{node.lineno} {text}: take a Clock, or time.monotonic for a duration")
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Call)
            and not node.args
            and re.search(r"default_rng$|\bRandom$", ast.unparse(node.func))
        ):
            found.append(f"{inside}:{node.lineno} {ast.unparse(node)} without a seed")
    return found


def machine_words(text: str, name: str) -> Iterator[str]:
    """Paths of one machine and hosts of registries, which no tracked file may hold."""
    for number, line in enumerate(text.splitlines(), 1):
        found = FOREIGN.search(line)
        if found:
            yield f"{name}:{number} holds {found[0]!r}"


CHECKS: tuple[Check, ...] = (swallowed, prints, undocumented, hidden_chance)


@pytest.mark.parametrize("check", CHECKS)
def test_the_package_obeys(check: Check) -> None:
    found = [line for path in package_files() for line in check(path.read_text(encoding="utf-8"), place(path))]
    assert not found, "\n".join(found)


def test_no_file_is_too_long() -> None:
    paths = [path for folder in PYTHON_FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))]
    found = [line for path in paths for line in too_long(path.read_text(encoding="utf-8"), str(path.relative_to(ROOT)))]
    assert not found, "\n".join(found)


def test_no_file_names_a_machine() -> None:
    found = []
    for path in text_files():
        found += machine_words(path.read_text(encoding="utf-8"), str(path.relative_to(ROOT)))
    assert not found, "\n".join(found)


def test_nothing_is_tracked_that_is_ignored_and_no_link_is() -> None:
    """A link to one machine's folder is another folder, or none, in every other clone."""

    def said(*words: str) -> list[str]:
        call = subprocess.run(["git", "ls-files", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return call.stdout.splitlines()

    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    assert said("--cached", "--ignored", "--exclude-per-directory=.gitignore") == []
    assert [line for line in said("--stage") if line.startswith("120000")] == []


def test_nothing_is_left_to_do() -> None:
    """A planned thing stands in an issue, not in the source."""
    mark = re.compile(r"\b(TO" + r"DO|FIX" + r"ME|XX" + r"X)\b")
    found = [str(path.relative_to(ROOT)) for path in package_files() if mark.search(path.read_text(encoding="utf-8"))]
    assert not found


@pytest.mark.parametrize(
    ("check", "source"),
    [
        (too_long, "x = 1\n" * (MAX_FILE_LINES + 1)),
        (swallowed, "try:\n    pass\nexcept:\n    raise"),
        (swallowed, "try:\n    pass\nexcept Exception as error:\n    print(error)"),
        (swallowed, "try:\n    pass\nexcept (OSError, BaseException):\n    return 1"),
        (swallowed, "try:\n    pass\nexcept BaseException:\n    if x:\n        raise\n    y = 1"),
        (prints, "def f():\n    print(1)"),
        (undocumented, "x = 1"),
        (undocumented, '"""Module."""\ndef f():\n    return 1'),
        (hidden_chance, "import random\nx = random.random()"),
        (hidden_chance, "from random import gauss"),
        (hidden_chance, "import random\nx = random.Random()"),
        (hidden_chance, "import numpy as np\nx = np.random.rand(3)"),
        (hidden_chance, "rng = np.random.default_rng()"),
        (hidden_chance, "import time\nt = time.time()"),
    ],
)
def test_a_planted_violation_is_found(check: Check, source: str) -> None:
    assert check(source, "grade/bad.py")


@pytest.mark.parametrize(
    ("check", "source", "inside"),
    [
        (too_long, "x = 1\n" * MAX_FILE_LINES, "grade/good.py"),
        (swallowed, "try:\n    pass\nexcept Exception as error:\n    say(error)", "jobs/good.py"),
        (swallowed, "try:\n    pass\nexcept BaseException:\n    x.close()\n    raise", "grade/good.py"),
        (swallowed, "try:\n    pass\nexcept OSError:\n    pass", "grade/good.py"),
        (prints, "print(1)", "cli/good.py"),
        (prints, "print(1, file=sys.stderr)", "nodes/good.py"),
        (undocumented, '"""Module."""\ndef _f():\n    return 1', "grade/good.py"),
        (hidden_chance, "rng = np.random.default_rng(7)\nt = time.monotonic()\nr = random.Random(7)", "grade/good.py"),
    ],
)
def test_good_code_is_fine(check: Check, source: str, inside: str) -> None:
    assert check(source, inside) == []


@pytest.mark.parametrize("folder", ["root", "work", "tmp"])
def test_a_planted_machine_path_is_found(folder: str) -> None:
    assert list(machine_words(f"see /{folder}/notes.txt", "README.md"))
    assert list(machine_words(f"a relative path: docs/{folder}/notes.txt", "README.md")) == []

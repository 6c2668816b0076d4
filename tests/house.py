"""What the tests of the house share: the project's files, their imports, and the tables of
docs/explanation/architecture.md.

The document is the one list of floors, owners and allowed functions; these readers take it from there, so that a
table nobody checks cannot exist.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "tunefree_hil"
ARCHITECTURE = ROOT / "docs" / "explanation" / "architecture.md"
LOADERS = ("import_module", "load", "names")  # calls that import what a string names (base/parts.py)
TEXT_FOLDERS = (".ci", "bench_configs", "dbc", "docs", "tests", "tools", PACKAGE)
TEXT_SUFFIXES = ("", ".bash", ".cfg", ".dbc", ".in", ".ini", ".json", ".lock", ".md", ".py", ".sh", ".toml", ".txt")


class Import(NamedTuple):
    """One imported name: `target` is dotted, as far as the statement says."""

    line: int
    target: str


def package_files() -> list[Path]:
    """Every Python file of the package."""
    return sorted((ROOT / PACKAGE).rglob("*.py"))


def text_files() -> list[Path]:
    """Every text file that is (or is about to be) tracked: top level and the project's folders, no hidden caches."""
    found = [path for path in ROOT.iterdir() if path.is_file()]
    for folder in TEXT_FOLDERS:
        found += [path for path in (ROOT / folder).rglob("*") if path.is_file()]
    return sorted(path for path in found if path.suffix in TEXT_SUFFIXES and "__pycache__" not in path.parts)


def place(path: Path) -> str:
    """A file's path inside the package: 'control/lqr.py'."""
    return path.relative_to(ROOT / PACKAGE).as_posix()


def folder_of(inside: str) -> str:
    """The floor's member that a file belongs to: its top folder, or its own name at top level."""
    first = inside.split("/")[0]
    return first.removesuffix(".py")


def imports(source: str, module: str = PACKAGE + ".module") -> list[Import]:
    """All imports of a module, nested ones too, TYPE_CHECKING blocks left out; relative ones made absolute.

    `from package import name` gives 'package.name', so that a sub-module imported this way is seen. Project modules
    named by a string in a call of a loader (`parts.load("tunefree_hil.effects", ...)`) count as imported.
    """
    return sorted(_imports(ast.parse(source), module))


def _imports(node: ast.AST, module: str) -> Iterator[Import]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and _is_type_checking(child.test):
            for other in child.orelse:
                yield from _imports(ast.Module([other], []), module)
            continue
        if isinstance(child, ast.Import):
            yield from (Import(child.lineno, alias.name) for alias in child.names)
        elif isinstance(child, ast.ImportFrom):
            base = _absolute(child, module)
            yield from (Import(child.lineno, f"{base}.{alias.name}") for alias in child.names)
        elif isinstance(child, ast.Call):
            yield from _named_by_string(child)
        yield from _imports(child, module)


def _is_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


def _absolute(node: ast.ImportFrom, module: str) -> str:
    if not node.level:
        return node.module or ""
    above = module.split(".")[: -node.level]
    return ".".join([*above, *([node.module] if node.module else [])])


def _named_by_string(call: ast.Call) -> Iterator[Import]:
    called = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if called in LOADERS and call.args and isinstance(call.args[0], ast.Constant):
        value = call.args[0].value
        if isinstance(value, str) and value.startswith(PACKAGE + "."):
            yield Import(call.lineno, value)


def floors() -> dict[str, int]:
    """Folder -> floor, from the table of docs/explanation/architecture.md. Words in brackets are plans and do not
    count."""
    table: dict[str, int] = {}
    for line in ARCHITECTURE.read_text(encoding="utf-8").splitlines():
        row = re.match(r"(\d)  (\S.*)", line)
        if row:
            members = re.split(r"\s{2,}", re.sub(r"\(.*?\)", "", row[2]).strip())[0]
            table.update({name.strip(): int(row[1]) for name in members.split("|")})
    return table


def owners() -> dict[str, list[str]]:
    """Third-party library -> folders ('bus/') or files ('base/kernel.py') that may import it."""
    text = ARCHITECTURE.read_text(encoding="utf-8")
    found = re.search(r"Third-party owners:(.*?)\. Nodes import", text, re.DOTALL)
    table: dict[str, list[str]] = {}
    for clause in re.sub(r"\(.*?\)", "", found[1] if found else "", flags=re.DOTALL).split(";"):
        libraries, only, places = clause.partition(" only ")
        if only:
            table.update({name: re.findall(r"`([^`]+)`", places) for name in re.findall(r"`([^`]+)`", libraries)})
    return table


def kernel_maths() -> set[str]:
    """The functions of `math` that a kernel may call."""
    found = re.search(r"Only `math\.([^`]+)`", ARCHITECTURE.read_text(encoding="utf-8"))
    return set(found[1].split()) if found else set()

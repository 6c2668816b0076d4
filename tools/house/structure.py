"""Lengths of files and functions, files a folder, bare tuples returned, and decisions that read a sentence."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

MAX_FILE_LINES = 500
MAX_FUNCTION_LINES = 40
MAX_FOLDER_FILES = 15  # `__init__.py` and `__main__.py` are not counted
MAX_BARE_VALUES = 2  # that a function may return without a record


class Place(NamedTuple):
    """A line of a file and the name or number found there."""

    line: int
    name: str
    number: int


def long_functions(source: str) -> list[Place]:
    """Functions of more than MAX_FUNCTION_LINES lines, without their docstring and the lines of nested functions."""
    lengths = [(node, _length(node)) for node in _functions(ast.parse(source))]
    return [Place(node.lineno, node.name, length) for node, length in lengths if length > MAX_FUNCTION_LINES]


def _length(node: ast.FunctionDef) -> int:
    first = node.body[0]
    apart = [inner for inner in _functions(node) if inner is not node]
    if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
        return _lines(node) - _lines(first) - sum(map(_lines, apart))
    return _lines(node) - sum(map(_lines, apart))


def _lines(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def bare_tuples(source: str) -> list[Place]:
    """Functions whose annotation says that they return three or more values without a record."""
    found = []
    for node in _functions(ast.parse(source)):
        count = max((_tuple_length(part) for part in ast.walk(node.returns)), default=0) if node.returns else 0
        if count > MAX_BARE_VALUES and not _is_kernel(node):
            found.append(Place(node.lineno, node.name, count))
    return found


def _functions(tree: ast.AST) -> Iterator[ast.FunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


def _is_kernel(node: ast.FunctionDef) -> bool:
    """Whether a function is compiled: there a record costs nothing, but a vector of equal numbers may be a tuple."""
    return any("kernel" in ast.unparse(decorator) for decorator in node.decorator_list)


def _tuple_length(node: ast.AST) -> int:
    if not (isinstance(node, ast.Subscript) and ast.unparse(node.value) in ("tuple", "Tuple")):
        return 0
    parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else []
    return 0 if any(isinstance(part, ast.Constant) and part.value is ... for part in parts) else len(parts)


def crowded_folders(files: Iterable[Path]) -> dict[Path, int]:
    """Folder -> number of Python files, for folders with more than MAX_FOLDER_FILES."""
    counts = Counter(path.parent for path in files if path.stem not in ("__init__", "__main__"))
    return {folder: count for folder, count in sorted(counts.items()) if count > MAX_FOLDER_FILES}


def sentence_decisions(source: str) -> list[Place]:
    """Comparisons and searches of text with a sentence of our own: a constant that holds a space between words.

    Such a test breaks when somebody rewords the sentence; a decision reads an enum or a record.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        texts: list[ast.expr] = []
        if isinstance(node, ast.Compare):
            texts = [node.left, *node.comparators]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            texts = list(node.args) if node.func.attr in ("startswith", "endswith") else []
        found += [Place(node.lineno, text, 0) for part in texts for text in _sentences(part)]
    return found


def _sentences(node: ast.expr) -> list[str]:
    parts = node.elts if isinstance(node, ast.Tuple | ast.List | ast.Set) else [node]
    texts = [part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    return [text for text in texts if " " in text.strip()]

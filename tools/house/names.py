"""Stop words among the names that Python code binds, duplicate class names, and denied module names."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

# Words that say nothing about what a name holds. Bound in a one-line comprehension or a lambda they are fine.
STOP_WORDS = frozenset(
    ("one", "some", "by", "at", "here", "there", "was", "now", "what", "who", "said", "found", "told", "held", "kept")
    + ("asked", "own", "other", "every", "these", "those", "much", "many", "way", "whoever", "somebody", "nobody")
)

# Participles, adverbs, pronouns and words of everyday life: a module is a noun phrase of the field.
DENIED_MODULES = frozenset(
    ("told", "kept", "held", "dealt", "usual", "lost", "unseen", "taken_back", "sift", "feet", "shelf", "ride", "words")
    + ("look_first", "by_motion", "by_pose", "borne_out", "hearing", "heard", "ears", "eyes", "seen", "asked", "wish")
    + ("strangers", "harvest", "serving", "holding", "filling", "ending", "claims", "mirror", "slots", "gentle", "pick")
    + ("ground", "waves", "late", "carriage", "relaxing", "board", "guard", "invented", "outside", "shown", "ahead")
    + ("guided", "needs", "sound", "acted", "enough", "decide", "rivals", "suspects", "pays", "shrink", "leftover")
    + ("team", "ask", "work", "null", "steps", "scan")
)


class BindingCount(NamedTuple):
    """Names bound in a file or a package, and which of them are stop words with their lines."""

    bindings: int
    stop_words: tuple[tuple[int, str], ...]

    @property
    def share_percent(self) -> float:
        """Stop words in percent of all bindings; 0 where nothing is bound."""
        return 100.0 * len(self.stop_words) / self.bindings if self.bindings else 0.0


def count_bindings(source: str) -> BindingCount:
    """Count the assigned names, arguments, functions and classes of a source text."""
    tree = ast.parse(source)
    excused = _short_lived(tree)
    bound = [(line, name) for line, name, node in _bindings(tree) if id(node) not in excused]
    return BindingCount(len(bound), tuple(pair for pair in bound if pair[1].strip("_").lower() in STOP_WORDS))


def _bindings(tree: ast.AST) -> Iterator[tuple[int, str, ast.AST]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id, node
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg, node
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.lineno, node.name, node


def _short_lived(tree: ast.AST) -> set[int]:
    """Nodes that are bound in a one-line comprehension or as a lambda's argument."""
    excused: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
            if node.lineno == node.end_lineno:
                excused.update(id(target) for loop in node.generators for target in ast.walk(loop.target))
        elif isinstance(node, ast.Lambda):
            excused.update(id(argument) for argument in ast.walk(node.args))
    return excused


def class_names(source: str) -> list[str]:
    """Names of all classes that a source text defines, nested ones too."""
    return [node.name for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)]


def duplicate_classes(paths: Iterable[Path]) -> dict[str, list[Path]]:
    """Class name -> the files that define it, for names that are defined more than once."""
    files: dict[str, list[Path]] = {}
    for path in paths:
        for name in class_names(path.read_text(encoding="utf-8")):
            files.setdefault(name, []).append(path)
    return {name: places for name, places in sorted(files.items()) if len(places) > 1}


def total(counts: Iterable[BindingCount]) -> BindingCount:
    """The sum of several counts."""
    counts = list(counts)
    return BindingCount(sum(c.bindings for c in counts), tuple(pair for c in counts for pair in c.stop_words))


def frequent_stop_words(counts: Iterable[BindingCount]) -> dict[str, int]:
    """Stop word -> how often it is bound, most frequent first."""
    return dict(Counter(name for c in counts for _, name in c.stop_words).most_common())

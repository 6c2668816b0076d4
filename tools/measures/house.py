"""How far the package keeps its own rules: names, lengths, folders, references, words of the documents."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tools.house import documents, names, structure

VALUE = "percent of the names bound in the package that are stop words (1.5 is the most it may have)"
ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "tunefree_hil"
TEXT_SUFFIXES = (".py", ".md", ".toml", ".dbc", ".c", ".h", ".sh", "")


def measure() -> dict[str, Any]:
    """Count over the package's files as they are now. n: names bound."""
    files = sorted(PACKAGE.rglob("*.py"))
    sources = {path: path.read_text(encoding="utf-8") for path in files}
    counts = {path: names.count_bindings(source) for path, source in sources.items()}
    whole = names.total(counts.values())
    folders = sorted({_top(path) for path in files})
    docs = [path for path in sorted((ROOT / "docs").rglob("*.md")) if "results" not in path.parts]
    detail = {
        "by_package_percent": {f: round(_share(counts, f).share_percent, 2) for f in folders},
        "frequent": dict(list(names.frequent_stop_words(counts.values()).items())[:10]),
        "files": len(files),
        "lines": {"package": sum(map(_lines, sources.values()))}
        | {f: sum(_lines(source) for path, source in sources.items() if _top(path) == f) for f in folders},
        "duplicate_class_names": len(names.duplicate_classes(files)),
        "functions_returning_three_bare_values": sum(len(structure.bare_tuples(s)) for s in sources.values()),
        "functions_over_40_lines": sum(len(structure.long_functions(s)) for s in sources.values()),
        "decisions_on_sentences": sum(len(structure.sentence_decisions(s)) for s in sources.values()),
        "absent_references": sum(len(documents.absent_references(path.read_text("utf-8"))) for path in _texts()),
        "crowded_folders": {
            folder.relative_to(ROOT).as_posix(): count for folder, count in structure.crowded_folders(files).items()
        },
        "words": {"README": documents.count_words([ROOT / "README.md"]), "docs": documents.count_words(docs)},
    }
    value = round(whole.share_percent, 3)
    return {"value": value, "unit": "percent", "n": whole.bindings, "low": None, "high": None, "detail": detail}


def _top(path: Path) -> str:
    inside = path.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else "top"


def _share(counts: dict[Path, names.BindingCount], folder: str) -> names.BindingCount:
    return names.total(count for path, count in counts.items() if _top(path) == folder)


def _lines(source: str) -> int:
    return len(source.splitlines())


def _texts() -> list[Path]:
    folders = ("tunefree_hil", "tests", "tools", "docs", "dbc", "bench_configs", ".ci")
    found = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    found += [ROOT / "README.md", ROOT / "Makefile"]
    kept = [path for path in found if path.suffix in TEXT_SUFFIXES and "__pycache__" not in path.parts]
    return [path for path in kept if (path.parent.name, path.name) != ("house", "documents.py")]

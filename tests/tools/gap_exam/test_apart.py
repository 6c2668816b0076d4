"""The exam and the package that it examines know nothing of each other: by their imports, and when they are loaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import PACKAGE, ROOT, imports, package_files

EXAM = ROOT / "tools" / "gap_exam"
FILES = sorted(EXAM.glob("*.py"))


def foreign(source: str) -> list[str]:
    """Imports of the exam that it must not have."""
    return [target for _, target in imports(source, "tools.gap_exam.module") if target.split(".")[0] == PACKAGE]


def towards_the_exam(source: str) -> list[str]:
    """What leads from the package to the exam: imports of tools, or its name."""
    found = [target for _, target in imports(source) if target.split(".")[0] == "tools"]
    return found + (["its name"] if "gap_exam" in source else [])


def test_the_exam_imports_nothing_of_the_package() -> None:
    assert len(FILES) > 20
    found = {path.name: foreign(path.read_text()) for path in FILES}
    assert not {name: targets for name, targets in found.items() if targets}


def test_the_package_knows_nothing_of_the_exam() -> None:
    found = {str(path): towards_the_exam(path.read_text()) for path in package_files()}
    assert not {name: targets for name, targets in found.items() if targets}


@pytest.mark.parametrize(
    "source",
    ["import tunefree_hil", "from tunefree_hil.plant import body", "def f():\n    import tunefree_hil.effects.payload"],
)
def test_a_planted_import_of_the_exam_is_found(source: str) -> None:
    assert foreign(source)


@pytest.mark.parametrize("source", ["from tools.gap_exam import car", "import tools", "name = 'gap_exam'"])
def test_a_planted_way_to_the_exam_is_found(source: str) -> None:
    assert towards_the_exam(source)


@pytest.mark.slow
def test_loading_all_of_it_loads_nothing_of_the_package(tmp_path: Path) -> None:
    names = [f"tools.gap_exam.{path.stem}" for path in FILES if path.stem not in ("__init__", "__main__")]
    script = f"import sys, importlib\nfor name in {names!r}: importlib.import_module(name)\n"
    script += f"print([name for name in sys.modules if name.split('.')[0] == {PACKAGE!r}])"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=100)
    assert done.stdout == "[]\n", done.stderr

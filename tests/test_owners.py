"""Each third-party library has one owner in the package (docs/explanation/architecture.md); tools/ and tests/ are free.

Also: what a node's process imports is small. An un-jitted node takes 150 MB at most (docs/reference/design.md), and
each of the libraries named here costs 45 MB or more.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.house import PACKAGE, ROOT, imports, owners, package_files, place

OWNERS = owners()
ANYWHERE = {"numpy"}  # but not in kernels: tests/test_kernels.py
HEAVY = ("matplotlib", "numba", "optuna", "rich", "scipy", "torch")


def strangers(source: str, inside: str) -> list[str]:
    """Complaints about one file of the package: libraries that it does not own, or that nobody owns."""
    complaints = []
    for line, target in imports(source, f"{PACKAGE}.{inside.removesuffix('.py').replace('/', '.')}"):
        library = target.split(".")[0]
        if library in sys.stdlib_module_names or library in ANYWHERE or library == PACKAGE:
            continue
        places = OWNERS.get(library, [])
        if not any(inside == where or (where.endswith("/") and inside.startswith(where)) for where in places):
            may = f"only {', '.join(places)} may" if places else "it has no owner in docs/explanation/architecture.md"
            complaints.append(f"{inside}:{line} imports {library}: {may}")
    return complaints


def modules_of(folder: str) -> list[str]:
    """The importable modules of one folder of the package."""
    files = sorted((ROOT / PACKAGE / folder).rglob("*.py"))
    dotted = [f"{PACKAGE}." + place(path).removesuffix(".py").replace("/", ".") for path in files]
    return [name.removesuffix(".__init__") for name in dotted]


def heavy_after(code: str) -> list[str]:
    """Which heavy libraries a fresh interpreter holds after running `code`."""
    tail = f"import sys; print(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{tail}"], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_the_table_of_owners_is_read() -> None:
    assert OWNERS["can"] == OWNERS["cantools"] == OWNERS["serial"] == ["bus/"]
    assert OWNERS["asammdf"] == OWNERS["rosbags"] == OWNERS["apsw"] == ["bus/formats/"]
    assert OWNERS["numba"] == ["base/kernel.py"]
    assert OWNERS["msgspec"] == ["config/"]
    assert "numpy" not in OWNERS


def test_libraries_stay_with_their_owners() -> None:
    complaints = [line for path in package_files() for line in strangers(path.read_text(), place(path))]
    assert not complaints, "\n".join(complaints)


@pytest.mark.parametrize(
    ("inside", "source"),
    [
        ("nodes/bad.py", "import can"),
        ("nodes/bad.py", "def late():\n    import can.interfaces.virtual"),
        ("base/bad.py", "from numba import njit"),
        ("tune/bad.py", "from matplotlib import pyplot"),
        ("jobs/bad.py", "from rich.console import Console"),
        ("plant/bad.py", "import pandas"),
    ],
)
def test_a_planted_stranger_is_found(inside: str, source: str) -> None:
    assert strangers(source, inside)


def test_owners_may() -> None:
    assert strangers("from numba import njit", "base/kernel.py") == []
    assert strangers("import can, cantools, serial\nimport numpy as np\nimport os.path", "bus/adapter.py") == []
    assert strangers("if TYPE_CHECKING:\n    import can", "nodes/node.py") == []


def test_no_module_of_a_node_imports_anything_heavy() -> None:
    """All in one interpreter, for each costs a second to start."""
    assert heavy_after(f"import {', '.join(modules_of('nodes'))}") == []


@pytest.mark.parametrize("name", ["ecu", "controller"])
def test_the_process_of_a_node_imports_nothing_heavy(name: str) -> None:
    """The whole closure of the process: entry module, bench, parts."""
    assert f"{PACKAGE}.nodes.{name}" in modules_of("nodes"), f"nodes/{name}.py is missing"
    assert heavy_after(f"import {PACKAGE}.bench, {PACKAGE}.jobs.{name}") == []


def test_a_planted_heavy_import_is_found() -> None:
    assert heavy_after("import rich") == ["rich"]

"""A module imports its own folder and lower floors only (docs/explanation/architecture.md)."""

from __future__ import annotations

import pytest

from tests.house import PACKAGE, floors, folder_of, imports, package_files, place

TOP = 8
FLOORS = {**floors(), "__main__": TOP + 1, "__init__": 0}  # __main__ starts the command line


def upward_imports(source: str, inside: str) -> list[str]:
    """Complaints about one file of the package, `inside` being its path there."""
    own = folder_of(inside)
    if own not in FLOORS:
        return [f"{inside}: {own} stands on no floor of docs/explanation/architecture.md"]
    module = f"{PACKAGE}.{inside.removesuffix('.py').replace('/', '.')}"
    complaints = []
    for line, target in imports(source, module):
        names = target.split(".")
        if names[0] != PACKAGE or len(names) < 2 or names[1] in (own, "__version__"):
            continue
        if names[1] not in FLOORS:
            complaints.append(f"{inside}:{line} imports {target}, which stands on no floor")
        elif FLOORS[names[1]] >= FLOORS[own]:
            complaints.append(
                f"{inside}:{line} ({own}, floor {FLOORS[own]}) imports {names[1]} (floor {FLOORS[names[1]]})"
            )
    return complaints


def test_the_table_of_floors_is_read() -> None:
    table = floors()
    assert table["base"] == 0 and table["cli"] == TOP
    assert table["grade"] == table["nodes"] == 3
    assert table["plant"] == table["control"] == table["effects"] == table["bus"] == table["config"] == 1


def test_imports_point_down() -> None:
    complaints = [line for path in package_files() for line in upward_imports(path.read_text(), place(path))]
    assert not complaints, "\n".join(complaints)


@pytest.mark.parametrize(
    ("inside", "source"),
    [
        ("bus/bad.py", "from tunefree_hil.nodes import ecu"),
        ("bus/bad.py", "import tunefree_hil.nodes.ecu"),
        ("plant/bad.py", "from tunefree_hil.control.lqr import gains"),
        ("plant/bad.py", "from ..control import lqr"),
        ("plant/bad.py", "from tunefree_hil import bench"),
        ("grade/bad.py", "def late():\n    from tunefree_hil.tune import study"),
        ("base/bad.py", "from tunefree_hil.base import parts\nparts.load('tunefree_hil.effects', name, 'EFFECT')"),
        ("nodes/bad.py", "if TYPE_CHECKING:\n    import a\nelse:\n    import tunefree_hil.tune"),
        ("strange/bad.py", "import math"),
        ("bus/bad.py", "import tunefree_hil.strange"),
        ("bench.py", "from tunefree_hil.jobs.drive import drive"),
    ],
)
def test_a_planted_violation_is_found(inside: str, source: str) -> None:
    assert upward_imports(source, inside)


@pytest.mark.parametrize(
    ("inside", "source"),
    [
        ("nodes/good.py", "from tunefree_hil.bus.dbc.codec import Codec\nfrom tunefree_hil.nodes import node"),
        ("plant/good.py", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from tunefree_hil import bench"),
        ("control/lateral/good.py", "from .. import cascade"),
        ("jobs/good.py", "from tunefree_hil import __version__, bench"),
        ("__main__.py", "from tunefree_hil.cli import main"),
    ],
)
def test_a_downward_import_is_fine(inside: str, source: str) -> None:
    assert upward_imports(source, inside) == []

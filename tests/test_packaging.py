"""What is declared, what is locked and what is installed agree; the Makefile says what a machine lacks."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.house import ROOT, imports, package_files

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
BY_NAME = {"python-can", "cantools", "torch", "numpy", "optuna", "pyserial", "rich", "pytest"}


def declared(words: list[str]) -> list[Requirement]:
    return [Requirement(word) for word in words]


def locked(name: str) -> dict[str, str]:
    """Package -> version of a lock file and of those that it names."""
    pins: dict[str, str] = {}
    for line in (ROOT / name).read_text().splitlines():
        if line.startswith("-r "):
            pins.update(locked(line.removeprefix("-r ")))
        elif line and not line.startswith("#"):
            package, _, version = line.partition("==")
            pins[canonicalize_name(package)] = version
    return pins


@pytest.mark.parametrize(
    ("words", "lock"),
    [
        (PROJECT["dependencies"], "requirements.lock"),
        *((words, "requirements-test.lock") for words in EXTRAS.values()),
    ],
)
def test_every_dependency_is_locked_within_its_bounds(words: list[str], lock: str) -> None:
    pins = locked(lock)
    loose = [
        requirement.name
        for requirement in declared(words)
        if not requirement.specifier.contains(pins.get(canonicalize_name(requirement.name), "0"), prereleases=True)
    ]
    assert not loose


def undeclared(libraries: set[str], declared_names: set[str]) -> set[str]:
    """Imported libraries of which no distribution is declared."""
    known = packages_distributions()
    names = {canonicalize_name(name) for name in declared_names}
    return {one for one in libraries if not names & {canonicalize_name(name) for name in known.get(one, [one])}}


def names_of(*extras: str) -> set[str]:
    """Every install has the dependencies; an extra adds its own."""
    words = [word for extra in extras for word in EXTRAS[extra]]
    return {requirement.name for requirement in declared([*PROJECT["dependencies"], *words])}


def third_party(files: Iterable[Path]) -> set[str]:
    """The libraries that these files import."""
    libraries = {name.split(".")[0] for path in files for _, name in imports(path.read_text())}
    return libraries - sys.stdlib_module_names - {"tunefree_hil", "tests", "tools", "conftest"}


def test_what_is_imported_is_declared() -> None:
    names = names_of(*(extra for extra in EXTRAS if extra != "test"))
    assert undeclared(third_party(package_files()), names) == set()
    assert undeclared({"can", "hypothesis"}, names) == {"hypothesis"}


def test_what_tests_and_tools_import_is_declared() -> None:
    files = [path for folder in ("tests", "tools") for path in (ROOT / folder).rglob("*.py")]
    assert undeclared(third_party(files), names_of(*EXTRAS)) == set()


def test_locks_pin_exact_versions_and_no_local_builds() -> None:
    pins = locked("requirements-test.lock")
    assert all(version and "+" not in version for version in pins.values())


def test_the_packages_stand_by_name() -> None:
    names = {requirement.name for requirement in declared(PROJECT["dependencies"])}
    assert not {"torch", "pytest"} & names
    extras = {requirement.name for words in EXTRAS.values() for requirement in declared(words)}
    assert names | extras >= BY_NAME


def test_tune_needs_no_torch() -> None:
    assert "torch" not in locked("requirements.lock")
    assert locked("requirements-test.lock")["torch"] == "2.13.0"


@pytest.mark.parametrize(
    ("fails_at", "says"),
    [("version_info", "Python 3.11 or newer is needed"), ("ensurepip", "apt-get install python3-venv")],
)
def test_make_says_what_is_missing(fails_at: str, says: str, tmp_path: Path) -> None:
    python = tmp_path / "python3"
    python.write_text(f'#!/bin/sh\ncase "$2" in *{fails_at}*) exit 1;; esac\nexit 0\n')
    python.chmod(0o755)
    for name in ("Makefile", "requirements.lock", "pyproject.toml"):
        (tmp_path / name).write_text((ROOT / name).read_text())
    done = subprocess.run(
        ["make", "venv", f"PYTHON={python}"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert says in done.stderr
    assert not (tmp_path / ".venv").exists()

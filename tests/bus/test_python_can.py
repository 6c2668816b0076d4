"""No process that opens a bus carries asammdf along; who asks for it afterwards gets it."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import pytest

from tunefree_hil.bus.python_can import absent

MODULES = tuple(f"tunefree_hil.bus.{name}" for name in ("dbc.codec", "open", "formats.blf", "tfhub.plugin"))


@pytest.mark.parametrize("first", MODULES)
def test_a_bus_is_opened_without_asammdf(first: str) -> None:
    if importlib.util.find_spec("asammdf") is None:
        pytest.skip("the extra mf4 is not installed: nothing could be imported")
    code = f"import sys, {first}; assert 'can' in sys.modules; assert 'asammdf' not in sys.modules, 'imported'"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_what_was_absent_is_there_afterwards() -> None:
    name = "this"  # a module of the standard library that nobody imports
    sys.modules.pop(name, None)
    with absent(name), pytest.raises(ImportError):
        importlib.import_module(name)
    assert name not in sys.modules
    assert importlib.util.find_spec(name) is not None


def test_what_is_imported_already_stays() -> None:
    before = sys.modules["json"]
    with absent("json"):
        assert importlib.import_module("json") is before
    assert sys.modules["json"] is before

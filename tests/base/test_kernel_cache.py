"""Compiled kernels on disk: found again, compiled again after an edit or where the file is damaged."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT
from tunefree_hil.base.kernel_cache import MAX_ENTRIES, KernelCache, cache_folder

MODULE = """
from tunefree_hil.base.kernel import kernel, kept, table

FACTOR = {factor}

@kernel
def scaled(values, i):
    return values[i] * FACTOR + {offset}

@kernel
def total(values):
    found = 0.0
    for i in range(len(values)):
        found += scaled(values, i)
    return found

def main():
    fast = kept(total)
    print(fast(table([1.0, 2.0, 4.0])), fast.stats.cache_hits, scaled.stats.cache_misses, len(scaled.signatures))
"""

READER = """
from typing import NamedTuple
from tunefree_hil.base import kernel as base

class Reading(NamedTuple):
    {fields}

@base.kernel
def read(reading):
    return reading.{attribute}

@base.kernel
def doubled(reading):
    return read(reading) * 2.0

def main():
    fast = base.compiled(doubled) if base.BATCH else base.kept(doubled)
    print(fast(Reading(near_m=1.0, far_m=2.0)))
"""


def run(folder: Path, source: str, jit: str = "1") -> str:
    """What `main` of a module prints in a process of its own; the cache is in the same folder."""
    (folder / "module.py").write_text(source)
    done = subprocess.run(
        # -B: bytecode of the last edit would stand for one of the same length within the same second
        [sys.executable, "-B", "-c", "import module; module.main()"],
        env={**os.environ, "TUNEFREE_JIT": jit, "TUNEFREE_CACHE": str(folder), "PYTHONPATH": f"{ROOT}:{folder}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.strip()


def sum_up(folder: Path, factor: float = 2.0, offset: float = 0.0) -> str:
    """The sum, then whether the cache had it and whether anything else was compiled."""
    printed = run(folder, MODULE.format(factor=factor, offset=offset))
    return " ".join(part for part in printed.split() if part not in ("Counter()", "Counter({})"))


@pytest.mark.compiled
def test_a_kernel_is_compiled_once_and_again_after_an_edit(tmp_path: Path) -> None:
    first = sum_up(tmp_path)
    [entry] = (tmp_path / "kernels").iterdir()
    assert first.startswith("14.0") and (tmp_path / "kernels").stat().st_mode & 0o077 == 0
    written = entry.stat().st_ino
    assert sum_up(tmp_path) == first and entry.stat().st_ino == written, "the second process only reads"
    assert sum_up(tmp_path, offset=1.0).startswith("17.0"), "the code of a callee"
    assert sum_up(tmp_path, factor=3.0).startswith("21.0"), "a constant of a callee"
    assert len(list((tmp_path / "kernels").iterdir())) == 3
    entry.write_bytes(entry.read_bytes()[:-100])
    assert sum_up(tmp_path).startswith("14.0"), "truncated"
    assert entry.stat().st_size > 1000 and sum_up(tmp_path).startswith("14.0")


@pytest.mark.compiled
@pytest.mark.parametrize("jit", ["1", "batch"])
def test_an_edited_attribute_or_record_is_not_read_by_old_machine_code(tmp_path: Path, jit: str) -> None:
    def read(attribute: str, fields: str) -> str:
        return run(tmp_path, READER.format(attribute=attribute, fields=fields), jit)

    assert read("near_m", "near_m: float; far_m: float") == "2.0"
    assert read("far_m", "near_m: float; far_m: float") == "4.0", "another attribute in a callee"
    assert read("near_m", "far_m: float; near_m: float") == "2.0", "another order of the fields of an argument"
    assert len(list((tmp_path / "kernels").iterdir())) == 3
    assert read("near_m", "near_m: float; far_m: float") == "2.0"
    assert len(list((tmp_path / "kernels").iterdir())) == 3, "the first entry is found again"


def unit(x: float) -> float:
    return x


def square(x: float) -> float:
    return x * x


def test_where_nothing_can_be_written_nothing_is_stored(tmp_path: Path) -> None:
    (tmp_path / "kernels").write_text("a file where the folder would be")
    cache = KernelCache(unit, tmp_path / "kernels")
    cache.save_overload("()", Result())
    assert cache.load_overload("()", Context()) is None


def test_what_cannot_be_pickled_is_not_stored(tmp_path: Path) -> None:
    cache = KernelCache(unit, tmp_path / "kernels")
    cache.save_overload("()", Result(lambda: None))
    assert not (tmp_path / "kernels").exists()


def test_the_oldest_entries_are_deleted(tmp_path: Path) -> None:
    cache = KernelCache(unit, tmp_path / "kernels")
    for i in range(MAX_ENTRIES + 3):
        cache.save_overload(f"({i})", Result())
    assert len(list((tmp_path / "kernels").iterdir())) == MAX_ENTRIES


def test_an_entry_is_found_by_its_function_and_signature(tmp_path: Path) -> None:
    cache = KernelCache(unit, tmp_path / "kernels")
    cache.save_overload("(float64,)", Result("ours"))
    assert cache.load_overload("(float64,)", Context()) == "ours"
    assert cache.load_overload("(int64,)", Context()) is None
    assert KernelCache(square, tmp_path / "kernels").load_overload("(float64,)", Context()) is None


def test_other_compiler_options_are_another_entry(tmp_path: Path) -> None:
    options = ({"nogil": True}, {"forceinline": True})
    KernelCache(unit, tmp_path, options=options).save_overload("()", Result("inlined"))
    assert KernelCache(unit, tmp_path, options=options).load_overload("()", Context()) == "inlined"
    for other in ((), ({"nogil": True}, {}), ({"nogil": True}, {"forceinline": False})):
        assert KernelCache(unit, tmp_path, options=other).load_overload("()", Context()) is None


def test_the_folder_is_in_the_users_cache_or_where_the_variable_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("TUNEFREE_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "tunefree_hil" / "kernels"
    monkeypatch.setenv("TUNEFREE_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own" / "kernels"


class Context:
    """The part of a compiler's target that a cache uses."""

    def codegen(self) -> Context:
        return self

    def magic_tuple(self) -> tuple[str, ...]:
        return ("processor",)

    def refresh(self) -> None:
        """Nothing to register."""


class Result:
    """The part of a compilation's result that a cache uses."""

    def __init__(self, part: object = "part") -> None:
        self.part = part
        self.target_context = Context()

    def _reduce(self) -> tuple[object, ...]:
        return (self.part,)

    @classmethod
    def _rebuild(cls, context: Context, part: object) -> object:
        return part

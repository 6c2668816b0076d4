"""Compiled kernels on disk: found again, not found after an edit, made again where the file is broken."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.house import ROOT
from tunefree_hil.base.kernel_cache import KEPT, KernelCache, cache_folder, named_in

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


def run(folder: Path, factor: float = 2.0, offset: float = 0.0) -> str:
    """What a process of its own says: the sum, whether the cache had it, whether anything else was compiled."""
    (folder / "module.py").write_text(MODULE.format(factor=factor, offset=offset))
    done = subprocess.run(
        [sys.executable, "-c", "import module; module.main()"],
        env={**os.environ, "TUNEFREE_JIT": "1", "TUNEFREE_CACHE": str(folder), "PYTHONPATH": f"{ROOT}:{folder}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return " ".join(part for part in done.stdout.split() if part not in ("Counter()", "Counter({})"))


@pytest.mark.compiled
def test_a_kernel_is_compiled_once_and_anew_when_anything_in_it_changes(tmp_path: Path) -> None:
    first = run(tmp_path)
    [entry] = (tmp_path / "kernels").iterdir()
    assert first.startswith("14.0") and (tmp_path / "kernels").stat().st_mode & 0o077 == 0
    made = entry.stat().st_ino
    assert run(tmp_path) == first and entry.stat().st_ino == made, "the second process only reads"
    assert run(tmp_path, offset=1.0).startswith("17.0"), "the code of a kernel that it calls"
    assert run(tmp_path, factor=3.0).startswith("21.0"), "a constant that such a kernel names"
    assert len(list((tmp_path / "kernels").iterdir())) == 3
    entry.write_bytes(entry.read_bytes()[:-100])
    assert run(tmp_path).startswith("14.0"), "cut off"
    assert entry.stat().st_size > 1000 and run(tmp_path).startswith("14.0")


def test_where_nothing_can_be_written_nothing_is_kept(tmp_path: Path) -> None:
    (tmp_path / "kernels").write_text("a file where the folder would be")
    cache = KernelCache(run, (), tmp_path / "kernels")
    cache.save_overload("()", Result())
    assert cache.load_overload("()", Context()) is None


def test_what_cannot_be_pickled_is_not_kept(tmp_path: Path) -> None:
    cache = KernelCache(run, (), tmp_path / "kernels")
    cache.save_overload("()", Result(lambda: None))
    assert not (tmp_path / "kernels").exists()


def test_the_oldest_entries_make_room(tmp_path: Path) -> None:
    cache = KernelCache(run, (), tmp_path / "kernels")
    for i in range(KEPT + 3):
        cache.save_overload(f"({i})", Result())
    assert len(list((tmp_path / "kernels").iterdir())) == KEPT


def test_an_entry_is_found_by_its_signature(tmp_path: Path) -> None:
    cache = KernelCache(run, (), tmp_path / "kernels")
    cache.save_overload("(float64,)", Result("ours"))
    assert cache.load_overload("(float64,)", Context()) == "ours"
    assert cache.load_overload("(int64,)", Context()) is None
    other = KernelCache(named_in, (), tmp_path / "kernels")
    assert other.load_overload("(float64,)", Context()) is None


def test_the_folder_is_the_users_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("TUNEFREE_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "tunefree_hil" / "kernels"
    monkeypatch.setenv("TUNEFREE_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own" / "kernels"


class Context:
    """What a cache asks of a compiler's target."""

    def codegen(self) -> Context:
        return self

    def magic_tuple(self) -> tuple[str, ...]:
        return ("processor",)

    def refresh(self) -> None:
        """Nothing to make ready."""


class Result:
    """What a compiler gives, as far as a cache looks at it."""

    def __init__(self, part: object = "part") -> None:
        self.part = part
        self.target_context = Context()

    def _reduce(self) -> tuple[object, ...]:
        return (self.part,)

    @classmethod
    def _rebuild(cls, context: Context, part: object) -> object:
        return part

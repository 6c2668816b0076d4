"""What the compiler made of kernels, kept in the user's cache folder (design D1).

An entry's name is a hash over everything that it was made from: the code of every kernel in it with the constants and
records that it names, how they were put together, the types of the arguments, Python, numba, llvmlite, numpy, the
processor and the settings of the compiler. So an edited kernel has another entry, and an old one is never taken.

Several processes may write at once: an entry is written under a name of its own and renamed. Entries are private to the
user (0700). Where there is no folder that can be written, nothing is kept.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.metadata
import os
import pickle
import platform
import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

PLACE_VARIABLE = "TUNEFREE_CACHE"
LIBRARIES = ("numba", "llvmlite", "numpy")
KEPT = 40  # entries; those used longest ago go first
DIGEST_BYTES = 32
PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def cache_folder() -> Path:
    """TUNEFREE_CACHE, else tunefree_hil in the user's own cache folder."""
    own = os.environ.get(PLACE_VARIABLE)
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tunefree_hil"
    return (Path(own) if own else base) / "kernels"


class KernelCache:
    """What a numba dispatcher asks for an overload before it compiles one, and gives it afterwards."""

    cache_path = None

    def __init__(
        self,
        function: Callable[..., Any],
        callees: Iterable[Callable[..., Any]],
        folder: Path,
        apart: Callable[[Any], Any] | None = None,
    ) -> None:
        """apart: compiles for a signature. Where it is given, a process beside this one does that."""
        self.folder = folder
        self._made_from = _made_from(function, callees)
        self._apart = apart

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled overload, or None: then whoever asks compiles it."""
        path = self._path(signature, target_context)
        if self._apart is not None and not path.exists():
            compile_apart, self._apart = self._apart, None
            _beside(lambda: compile_apart(signature))
        return self._read(path, target_context)

    def _read(self, path: Path, target_context: Any) -> Any:
        try:
            data = path.read_bytes()
        except OSError:
            return None
        digest, payload = data[:DIGEST_BYTES], data[DIGEST_BYTES:]
        if hashlib.sha256(payload).digest() != digest:
            return None  # cut off by a full disk: it is compiled and written again
        with contextlib.suppress(OSError):
            os.utime(path)
        target_context.refresh()  # what compiling would have made ready: reference counts, helpers
        kind, parts = pickle.loads(payload)
        return kind._rebuild(target_context, *parts)

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep a compiled overload."""
        try:
            payload = pickle.dumps((type(result), result._reduce()), pickle.HIGHEST_PROTOCOL)
        except (pickle.PicklingError, AttributeError):
            return  # it names a record that only this process has
        path = self._path(signature, result.target_context)
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        with contextlib.suppress(OSError):  # a cache that cannot be written is none
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            part.write_bytes(hashlib.sha256(payload).digest() + payload)
            os.replace(part, path)
            self._make_room()

    def enable(self) -> None:
        """It always is."""

    def disable(self) -> None:
        """It never is."""

    def flush(self) -> None:
        """Nothing is held back."""

    def _path(self, signature: Any, target_context: Any) -> Path:
        whole = hashlib.sha256(self._made_from)
        for part in (signature, target_context.codegen().magic_tuple()):
            whole.update(repr(part).encode() + b"\0")
        return self.folder / f"{whole.hexdigest()[:40]}.kernel"

    def _make_room(self) -> None:
        entries = sorted(self.folder.glob("*.kernel"), key=lambda path: path.stat().st_mtime)
        for path in entries[: max(len(entries) - KEPT, 0)]:
            path.unlink(missing_ok=True)


def _beside(work: Callable[[], Any]) -> None:
    """Do `work` in a copy of this process, which ends with it or with this one. What it raises is not told."""
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        return
    try:
        prctl = getattr(ctypes.CDLL(None), "prctl", None)
        if prctl is not None:
            prctl(PR_SET_PDEATHSIG, int(signal.SIGKILL))
        work()
    finally:
        os._exit(0)  # nothing of the copied process's own may be ended


def _made_from(function: Callable[..., Any], callees: Iterable[Callable[..., Any]]) -> bytes:
    """A hash over all but the types of the arguments."""
    whole = hashlib.sha256()
    versions = [f"{name} {importlib.metadata.version(name)}" for name in LIBRARIES]
    settings = sorted(f"{key}={value}" for key, value in os.environ.items() if key.startswith("NUMBA_"))
    for part in (sys.version, platform.machine(), versions, settings, *sorted(map(_content, (function, *callees)))):
        whole.update(repr(part).encode() + b"\0")
    return whole.digest()


def _content(function: Any) -> str:
    """All that a function's compiled form depends on but its callees: code, constants, and what its names stand for."""
    code = function.__code__
    names = [(name, _identity(value)) for name, value in named_in(function)]
    return repr((_identity(function), code.co_code.hex(), code.co_consts, code.co_varnames, names))


def _identity(value: Any) -> Any:
    """What a value is: functions by place and by what they close over in turn, records by their fields."""
    value = getattr(value, "py_func", value)  # a dispatcher is its function
    if isinstance(value, FunctionType):
        cells = [_identity(cell.cell_contents) for cell in value.__closure__ or ()]
        return (value.__module__, value.__qualname__, value.__code__.co_firstlineno, cells)
    if isinstance(value, type):
        fields = getattr(value, "_fields", ()), getattr(value, "_field_defaults", {})
        return (value.__module__, value.__qualname__, repr(fields))
    if isinstance(value, ModuleType):
        return value.__name__
    return value.tobytes().hex() if hasattr(value, "tobytes") else repr(value)


def named_in(function: Any) -> list[tuple[str, Any]]:
    """The globals that a function names, attributes of modules among them, and what it closes over."""
    code, known = function.__code__, function.__globals__
    found = [(name, known[name]) for name in code.co_names if name in known]
    for module_name, module in [one for one in found if isinstance(one[1], ModuleType)]:
        found += [(f"{module_name}.{name}", getattr(module, name)) for name in code.co_names if hasattr(module, name)]
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    return found + [(name, cell.cell_contents) for name, cell in cells]

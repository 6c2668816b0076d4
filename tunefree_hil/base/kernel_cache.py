"""Compiled kernels, stored in the user's cache folder.

The name of an entry is a hash over everything that it was compiled from: the code of the kernel and of all functions
that it can reach, the values of the names in them, the types of the arguments with the fields of their records, the
compiler's options, Python, numba, llvmlite, numpy and the processor. An edited kernel therefore has another entry.
Names of modules count, because numba stores them in the entry; line numbers and file paths do not.

Several processes may write at once: each writes a file of its own and renames it. Entries are private to the user
(0700). Where the folder cannot be written, nothing is stored.
"""

from __future__ import annotations

import contextlib
import ctypes
import enum
import hashlib
import importlib.metadata
import os
import pickle
import platform
import signal
import struct
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

FOLDER_VARIABLE = "TUNEFREE_CACHE"
LIBRARIES = ("numba", "llvmlite", "numpy")
LIBRARY_MODULES = {*LIBRARIES, *sys.stdlib_module_names}
MAX_ENTRIES = 40  # the entries that were used longest ago are deleted first
DIGEST_BYTES = 32
PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def cache_folder() -> Path:
    """The folder of the entries: in TUNEFREE_CACHE, else in the user's cache folder."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    default = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tunefree_hil"
    return (Path(chosen) if chosen else default) / "kernels"


class KernelCache:
    """The cache of one numba dispatcher, which asks it before it compiles and passes it the result."""

    cache_path = None

    def __init__(
        self,
        function: Any,
        folder: Path,
        compile_in_child: Callable[[Any], Any] | None = None,
        options: Sequence[Mapping[str, Any]] = (),
    ) -> None:
        """Attach a cache to a kernel.

        Args:
            function: the dispatcher, or the plain function.
            folder: where the entries are.
            compile_in_child: compiles for a signature; if given, a child process does the first compilation.
            options: the compiler's, of the kernel and of those that it calls: with others it is another entry.
        """
        self._function = function
        self._folder = folder
        self._compile_in_child = compile_in_child
        self._options = [sorted(one.items()) for one in options]

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled overload, or None if numba has to compile it."""
        path = self._path(signature, target_context)
        if path is None:
            return None
        if self._compile_in_child is not None and not path.exists():
            compile_overload, self._compile_in_child = self._compile_in_child, None
            _run_in_child(lambda: compile_overload(signature))
        return self._read(path, target_context)

    def _read(self, path: Path, target_context: Any) -> Any:
        try:
            data = path.read_bytes()
        except OSError:
            return None
        digest, payload = data[:DIGEST_BYTES], data[DIGEST_BYTES:]
        if hashlib.sha256(payload).digest() != digest:
            return None  # truncated by a full disk: numba compiles again and the entry is overwritten
        with contextlib.suppress(OSError):
            os.utime(path)
        target_context.refresh()  # registers the runtime helpers that a compilation would have registered
        kind, parts = pickle.loads(payload)
        return kind._rebuild(target_context, *parts)

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store a compiled overload."""
        path = self._path(signature, result.target_context)
        if path is None:
            return
        try:
            payload = pickle.dumps((type(result), result._reduce()), pickle.HIGHEST_PROTOCOL)
        except (pickle.PicklingError, AttributeError):
            return  # it refers to a record class that other processes cannot import
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        with contextlib.suppress(OSError):  # without a writable folder every process compiles for itself
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            part.write_bytes(hashlib.sha256(payload).digest() + payload)
            os.replace(part, path)
            self._delete_oldest()

    def enable(self) -> None:
        """Required by numba; the cache is always enabled."""

    def disable(self) -> None:
        """Required by numba; the cache is always enabled."""

    def flush(self) -> None:
        """Required by numba; entries are written at once."""

    def _path(self, signature: Any, target_context: Any) -> Path | None:
        """The file of an entry, or None if the kernel reads a value that cannot be described.

        It is worked out at each compilation, because numba reads the globals then.
        """
        try:
            description = _Description().describe(self._function, signature)
        except _UndescribedValue:
            return None
        digest = hashlib.sha256()
        for part in (_environment(), target_context.codegen().magic_tuple(), self._options, description):
            digest.update(repr(part).encode() + b"\0")
        return self._folder / f"{digest.hexdigest()[:40]}.kernel"

    def _delete_oldest(self) -> None:
        entries = sorted(self._folder.glob("*.kernel"), key=lambda path: path.stat().st_mtime)
        for path in entries[: max(len(entries) - MAX_ENTRIES, 0)]:
            path.unlink(missing_ok=True)


def named_in(function: Any) -> list[tuple[str, Any]]:
    """The values that a function and those nested in it read by name: globals, closure variables, modules' attributes.

    Attributes of library modules are left out. A global is also listed if only an attribute has its name.
    """
    names = list(dict.fromkeys(name for code in _nested_codes(function.__code__) for name in code.co_names))
    values = [(name, function.__globals__[name]) for name in names if name in function.__globals__]
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        with contextlib.suppress(ValueError):  # the cell is empty until the enclosing function assigns the name
            values.append((name, cell.cell_contents))
    modules: list[ModuleType] = []
    for path, value in values:  # grows in the loop: an attribute may be a module
        if isinstance(value, ModuleType) and value not in modules and not _is_library(value.__name__):
            modules.append(value)
            values += [(f"{path}.{name}", getattr(value, name)) for name in names if hasattr(value, name)]
    return values


def _is_library(name: str) -> bool:
    """Whether a dotted name is one of a library whose version is in every hash."""
    return name.partition(".")[0] in LIBRARY_MODULES


def _nested_codes(code: CodeType) -> Iterator[CodeType]:
    """A code object and those of the functions nested in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _nested_codes(constant)


def _environment() -> tuple[Any, ...]:
    """Versions and settings that the machine code depends on."""
    versions = [(name, importlib.metadata.version(name)) for name in LIBRARIES]
    settings = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_"))
    return sys.version, platform.machine(), versions, settings


class _UndescribedValue(Exception):
    """A value has no description that is the same in every process."""


class _Description:
    """Describes values by type and content, with a repr that is the same in every process.

    Functions, dispatchers and classes are numbered in the order of their discovery and described once each.
    """

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}
        self._objects: list[Any] = []  # by number; also keeps the addresses in _numbers valid

    def describe(self, *roots: Any) -> list[Any]:
        """The descriptions of the roots, then those of all that they refer to."""
        described = [self._value(root) for root in roots]
        for item in self._objects:  # grows in the loop
            described.append(self._content(item))
        return described

    def _refer(self, item: Any) -> str:
        """A library's function or class by its name, any other by its number."""
        name = f"{item.__module__}.{item.__qualname__}"
        if _is_library(name):
            return name
        if id(item) not in self._numbers:
            self._numbers[id(item)] = len(self._objects)
            self._objects.append(item)
        return f"#{self._numbers[id(item)]}"

    def _content(self, item: Any) -> tuple[Any, ...]:
        name = (item.__module__, item.__qualname__)
        if isinstance(item, type):
            return (*name, self._class(item))
        if not isinstance(item, FunctionType):
            return ("dispatcher", self._value(item.targetoptions), self._refer(item.py_func))
        names = [(name, self._value(value)) for name, value in named_in(item)]
        return (*name, self._code(item.__code__), self._value((item.__defaults__, item.__kwdefaults__)), names)

    def _class(self, item: type) -> tuple[Any, ...]:
        """The fields of a record in their order, with types and defaults, or the members of an enum."""
        types = [
            (name, self._refer(kind) if isinstance(kind, type) else repr(kind))
            for name, kind in getattr(item, "__annotations__", {}).items()
        ]
        members = dict(item.__members__) if issubclass(item, enum.Enum) else {}
        return getattr(item, "_fields", ()), types, self._value((getattr(item, "_field_defaults", {}), members))

    def _code(self, code: CodeType) -> tuple[Any, ...]:
        """All of a code object but its file and its line numbers."""
        arguments = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
        names = (code.co_qualname, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        return code.co_code, code.co_exceptiontable, arguments, names, self._value(code.co_consts)

    def _value(self, value: Any) -> Any:
        kind = type(value)
        if isinstance(value, FunctionType | type) or hasattr(value, "targetoptions"):
            return self._refer(value)
        if isinstance(value, ModuleType):
            return ("module", value.__name__)
        if isinstance(value, CodeType):
            return self._code(value)
        return (self._refer(kind), self._payload(value, kind))

    def _payload(self, value: Any, kind: type) -> Any:
        """The content of a value, apart from its type."""
        if value is None or kind in (bool, int, str, bytes):
            return repr(value)
        if kind in (float, complex):
            return struct.pack("<dd", value.real, value.imag)  # tells -0.0 from 0.0, and one NaN from another
        if isinstance(value, enum.Enum):
            return (value.name, self._value(value.value))
        if isinstance(value, tuple | list):
            return [self._value(item) for item in value]
        if isinstance(value, dict):
            return [(self._value(key), self._value(item)) for key, item in value.items()]
        if isinstance(value, set | frozenset):
            return sorted(repr(self._value(item)) for item in value)
        if hasattr(value, "tobytes") and hasattr(value, "dtype"):
            return self._array(value)
        if kind.__module__.startswith("numba.") and hasattr(value, "key"):  # a type; its name lacks records' fields
            return self._value(value.dispatcher if hasattr(value, "dispatcher") else value.key)
        try:
            return pickle.dumps(value, 5)
        except (pickle.PicklingError, AttributeError, RuntimeError, TypeError, ValueError) as error:
            raise _UndescribedValue(kind) from error

    def _array(self, array: Any) -> Any:
        """A numpy array, or a scalar as an array without dimensions."""
        flags = array.flags
        layout = (array.shape, flags.c_contiguous, flags.f_contiguous, flags.aligned, flags.writeable)
        content = self._value(array.tolist()) if array.dtype.hasobject else hashlib.sha256(array.tobytes()).hexdigest()
        return repr(array.dtype), layout, content


def _run_in_child(work: Callable[[], Any]) -> None:
    """Do `work` in a copy of this process and wait for it; its errors are ignored.

    The copy ends when `work` does, or when this process ends.
    """
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
        os._exit(0)  # skips the exit handlers and buffers copied from the parent

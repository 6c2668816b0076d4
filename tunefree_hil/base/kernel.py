"""The Block: the interface of every dynamic part.

`step(params, state, x, dt_s) -> (state, y)`: params are constant, the state is passed explicitly, and after a step
the old state must not be used (its buffers may be reused). The same source runs on the bus as plain Python and, in a
process started with TUNEFREE_JIT=1, compiled by numba. Both give the same bits, so kernels obey what
tests/test_kernels.py checks: `math` functions only, no `**`, no `hypot`, no `fmod`, guarded divisions, explicit loops.

TUNEFREE_JIT=1 compiles every kernel; TUNEFREE_JIT=batch only those wrapped by `compiled`, with all kernels they call.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from types import FunctionType
from typing import Any, NamedTuple, TypeVar, cast

from tunefree_hil.base.kernel_cache import KernelCache, cache_folder, named_in

MODE = os.environ.get("TUNEFREE_JIT", "0")
BATCH = MODE == "batch"
JITTED = MODE == "1"
ARRAYS = JITTED or BATCH

COMPILE_OPTIONS = {"nogil": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True}
# A callee that is not inlined gets every number of its params and state as an argument, some hundred words a call:
# inlining them made a tick of the learned plant 3.4 times as fast (6.0 to 1.8 us).
CALLEE_OPTIONS = {"no_cpython_wrapper": True, "forceinline": True}

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Mark `function` as a kernel; where kernels are compiled, compile it.

    Not with `cache=True`: a cached caller would keep the old code of an edited callee.
    """
    if not JITTED:
        function.__dict__["kernel"] = True
        return function
    return _jit(function)


def table(values: Iterable[float]) -> Any:
    """A read-only row of floats: an array where kernels are compiled, else a tuple (three times faster to index)."""
    if ARRAYS:
        import numpy as np

        return np.array([float(value) for value in values], dtype=np.float64)
    return tuple(float(value) for value in values)


def buffer(length: int, fill: float = 0.0) -> Any:
    """A mutable row of floats that a state owns: an array where kernels are compiled, else a list."""
    if ARRAYS:
        import numpy as np

        return np.full(length, fill, dtype=np.float64)
    return [float(fill)] * length


def inlined(function: F) -> F:
    """With TUNEFREE_JIT=1 a copy of the kernel `function` that is compiled into its callers, but not what it calls.

    For a kernel with a large state and one caller: a tick of the actuators in a loop of gap/ takes 1.0 us called and
    0.02 us inlined. To inline what it calls as well gains nothing.
    """
    return _jit(cast(Any, function).py_func, forceinline=True) if JITTED else function


def _jit(function: F, **options: Any) -> F:
    from numba import njit

    return cast(F, njit(nogil=True, error_model="python", **options)(function))


def compiled(function: F) -> F:
    """In a batch process the kernel `function` compiled with all kernels that it calls, else `function`.

    Its arguments may contain buffers, its result numbers only, as references to arrays are not counted.
    """
    if not BATCH:
        return function
    from numba import njit
    from numba.extending import register_jitable

    for callee in callees(function):
        if not callee.__dict__.get("registered"):
            callee.__dict__["registered"] = True
            register_jitable(**COMPILE_OPTIONS, **CALLEE_OPTIONS)(callee)
    dispatcher = njit(**COMPILE_OPTIONS)(function)
    cache = KernelCache(dispatcher, cache_folder(), options=(COMPILE_OPTIONS, CALLEE_OPTIONS))
    setattr(dispatcher, "_cache", cache)  # noqa: B010 - numba names no such
    return cast(F, dispatcher)


def compiler_errors() -> tuple[type[Exception], ...]:
    """Exceptions of a compiled kernel at its first call if its code cannot be compiled."""
    from numba.core.errors import NumbaError

    return (NumbaError,)


def kept(function: F) -> F:
    """The kernel `function`, called from Python, with its compiled code in the user's cache folder.

    Only with TUNEFREE_JIT=1. Code that is not in the cache is compiled in another process, so that this one does not
    need the compiler's memory.
    """
    if JITTED:
        dispatcher = cast(Any, function)
        dispatcher._cache = KernelCache(dispatcher, cache_folder(), dispatcher.compile)
    return function


def callees(function: Callable[..., Any]) -> list[Callable[..., Any]]:
    """The kernels that a kernel calls, directly or not, without itself: found by name in globals and closures."""
    callees: dict[Any, None] = {}
    todo: list[Any] = [function]
    while todo:
        for _, value in named_in(todo.pop()):
            plain = getattr(value, "py_func", value)
            is_kernel = isinstance(plain, FunctionType) and (plain is not value or "kernel" in plain.__dict__)
            if is_kernel and plain is not function and plain not in callees:
                callees[plain] = None
                todo.append(plain)
    return list(callees)


class Block(NamedTuple):
    """init(params, dt_s) -> state; step(params, state, x, dt_s) -> (state, y). `init` runs at build time."""

    init: Callable[[Any, float], Any]
    step: Callable[[Any, Any, Any, float], tuple[Any, Any]]
    params: Any
    tunables: tuple[Any, ...] = ()


def series(first: Block, second: Block) -> Block:
    """One Block: `first` feeds `second`."""
    first_init, second_init = first.init, second.init
    first_step, second_step = first.step, second.step

    def init(params: Any, dt_s: float) -> Any:
        return (first_init(params[0], dt_s), second_init(params[1], dt_s))

    @kernel
    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Any]:
        first_state, between = first_step(params[0], state[0], x, dt_s)
        second_state, y = second_step(params[1], state[1], between, dt_s)
        return (first_state, second_state), y

    return Block(init, step, (first.params, second.params), first.tunables + second.tunables)


def run(block: Block, inputs: Iterable[Any], dt_s: float) -> list[Any]:
    """Feed `inputs` through `block` from its initial state; the outputs, one a step. For tests and figures."""
    state = block.init(block.params, dt_s)
    outputs = []
    for x in inputs:
        state, y = block.step(block.params, state, x, dt_s)
        outputs.append(y)
    return outputs

"""A helper process with compiled kernels, for fits that need millions of plant steps.

    with CompiledProcess() as process:
        result = yield from process.call(fit_physics, windows, fixed, priors, brake_travel)

Whether kernels are compiled is decided at import (TUNEFREE_JIT), so such a fit needs another process. It ends with
this process.
"""

from __future__ import annotations

import importlib
import inspect
import sys
import threading
from collections.abc import Callable, Generator
from typing import Any, Literal, NamedTuple, ParamSpec, Self, TypeVar, overload

from tunefree_hil.base.errors import PeerGone, TunefreeError
from tunefree_hil.base.pipes import Helper, Loss, send, serve

JIT_ENVIRONMENT = {"TUNEFREE_JIT": "1"}
SINGLE_THREAD_ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # more do not speed up a thin J'J
LOSS = Loss("fit", "the process that fits", "fit_lost", "run the same command again")

P = ParamSpec("P")
Progress = TypeVar("Progress")
Result = TypeVar("Result")


class CallRequest(NamedTuple):
    """A call of a module-level function, by name: only the name is pickled."""

    module: str
    function: str
    args: tuple[Any, ...]


class CallReply(NamedTuple):
    """'progress': a value that a generator yields; 'result': the last reply; 'error': a TunefreeError of the call."""

    kind: Literal["progress", "result", "error"]
    value: Any


def make_request(function: Callable[..., Any], args: tuple[Any, ...]) -> CallRequest:
    """The request to call a function in another process.

    Raises:
        ValueError: The function is not defined at the top of an importable module.
    """
    module, name = function.__module__, getattr(function, "__qualname__", "")
    if getattr(sys.modules.get(module), name, None) is not function:
        raise ValueError(f"{module}.{name} is not a module-level function: another process cannot find it")
    return CallRequest(module, name, args)


def run_request(request: CallRequest) -> Generator[CallReply, None, None]:
    """Make the call in this process; yields progress, then one result or error."""
    try:
        result = getattr(importlib.import_module(request.module), request.function)(*request.args)
        while inspect.isgenerator(result):
            try:
                yield CallReply("progress", next(result))
            except StopIteration as end:
                result = end.value
        yield CallReply("result", result)
    except TunefreeError as error:
        yield CallReply("error", error)


def exhaust(steps: Generator[Any, None, Result]) -> Result:
    """The result of a generator, without its progress."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


class CompiledProcess:
    """A process with compiled kernels. It starts at the first call, and again at the first call after it was lost."""

    def __init__(self) -> None:
        self._helper: Helper | None = None
        self._is_shut_down = False
        self._start_lock = threading.Lock()

    @overload
    def call(
        self, function: Callable[P, Generator[Progress, None, Result]], *args: P.args, **_: P.kwargs
    ) -> Generator[Progress, None, Result]: ...

    @overload
    def call(self, function: Callable[P, Result], *args: P.args, **_: P.kwargs) -> Generator[Any, None, Result]: ...

    def call(self, function: Callable[..., Any], *args: Any) -> Generator[Any, None, Any]:
        """Call a module-level function in the process; yields the values that it yields.

        Args:
            function: A function or generator function; its module is imported there by name.
            args: Picklable positional arguments, as must be all results.

        Returns:
            The result of the function.

        Raises:
            TunefreeError: Raised by the function.
            PeerGone: The process was lost; the message has the end of its output.
        """
        request = make_request(function, args)
        try:
            helper = self._start_helper()
            helper.send_request(tuple(request))
            while (reply := CallReply(*helper.receive_answer())).kind == "progress":
                yield reply.value
        except BaseException:  # after an interrupted exchange the pipe holds replies to an earlier call
            self.close()
            raise
        if reply.kind == "error":
            raise reply.value
        return reply.value

    @overload
    def wait_for_result(
        self, function: Callable[P, Generator[Any, None, Result]], *args: P.args, **_: P.kwargs
    ) -> Result: ...

    @overload
    def wait_for_result(self, function: Callable[P, Result], *args: P.args, **_: P.kwargs) -> Result: ...

    def wait_for_result(self, function: Callable[..., Any], *args: Any) -> Any:
        """The result of a call, without its progress. Arguments and errors are those of `call`."""
        return exhaust(self.call(function, *args))

    def close(self) -> None:
        """End the process; the next call starts another."""
        helper, self._helper = self._helper, None
        if helper is not None:
            helper.close()

    def shut_down(self) -> None:
        """End the process for good: a call that another thread is about to make raises PeerGone."""
        with self._start_lock:
            self._is_shut_down = True
        self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.shut_down()

    def _start_helper(self) -> Helper:
        with self._start_lock:
            if self._is_shut_down:
                raise PeerGone(LOSS.peer, f"{LOSS.subject} was ended", code=LOSS.code, hint=LOSS.hint)
            if self._helper is None:
                environment = {**SINGLE_THREAD_ENVIRONMENT, **JIT_ENVIRONMENT}
                self._helper = Helper("tunefree_hil.learn.compiled_process", environment, LOSS)
            return self._helper


def main() -> None:
    """Serve requests until the input ends."""
    requests, output = serve()
    while True:
        for reply in run_request(CallRequest(*requests.get())):
            send(output, tuple(reply))


if __name__ == "__main__":
    main()

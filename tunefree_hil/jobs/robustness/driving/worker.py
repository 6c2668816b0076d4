"""A chunk of a road sweep on a worker of a cluster: plain data in, plain data out.

The bench of the last order and its batch process stay alive between chunks, so that a worker reads its kernels once.
"""

from __future__ import annotations

import socket
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError, TunefreeError
from tunefree_hil.bench import load
from tunefree_hil.jobs.robustness.driving.chunk import drive_chunk, open_sweep_batch
from tunefree_hil.jobs.robustness.driving.pack import CODE, describe_code, pack_bench, unpack_bench
from tunefree_hil.jobs.robustness.plan import SweepPlan, make_plan, order_from_data


def make_task_order(plan: SweepPlan) -> dict[str, Any]:
    """What a worker needs for the chunks of a plan, as plain data."""
    pack = pack_bench(plan.bench, plan.order.model)
    order = plan.order._replace(model="model")
    return {"key": plan.key, "hashes": dict(plan.hashes), "order": order.as_data(), "pack": dict(pack)}


def drive_task(task: Mapping[str, Any], number: int) -> dict[str, Any]:
    """Drive a chunk of an order of `make_task_order`.

    Returns:
        The chunk as plain data; or "error", an error as plain data with its exit status.
    """
    with _LOCK:
        try:
            rig = _open_rig(task)
            return drive_chunk(rig.batch, rig.plan, number).as_data()
        except TunefreeError as error:
            close_rig()
            return {"error": {**error.as_dict(), "status": error.exit_status, "worker": socket.gethostname()}}


class _Rig:
    """An order in use: its files in a folder that is deleted, its plan, its batch process."""

    def __init__(self, task: Mapping[str, Any]) -> None:
        self.key = task["key"]
        _require_same(task["hashes"], {CODE: describe_code()})
        self._folder = tempfile.TemporaryDirectory(prefix="tunefree-sweep-")
        try:
            bench = load(unpack_bench(task["pack"], Path(self._folder.name)))
            self.plan = make_plan(bench, order_from_data(task["order"]))
            _require_same(task["hashes"], self.plan.hashes)
            self.batch = open_sweep_batch(self.plan)
        except BaseException:
            self._folder.cleanup()
            raise

    def close(self) -> None:
        """End the batch process and delete the files."""
        self.batch.close()
        self._folder.cleanup()


_LOCK = threading.Lock()  # a batch has one pipe; a worker may have several threads
_rigs: list[_Rig] = []  # at most one


def end_order(key: str) -> None:
    """End the batch process of an order that is driven to its end; a chunk of another order goes on."""
    if _LOCK.acquire(blocking=False):  # the event loop of the worker must not wait
        try:
            if _rigs and _rigs[0].key == key:
                close_rig()
        finally:
            _LOCK.release()


def close_rig() -> None:
    """End the batch process of this worker, if there is one."""
    while _rigs:
        _rigs.pop().close()


def _open_rig(task: Mapping[str, Any]) -> _Rig:
    if not _rigs or _rigs[0].key != task["key"]:
        close_rig()
        _rigs.append(_Rig(task))
    return _rigs[0]


def _require_same(wanted: Mapping[str, Any], own: Mapping[str, Any]) -> None:
    """Raise InputError where this machine would not drive what was ordered."""
    differing = [name for name in own if own[name] != wanted.get(name)]
    if differing:
        raise InputError(
            f"worker {socket.gethostname()} would drive something else: it differs in {', '.join(differing)}",
            code="other_worker",
            key="--scheduler",
            hint=f"install the same tunefree_hil ({wanted[CODE].split()[0]}, same files) there and restart the worker",
        )

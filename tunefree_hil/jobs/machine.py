"""Check what a bench needs on this machine; every fault comes with the command that fixes it."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import TunefreeError

OK, NOTE, FAULT = "ok", "note", "fault"
MIN_PYTHON = (3, 11)
MIN_FREE_GB = 1.0
MIN_TRANSMIT_QUEUE = 100  # frames; hardware links have 10 by default, less than the burst of one tick
REINSTALL = "make venv, or: pip install -e ."
OF_AN_EXTRA = re.compile(r"extra\s*==")  # in the marker of an optional requirement
EXTRAS = {"torch": "learn", "pytest": "test"}


class DoctorFinding(NamedTuple):
    """kind: OK, NOTE or FAULT. remedy: what to do, '' for nothing."""

    kind: str
    text: str
    remedy: str


def check_machine(bus: str) -> list[DoctorFinding]:
    """Python, packages, entry point, CAN, disk."""
    return [
        check_python(),
        *check_packages(),
        check_entry_point(),
        *check_can_links(),
        check_bus(bus),
        *check_tools(),
        check_disk(Path.cwd()),
    ]


def check_python(version: tuple[int, ...] = tuple(sys.version_info[:3])) -> DoctorFinding:
    """The Python interpreter."""
    text = f"Python {'.'.join(map(str, version))}, {os.cpu_count()} cores"
    if version < MIN_PYTHON:
        return DoctorFinding(FAULT, text, "install Python 3.11 or newer")
    return DoctorFinding(OK, text, "")


def check_packages() -> Iterator[DoctorFinding]:
    """Versions of the required packages, and the missing ones."""
    try:
        required = metadata.requires("tunefree_hil") or []
    except metadata.PackageNotFoundError:
        yield DoctorFinding(FAULT, "tunefree_hil is not installed", REINSTALL)
        return
    names = [match[0] for line in required if (match := re.match(r"[\w.-]+", line)) and not OF_AN_EXTRA.search(line)]
    versions = {name: installed_version(name) for name in names}
    installed = [f"{name} {version}" for name, version in versions.items() if version]
    yield DoctorFinding(OK, ", ".join(installed), "")
    for name in (name for name, version in versions.items() if not version):
        yield DoctorFinding(FAULT, f"{name} is missing", REINSTALL)
    for name, extra in EXTRAS.items():
        version = installed_version(name)
        text = f"{name} {version}" if version else f"{name} is not installed (only needed for the extra '{extra}')"
        yield DoctorFinding(NOTE, text, "" if version else f"pip install -e '.[{extra}]'")


def installed_version(name: str) -> str:
    """The installed version of a distribution, or ''."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def check_entry_point() -> DoctorFinding:
    """Whether python-can, and every tool based on it, finds the tfhub interface."""
    if any(point.name == "tfhub" for point in metadata.entry_points(group="can.interface")):
        return DoctorFinding(OK, "python-can knows the interface tfhub", "")
    return DoctorFinding(FAULT, "python-can does not know the interface tfhub", REINSTALL)


def check_can_links(wanted: tuple[str, ...] = ("vcan0", "vcan1")) -> Iterator[DoctorFinding]:
    """All CAN links of this kernel, and the bench's two (`wanted`). A missing one is no fault: tfhub replaces it."""
    from tunefree_hil.bus.socketcan.kernel_link import ADD_VCAN, can_names, kernel_has_can

    make = " && ".join(ADD_VCAN.format(name=name) for name in wanted)
    if not kernel_has_can():
        text = "this kernel has no CAN (usual in containers, WSL2 and clouds); the bench uses tfhub"
        yield DoctorFinding(NOTE, text, f"on a kernel with CAN: {make}")
        return
    for name in dict.fromkeys([*wanted, *can_names()]):
        yield check_can_link(name)


def check_can_link(name: str) -> DoctorFinding:
    """One CAN link: kind, state, frame formats, length of the transmit queue."""
    from tunefree_hil.bus.socketcan.kernel_link import ADD_VCAN, FD_MTU, MAKE_FD, holder, link_state

    state = link_state(name)
    if not state.exists:
        use = "the bench uses tfhub" if name == "vcan0" else "the bench channel uses tfhub"
        return DoctorFinding(NOTE, f"the kernel has CAN, but there is no {name}; {use}", ADD_VCAN.format(name=name))
    carries = "classic CAN and CAN FD" if state.mtu >= FD_MTU else "classic CAN only"
    details = f"{state.kind or 'hardware'}, mtu {state.mtu} ({carries}), txqueuelen {state.queue}"
    if state.kind != "vcan":
        longer = f"sudo ip link set {name} txqueuelen 1000" if state.queue < MIN_TRANSMIT_QUEUE else ""
        text = f"{name} is not a virtual link ({details}): the bench never transmits on it; `ip link` sets its bit rate"
        return DoctorFinding(NOTE, text, longer)
    if not state.up:
        return DoctorFinding(NOTE, f"{name} is down ({details})", f"sudo ip link set up {name}")
    if state.mtu < FD_MTU:
        return DoctorFinding(NOTE, f"{name} is up ({details})", MAKE_FD.format(name=name))
    used_by = holder(name)
    return DoctorFinding(OK, f"{name} is up ({details}){f'; in use by a bench, pid {used_by}' if used_by else ''}", "")


def check_bus(text: str) -> DoctorFinding:
    """The bus that --bus resolves to."""
    from tunefree_hil.bus.open import resolve_bus

    try:
        return DoctorFinding(OK, f"--bus {text}: {resolve_bus(text).why}", "")
    except TunefreeError as error:
        return DoctorFinding(FAULT, f"--bus {text}: {error.message}", error.hint)


def check_tools() -> Iterator[DoctorFinding]:
    """Optional programs."""
    if importlib.util.find_spec("ensurepip") is None:
        yield DoctorFinding(NOTE, "python3-venv is missing: `make venv` will not work", "apt-get install python3-venv")
    if shutil.which("candump") is None:
        yield DoctorFinding(NOTE, "can-utils are not installed (candump, cansend)", "apt-get install can-utils")


def check_disk(folder: Path) -> DoctorFinding:
    """Free disk space, and write permission for run folders."""
    free_gb = shutil.disk_usage(folder).free / 1e9
    text = f"{free_gb:.1f} GB free in {folder}"
    if not os.access(folder, os.W_OK):
        return DoctorFinding(FAULT, f"{folder} is not writable", "work in another folder, or give --out DIR")
    if free_gb < MIN_FREE_GB:
        return DoctorFinding(FAULT, text, f"free some space: {MIN_FREE_GB:.0f} GB is needed")
    return DoctorFinding(OK, text, "")

"""What this machine has and lacks for a bench; every fault comes with the command that mends it."""

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
OLDEST_PYTHON = (3, 11)
NEEDED_FREE_GB = 1.0
ENOUGH_QUEUE = 100  # frames; hardware links come with 10, and a burst of one tick can be longer
REINSTALL = "make venv, or: pip install -e ."
EXTRAS = {"torch": "learn", "pytest": "test"}


class Finding(NamedTuple):
    """kind: ok, note or fault; `remedy`: what to do, '' for nothing."""

    kind: str
    text: str
    remedy: str


def machine(bus: str) -> list[Finding]:
    """Python, packages, entry point, CAN, disk."""
    return [python(), *packages(), entry_point(), *can_links(), which_bus(bus), *tools(), disk(Path.cwd())]


def python(version: tuple[int, ...] = tuple(sys.version_info[:3])) -> Finding:
    """The interpreter."""
    text = f"Python {'.'.join(map(str, version))}, {os.cpu_count()} cores"
    if version < OLDEST_PYTHON:
        return Finding(FAULT, text, "install Python 3.11 or newer")
    return Finding(OK, text, "")


def packages() -> Iterator[Finding]:
    """The package's own requirements: versions, or that one is missing."""
    try:
        required = metadata.requires("tunefree_hil") or []
    except metadata.PackageNotFoundError:
        yield Finding(FAULT, "tunefree_hil is not installed, only imported", REINSTALL)
        return
    names = [match[0] for line in required if (match := re.match(r"[\w.-]+", line)) and "extra ==" not in line]
    versions = {name: version_of(name) for name in names}
    there = [f"{name} {version}" for name, version in versions.items() if version]
    yield Finding(OK, ", ".join(there), "")
    for name in (name for name, version in versions.items() if not version):
        yield Finding(FAULT, f"{name} is missing", REINSTALL)
    for name, extra in EXTRAS.items():
        version = version_of(name)
        text = f"{name} {version}" if version else f"{name} is not there (only the extra '{extra}' needs it)"
        yield Finding(NOTE, text, "" if version else f"pip install -e '.[{extra}]'")


def version_of(name: str) -> str:
    """The installed version of a distribution, or ''."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def entry_point() -> Finding:
    """Whether python-can, and every tool on it, finds our bus."""
    if any(point.name == "tfhub" for point in metadata.entry_points(group="can.interface")):
        return Finding(OK, "python-can knows the interface tfhub", "")
    return Finding(FAULT, "python-can does not know the interface tfhub", REINSTALL)


def can_links(wanted: tuple[str, ...] = ("vcan0", "vcan1")) -> Iterator[Finding]:
    """Every CAN link of this kernel, and the bench's two (`wanted`). Without them tfhub does: no faults."""
    from tunefree_hil.bus.socketcan.kernel_link import ADD_VCAN, can_names, kernel_has_can

    make = " && ".join(ADD_VCAN.format(name=name) for name in wanted)
    if not kernel_has_can():
        text = "this kernel has no CAN (containers, WSL2 and many clouds have none); the bench takes tfhub"
        yield Finding(NOTE, text, f"on a kernel with CAN: {make}")
        return
    for name in dict.fromkeys([*wanted, *can_names()]):
        yield can_link(name)


def can_link(name: str) -> Finding:
    """One CAN link: its kind, whether it is up, what frames it carries, how many may wait to be sent."""
    from tunefree_hil.bus.socketcan.kernel_link import ADD_VCAN, FD_MTU, MAKE_FD, holder, link_state

    state = link_state(name)
    if not state.exists:
        use = "the bench takes tfhub" if name == "vcan0" else "the bench channel runs over tfhub"
        return Finding(NOTE, f"the kernel has CAN, but there is no {name}; {use}", ADD_VCAN.format(name=name))
    carries = "classic CAN and CAN FD" if state.mtu >= FD_MTU else "classic CAN only"
    what = f"{state.kind or 'hardware'}, mtu {state.mtu} ({carries}), txqueuelen {state.queue}"
    if state.kind != "vcan":
        longer = f"sudo ip link set {name} txqueuelen 1000" if state.queue < ENOUGH_QUEUE else ""
        text = f"{name} is no virtual link ({what}): we never transmit on it, and its bit rate is `ip link`'s to set"
        return Finding(NOTE, text, longer)
    if not state.up:
        return Finding(NOTE, f"{name} is down ({what})", f"sudo ip link set up {name}")
    if state.mtu < FD_MTU:
        return Finding(NOTE, f"{name} is up ({what})", MAKE_FD.format(name=name))
    used_by = holder(name)
    return Finding(OK, f"{name} is up ({what}){f'; in use by a bench, pid {used_by}' if used_by else ''}", "")


def which_bus(text: str) -> Finding:
    """What --bus means here."""
    from tunefree_hil.bus.open import resolve_bus

    try:
        return Finding(OK, f"--bus {text}: {resolve_bus(text).why}", "")
    except TunefreeError as error:
        return Finding(FAULT, f"--bus {text}: {error.message}", error.hint)


def tools() -> Iterator[Finding]:
    """Programs that are good to have."""
    if importlib.util.find_spec("ensurepip") is None:
        yield Finding(NOTE, "python3-venv is missing: `make venv` will not work", "apt-get install python3-venv")
    if shutil.which("candump") is None:
        yield Finding(NOTE, "can-utils are not installed (candump, cansend)", "apt-get install can-utils")


def disk(folder: Path) -> Finding:
    """Room for run folders, and the right to make them."""
    free_gb = shutil.disk_usage(folder).free / 1e9
    text = f"{free_gb:.1f} GB free in {folder}"
    if not os.access(folder, os.W_OK):
        return Finding(FAULT, f"{folder} may not be written", "work in a folder of your own, or give --out DIR")
    if free_gb < NEEDED_FREE_GB:
        return Finding(FAULT, text, f"make room: {NEEDED_FREE_GB:.0f} GB is wanted")
    return Finding(OK, text, "")

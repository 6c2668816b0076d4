"""The programs that the machine is made with, and how they get here: Debian's packages, only those that are missing."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from tools.vm.words import VmError, say

# program -> Debian package. can-utils and iproute2 are for commands in the guest, which sees the host's programs.
NEEDS: Mapping[str, str] = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "depmod": "kmod",
    "modprobe": "kmod",
    "candump": "can-utils",
    "ip": "iproute2",
    "setpriv": "util-linux",
}
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


def find(program: str) -> str | None:
    """Where a program is; the system's folders count too, which a user's PATH may leave out."""
    return shutil.which(program, path=f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}")


def missing() -> list[str]:
    """Packages whose programs are not here. A busybox that is linked to libraries cannot stand in an initramfs."""
    wanted = [package for program, package in NEEDS.items() if find(program) is None]
    busybox = find("busybox")
    if busybox is not None and not is_static(Path(busybox)):
        wanted.append("busybox-static")
    return sorted(set(wanted))


def is_static(path: Path) -> bool:
    """Whether a 64-bit little-endian ELF file asks for no interpreter (no program header of type PT_INTERP, 3)."""
    data = path.read_bytes()
    start, size, count = (int.from_bytes(data[a:b], "little") for a, b in ((32, 40), (54, 56), (56, 58)))
    kinds = [int.from_bytes(data[start + i * size : start + i * size + 4], "little") for i in range(count)]
    return data[:5] == b"\x7fELF\x02" and 3 not in kinds


def require() -> None:
    """Install what is missing. Raises VmError, with the command to paste, where that may not be done or fails."""
    if platform.machine() != "x86_64":
        raise VmError(f"the machine's programs are the host's, so this needs an x86-64 host, not {platform.machine()}")
    packages = missing()
    if packages:
        say(f"installing {' '.join(packages)}")
        apt_get(["update", "-qq"], packages)
        apt_get(["install", "-y", "-qq", "--no-install-recommends", *packages], packages)
    if still := missing():
        raise VmError(f"installed, and still not found: {', '.join(still)}", _by_hand(still))


def apt_get(words: Sequence[str], packages: Sequence[str]) -> None:
    """Run apt-get as root (directly, or by a sudo that asks nothing). VmError where it cannot, or says no."""
    if find("apt-get") is None:
        raise VmError(f"not a Debian: {', '.join(packages)} cannot be installed here", _by_hand(packages))
    command = ["apt-get", *words]
    if os.geteuid() != 0:
        if find("sudo") is None or subprocess.run(["sudo", "-n", "true"], capture_output=True).returncode != 0:
            raise VmError(f"{', '.join(packages)} missing, and not root", _by_hand(packages))
        command = ["sudo", "-n", *command]
    done = subprocess.run(command, env=quiet_environment(), capture_output=True, text=True, errors="replace")
    if done.returncode != 0:
        raise VmError(f"{' '.join(command)} failed:\n{last_lines(done.stdout + done.stderr)}", _by_hand(packages))


def quiet_environment() -> dict[str, str]:
    """For programs of the system: nobody is asked, and answers are in English."""
    path = f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}"
    return {**os.environ, "PATH": path, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}


def last_lines(text: str, count: int = 8) -> str:
    """The end of what a program said."""
    return "\n".join(text.strip().splitlines()[-count:])


def _by_hand(packages: Sequence[str]) -> str:
    return f"sudo apt-get install {' '.join(packages)}"

"""One run of a machine: the guest's script, QEMU, COMMAND's words as they come, its exit status.

The two sides meet in a scratch folder, the only one that the guest writes to on the host: `command.sh` goes in,
`stdout`, `stderr` and `status` come out. The kernel's own words go to `console`, so they never mix with COMMAND's.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

from tools.vm.image import Image
from tools.vm.needs import SYSTEM_PATH, find, last_lines
from tools.vm.words import EXIT_TIMEOUT, VmError

SCRATCH = "/run/vcan_vm"  # in the guest
LOOK_S = 0.05  # how often the host looks for more words
END_S = 10.0  # for a machine that has been told to end
HANDED_ON = ("HOME", "USER", "LANG", "LC_ALL", "TERM", "TZ")
# The mtu of CAN FD. busybox comes from the host's folder of scratch, for the host may not have it in its own path.
GUEST = """ip="{scratch}/busybox ip"
mkdir -p /dev/shm /dev/pts
mount -t tmpfs shm /dev/shm
mount -t devpts pts /dev/pts
ln -s /proc/self/fd /dev/fd
ln -s /proc/self/fd/0 /dev/stdin
ln -s /proc/self/fd/1 /dev/stdout
ln -s /proc/self/fd/2 /dev/stderr
{scratch}/busybox hostname vcan-vm
$ip link set lo up
for link in vcan0 vcan1; do
    $ip link add $link type vcan && $ip link set $link mtu 72 && $ip link set $link up || echo "no $link"
done
mkdir -p -m 1777 {temporary}
mount -t tmpfs -o mode=1777 temporary {temporary}
cd {scratch}
echo up > booted
/bin/sh {scratch}/command.sh < /dev/null > stdout 2> stderr
echo $? > ending && mv ending status
sync
{scratch}/busybox poweroff -f
"""
TEMPORARY = "/run/temporary"  # short: the paths of Unix-domain sockets begin with it


class Wish(NamedTuple):
    """What to run. `path`: folders to look for programs in first; `variables`: more environment for COMMAND."""

    command: Sequence[str]
    folder: Path
    path: Sequence[Path] = ()
    variables: Mapping[str, str] = {}
    timeout_s: float = 900.0
    memory_mb: int = 3072
    cpus: int = 1


def run(image: Image, wish: Wish, scratch: Path) -> int:
    """COMMAND's exit status. Its output goes to our stdout and stderr while it runs.

    VmError with status 124 when the time is over, 3 when the kernel did not boot or ended before COMMAND did.
    """
    shutil.copy(image.busybox, scratch / "busybox")
    (scratch / "init.sh").write_text(GUEST.format(scratch=SCRATCH, temporary=TEMPORARY))
    (scratch / "command.sh").write_text(command_script(wish))
    deadline_s = time.monotonic() + wish.timeout_s
    tails = [Tail(scratch / "stdout", sys.stdout.buffer), Tail(scratch / "stderr", sys.stderr.buffer)]
    with _qemu(image, wish, scratch) as process:
        while process.poll() is None:
            if time.monotonic() > deadline_s:
                raise VmError(_late(scratch, wish), "give it longer with --timeout", EXIT_TIMEOUT)
            for tail in tails:
                tail.pass_on()
            time.sleep(LOOK_S)
    for tail in tails:
        tail.pass_on()
    return _status(scratch, process.returncode)


class Tail:
    """Hands on what a file gains. The file need not exist yet."""

    def __init__(self, path: Path, to: BinaryIO) -> None:
        self.path = path
        self.to = to
        self._at = 0

    def pass_on(self) -> None:
        """All that is new."""
        if not self.path.exists():
            return
        with self.path.open("rb") as source:
            source.seek(self._at)
            while data := source.read(1 << 16):
                self._at += len(data)
                self.to.write(data)
        self.to.flush()


def command_script(wish: Wish) -> str:
    """The shell script that becomes COMMAND in the guest, in the folder where we were called.

    What the guest writes is lost with it, so nothing asks for compiled Python files to be written either.
    """
    path = ":".join([*map(str, wish.path), os.environ.get("PATH", ""), SYSTEM_PATH])
    handed = {name: os.environ[name] for name in HANDED_ON if name in os.environ}
    fixed = {"PATH": path, "TMPDIR": TEMPORARY, "VCAN_VM_SCRATCH": SCRATCH, "PYTHONDONTWRITEBYTECODE": "1"}
    variables = {**handed, **fixed, **wish.variables}
    lines = [f"export {name}={shlex.quote(value)}" for name, value in variables.items()]
    lines += [f"cd {shlex.quote(str(wish.folder))} || exit 126", f"exec {shlex.join(wish.command)}", ""]
    return "\n".join(lines)


def qemu_words(image: Image, wish: Wish, scratch: Path) -> list[str]:
    """QEMU's command line: emulated in software, no network, no screen; the host's root is a read-only share.

    setpriv has the kernel end QEMU when we are killed. A comma in a share's path is doubled, as QEMU wants it.
    """
    shares = {"host": ("/", ",readonly=on"), "scratch": (str(scratch).replace(",", ",,"), "")}
    words = ["setpriv", "--pdeathsig", "KILL", find("qemu-system-x86_64") or "qemu-system-x86_64"]
    words += ["-accel", "tcg,thread=multi", "-cpu", "max", "-smp", str(wish.cpus), "-m", str(wish.memory_mb)]
    words += ["-nodefaults", "-no-user-config", "-display", "none", "-monitor", "none", "-nic", "none", "-no-reboot"]
    words += ["-serial", f"file:{scratch / 'console'}".replace(",", ",,")]
    words += ["-kernel", str(image.kernel), "-initrd", str(image.initramfs)]
    words += ["-append", "console=ttyS0 quiet panic=-1 mitigations=off random.trust_cpu=on"]
    for tag, (path, more) in shares.items():
        words += ["-virtfs", f"local,path={path},mount_tag={tag},security_model=none,multidevs=remap{more}"]
    return words


@contextmanager
def _qemu(image: Image, wish: Wish, scratch: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A running QEMU in a process group of its own: Ctrl-C reaches us alone, and we end it, whatever happens."""
    with (scratch / "qemu").open("wb") as said:
        process = subprocess.Popen(
            qemu_words(image, wish, scratch),
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            start_new_session=True,
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _status(scratch: Path, qemu: int) -> int:
    """What COMMAND left. VmError that says how far the machine came when it left nothing."""
    if (scratch / "status").exists():
        return int((scratch / "status").read_text())
    booted = (scratch / "booted").exists()
    what = "the kernel ended before the command did" if booted else "the kernel did not boot"
    raise VmError(f"{what} (QEMU's status {qemu})\n{_last_words(scratch)}", "--keep keeps what it said")


def _late(scratch: Path, wish: Wish) -> str:
    if (scratch / "booted").exists():
        return f"stopped after {wish.timeout_s:g} s: {shlex.join(wish.command)} had not ended"
    return f"stopped after {wish.timeout_s:g} s: the kernel had not booted\n{_last_words(scratch)}"


def _last_words(scratch: Path) -> str:
    """The end of what QEMU and the guest's kernel said."""
    texts = [(scratch / name).read_text(errors="replace") for name in ("qemu", "console") if (scratch / name).exists()]
    return last_lines("\n".join(texts), 15)

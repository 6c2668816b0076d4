"""Kernel and initramfs: Debian's kernel package is unpacked, never installed; both are kept in a cache folder."""

from __future__ import annotations

import gzip
import hashlib
import lzma
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

from tools.vm.needs import apt_get, find, last_lines, quiet_environment
from tools.vm.words import VmError, say

KERNEL_META = "linux-image-amd64"
# What the guest needs beyond what is built in; modprobe says what these need in turn.
MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay", "can-raw", "can-bcm", "can-gw", "can-dev", "vcan", "slcan")
APPLETS = ("sh", "mkdir", "mount", "insmod", "switch_root", "echo", "poweroff")
# Root: the host's, read by 9p, under a layer in the guest's memory that takes all writing.
# msize: one 9p message; loose: the guest trusts what it has read, for nobody else writes there.
INIT = """#!/bin/sh
mkdir -p /proc /sys /dev /host /layer /newroot
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
for module in /modules/*; do insmod "$module" || echo "vcan_vm: $module does not load"; done
mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288,ro,cache=loose host /host || exec poweroff -f
mount -t tmpfs -o size=75% layer /layer
mkdir /layer/upper /layer/work
mount -t overlay -o lowerdir=/host,upperdir=/layer/upper,workdir=/layer/work root /newroot || exec poweroff -f
mount -t proc proc /newroot/proc
mount -t sysfs sys /newroot/sys
mount -t devtmpfs dev /newroot/dev
mount -t tmpfs run /newroot/run
mkdir /newroot/run/vcan_vm
mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288,rw,cache=none scratch /newroot/run/vcan_vm || exec poweroff -f
exec switch_root /newroot /run/vcan_vm/busybox sh /run/vcan_vm/init.sh
"""


class Image(NamedTuple):
    """What QEMU boots. `release`: the kernel's name, as `uname -r` says it."""

    kernel: Path
    initramfs: Path
    busybox: Path
    release: str


def default_cache() -> Path:
    """Where images are kept between runs."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "tunefree_hil" / "vcan_vm"


def image(cache: Path) -> Image:
    """The image of this recipe from the cache; made there first where it is missing. VmError where it cannot be."""
    folder = cache / recipe_hash()
    if not folder.is_dir():
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache, prefix="making-") as text:
            made = Path(text) / "image"
            made.mkdir()
            _make(Path(text), made)
            try:
                made.rename(folder)
            except OSError:  # somebody else was quicker, with the same image
                if not folder.is_dir():
                    raise
    release = (folder / "release").read_text().strip()
    return Image(folder / "vmlinuz", folder / "initramfs.gz", folder / "busybox", release)


def recipe_hash() -> str:
    """Changes whenever an image would be made in another way."""
    return hashlib.sha256(repr((KERNEL_META, MODULES, APPLETS, INIT)).encode()).hexdigest()[:16]


def _make(work: Path, made: Path) -> None:
    kernel = work / "kernel"
    _run(["dpkg-deb", "--extract", str(_download(work)), str(kernel)])
    (release,) = [path.name for path in (kernel / "lib" / "modules").iterdir()]
    say(f"making an initramfs for Linux {release}")
    shutil.copy(kernel / "boot" / f"vmlinuz-{release}", made / "vmlinuz")
    shutil.copy(_busybox(), made / "busybox")
    _run(["depmod", "--basedir", str(kernel), release])
    (made / "initramfs.gz").write_bytes(_initramfs(work / "initramfs", kernel, release))
    (made / "release").write_text(release + "\n")


def _download(work: Path) -> Path:
    """Debian's kernel package of today, in `work`."""
    package = _kernel_package()
    if not package:
        apt_get(["update", "-qq"], [KERNEL_META])
        package = _kernel_package()
    if not package:
        raise VmError(f"apt knows no {KERNEL_META}: the machine's kernel is Debian's", "run this on a Debian system")
    say(f"downloading {package} (about 70 MB, not installed)")
    try:
        _run(["apt-get", "download", "-qq", package], work)
    except VmError:  # the lists name a version that is gone from the mirror
        apt_get(["update", "-qq"], [KERNEL_META])
        _run(["apt-get", "download", "-qq", _kernel_package()], work)
    (found,) = work.glob("linux-image-*.deb")
    return found


def _kernel_package() -> str:
    """The package that the meta package stands for; '' where apt does not know."""
    words = ["apt-cache", "depends", "--important", KERNEL_META]
    done = subprocess.run(words, capture_output=True, text=True, env=quiet_environment())
    found = re.search(r"Depends: (linux-image-\S+)", done.stdout)
    return found[1] if found else ""


def _initramfs(root: Path, kernel: Path, release: str) -> bytes:
    """busybox, /init and the modules, numbered in the order in which they load; a gzipped cpio archive."""
    for folder in ("bin", "modules"):
        (root / folder).mkdir(parents=True)
    shutil.copy(_busybox(), root / "bin" / "busybox")
    for name in APPLETS:
        (root / "bin" / name).symlink_to("busybox")
    for number, path in enumerate(_load_order(kernel, release)):
        data = path.read_bytes()
        name = path.name.removesuffix(".xz")
        (root / "modules" / f"{number:02}-{name}").write_bytes(lzma.decompress(data) if name != path.name else data)
    (root / "init").write_text(INIT)
    (root / "init").chmod(0o755)
    names = "".join(f"{path.relative_to(root)}\n" for path in sorted(root.rglob("*")))
    words = ["cpio", "--create", "--format=newc", "--quiet", "--owner=0:0"]
    done = subprocess.run(words, cwd=root, input=names.encode(), capture_output=True, env=quiet_environment())
    if done.returncode != 0:
        raise VmError(f"cpio failed: {last_lines(done.stderr.decode(errors='replace'))}")
    return gzip.compress(done.stdout, 6, mtime=0)


def _load_order(kernel: Path, release: str) -> list[Path]:
    """The files of MODULES and of what they need, each once, in the order in which they load."""
    words = ["modprobe", "--show-depends", "--dirname", str(kernel), "--set-version", release]
    order: dict[str, None] = {}
    for name in MODULES:
        for line in _run([*words, name]).splitlines():
            kind, _, path = line.strip().partition(" ")
            if kind == "insmod":  # else built in
                order[path.split()[0]] = None
    return [Path(path) for path in order]


def _busybox() -> str:
    path = find("busybox")
    if path is None:
        raise VmError("no busybox", "sudo apt-get install busybox-static")
    return path


def _run(words: list[str], folder: Path | None = None) -> str:
    """A program's stdout; VmError with its last words when it fails."""
    done = subprocess.run(words, cwd=folder, env=quiet_environment(), capture_output=True, text=True, errors="replace")
    if done.returncode != 0:
        raise VmError(f"{' '.join(words)} failed:\n{last_lines(done.stdout + done.stderr)}")
    return done.stdout

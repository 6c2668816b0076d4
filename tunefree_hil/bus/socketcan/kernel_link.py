"""State of a network link by the kernel: its kind (vcan, or real hardware) by rtnetlink, never by its name."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError

IFF_UP = 0x1
ARPHRD_CAN = "280"  # linux/if_arp.h
SYS_NET = Path("/sys/class/net")
# linux/rtnetlink.h, linux/if_link.h
RTM_NEWLINK, RTM_GETLINK, NLM_F_REQUEST = 16, 18, 1
IFLA_IFNAME, IFLA_MTU, IFLA_TXQLEN, IFLA_LINKINFO, IFLA_INFO_KIND = 3, 4, 13, 18, 1
MESSAGE = struct.Struct("=IHHII")  # nlmsghdr: length, type, flags, sequence, port
INTERFACE = struct.Struct("=BxHiII")  # ifinfomsg: family, type, index, flags, change
ATTRIBUTE = struct.Struct("=HH")  # rtattr: length, type

NUMBER = struct.Struct("=I")
CREDENTIALS = struct.Struct("=iII")  # SO_PEERCRED: pid, uid, gid
FD_MTU = 72  # size of struct canfd_frame; that of can_frame is 16

# mtu 72: the link carries CAN FD too
ADD_VCAN = "sudo modprobe vcan && sudo ip link add dev {name} type vcan && sudo ip link set dev {name} mtu 72 up"
MAKE_VCAN = "on a kernel with CAN: " + ADD_VCAN + "; everywhere: --bus tfhub"
MAKE_FD = "sudo ip link set down {name} && sudo ip link set {name} mtu 72 && sudo ip link set up {name}"


class KernelLinkState(NamedTuple):
    """One network link. `kind` is '' for hardware and for a link that does not exist; mtu 72 carries CAN FD."""

    exists: bool
    up: bool
    kind: str
    mtu: int = FD_MTU
    queue: int = 0  # txqueuelen: frames


def kernel_has_can() -> bool:
    """True when this kernel opens CAN sockets."""
    family = getattr(socket, "AF_CAN", None)
    if family is None:
        return False
    try:
        socket.socket(family, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def link_state(name: str) -> KernelLinkState:
    """Whether the link is there, is up, and of which kind."""
    if not hasattr(socket, "AF_NETLINK") or not 0 < len(name) < 16 or "/" in name:
        return KernelLinkState(False, False, "")
    answer = _ask(name)
    if answer is None:
        return KernelLinkState(False, False, "")
    _, _, _, flags, _ = INTERFACE.unpack_from(answer)
    attributes = _attributes(answer[INTERFACE.size :])
    info = _attributes(attributes.get(IFLA_LINKINFO, b""))
    kind = info.get(IFLA_INFO_KIND, b"").rstrip(b"\0").decode("ascii", "replace")
    return KernelLinkState(
        True, bool(flags & IFF_UP), kind, _number(attributes, IFLA_MTU), _number(attributes, IFLA_TXQLEN)
    )


def can_names() -> list[str]:
    """Names of the kernel's CAN links (ARPHRD_CAN, 280), in order; [] where /sys is not there."""
    names = []
    for path in sorted(SYS_NET.glob("*/type")) if SYS_NET.is_dir() else []:
        with suppress(OSError):  # it was removed meanwhile
            if path.read_text().strip() == ARPHRD_CAN:
                names.append(path.parent.name)
    return names


def kernel_drops(name: str) -> int:
    """Frames of this link that the kernel dropped before any socket saw them (net.core.netdev_max_backlog)."""
    with suppress(OSError, ValueError):
        return int((SYS_NET / name / "statistics" / "rx_dropped").read_text())
    return 0


class Claim:
    """Holds a link for one bench of ours, so that two drives on one machine do not share it; ends with the process.

    A name in the abstract unix namespace, which like the link itself belongs to the network namespace.
    Raises InputError that names the holder.
    """

    def __init__(self, name: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(_claim_of(name))
            self._socket.listen(4096)  # a connect() only reads the holder's credentials and is never accepted
        except OSError:
            self._socket.close()
            raise InputError(
                f"{name} carries another bench of yours already, pid {holder(name)}",
                code="link_in_use",
                key="--bus",
                hint="end that one, use another link, or --bus tfhub, where benches do not meet",
            ) from None

    def close(self) -> None:
        """Give it up."""
        self._socket.close()


def holder(name: str) -> int:
    """Process id of the bench that holds a link (Claim); 0 for none, -1 where it cannot be known."""
    if not hasattr(socket, "SO_PEERCRED"):
        return 0
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(_claim_of(name))
            return CREDENTIALS.unpack(probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size))[0]
        except BlockingIOError:
            return -1
        except OSError:
            return 0


def _claim_of(name: str) -> str:
    return f"\0tunefree-hil-link-{name}"


def _number(attributes: dict[int, bytes], kind: int) -> int:
    data = attributes.get(kind, b"")
    return NUMBER.unpack(data)[0] if len(data) == NUMBER.size else 0


def _ask(name: str) -> bytes | None:
    """The ifinfomsg and attributes of one link; None when there is none of that name."""
    wanted = name.encode() + b"\0"
    attribute = ATTRIBUTE.pack(ATTRIBUTE.size + len(wanted), IFLA_IFNAME) + wanted + b"\0" * (-len(wanted) % 4)
    body = INTERFACE.pack(0, 0, 0, 0, 0) + attribute
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.settimeout(2.0)
        netlink.send(MESSAGE.pack(MESSAGE.size + len(body), RTM_GETLINK, NLM_F_REQUEST, 1, 0) + body)
        answer = netlink.recv(1 << 16)
    length, kind, _, _, _ = MESSAGE.unpack_from(answer)
    return answer[MESSAGE.size : length] if kind == RTM_NEWLINK else None


def _attributes(data: bytes) -> dict[int, bytes]:
    """rtattr type -> payload."""
    attributes = {}
    while len(data) >= ATTRIBUTE.size:
        length, kind = ATTRIBUTE.unpack_from(data)
        if length < ATTRIBUTE.size:
            break
        attributes[kind] = data[ATTRIBUTE.size : length]
        data = data[(length + 3) & ~3 :]
    return attributes

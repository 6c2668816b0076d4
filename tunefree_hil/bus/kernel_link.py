"""What the kernel says of a network link: its kind (vcan, or real hardware) by rtnetlink, never by its name."""

from __future__ import annotations

import socket
import struct
from typing import NamedTuple

IFF_UP = 0x1
# linux/rtnetlink.h, linux/if_link.h
RTM_NEWLINK, RTM_GETLINK, NLM_F_REQUEST = 16, 18, 1
IFLA_IFNAME, IFLA_LINKINFO, IFLA_INFO_KIND = 3, 18, 1
MESSAGE = struct.Struct("=IHHII")  # nlmsghdr: length, type, flags, sequence, port
INTERFACE = struct.Struct("=BxHiII")  # ifinfomsg: family, type, index, flags, change
ATTRIBUTE = struct.Struct("=HH")  # rtattr: length, type

MAKE_VCAN = (
    "on a kernel with CAN: sudo modprobe vcan && sudo ip link add dev {name} type vcan && sudo ip link set up {name};"
    " everywhere: --bus tfhub"
)


class LinkState(NamedTuple):
    """One network link. `kind` is '' for hardware and for a link that does not exist."""

    exists: bool
    up: bool
    kind: str


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


def link_state(name: str) -> LinkState:
    """Whether the link is there, is up, and of which kind."""
    if not hasattr(socket, "AF_NETLINK") or not 0 < len(name) < 16 or "/" in name:
        return LinkState(False, False, "")
    answer = _ask(name)
    if answer is None:
        return LinkState(False, False, "")
    _, _, _, flags, _ = INTERFACE.unpack_from(answer)
    info = _attributes(answer[INTERFACE.size :]).get(IFLA_LINKINFO, b"")
    kind = _attributes(info).get(IFLA_INFO_KIND, b"").rstrip(b"\0").decode("ascii", "replace")
    return LinkState(True, bool(flags & IFF_UP), kind)


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
    found = {}
    while len(data) >= ATTRIBUTE.size:
        length, kind = ATTRIBUTE.unpack_from(data)
        if length < ATTRIBUTE.size:
            break
        found[kind] = data[ATTRIBUTE.size : length]
        data = data[(length + 3) & ~3 :]
    return found

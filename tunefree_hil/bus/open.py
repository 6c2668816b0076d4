"""Opens the links that `--bus TEXT` names (docs/reference/files.md), and refuses to transmit on real CAN hardware."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.link import BusLink, CanLink, HubLink, Links, PairLink, separate_links
from tunefree_hil.bus.python_can import can
from tunefree_hil.bus.socketcan.kernel_link import FD_MTU, MAKE_FD, MAKE_VCAN, holder, kernel_has_can, link_state
from tunefree_hil.bus.socketcan.link import Options, open_socketcan
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.handshake import Welcome, default_name
from tunefree_hil.bus.tfhub.pair import HubPair
from tunefree_hil.bus.tfhub.plugin import HubBus
from tunefree_hil.bus.tfhub.records import CHANNELS

DEFAULT_LINK = "vcan0"
KINDS = "auto, tfhub, tfhub:ADDRESS, socketcan:vcan0, virtual"
NO_GATE = "transmitting on it needs the safety gate, which this version does not have"
CLOCKS = {"real": "in real time", "sender": "in lockstep"}  # of a hub
USE_VIRTUAL = "use --bus tfhub, --bus virtual, or a vcan link"


class BusChoice(NamedTuple):
    """The bus: `kind` tfhub | socketcan | virtual; an address for each channel; the reason for the choice."""

    kind: str
    vehicle_address: str
    bench_address: str
    reason: str
    bench_text: str = ""  # the bus of the bench channel, where it is not that of the vehicle channel

    @property
    def why(self) -> str:
        """The choice in one sentence."""
        return self.reason + (f"; the bench channel over {self.bench_text}" if self.bench_text else "")


def resolve_bus(text: str = "auto", session: str = "default", bench_bus: str = "") -> BusChoice:
    """The bus that `--bus TEXT` (and `--bench-bus`) select. InputError where it does not exist or must not be used."""
    kind, _, rest = text.partition(":")
    if kind == "auto" and not rest:
        choice = _auto(session)
    elif kind == "tfhub":
        choice = _hub_choice(_session_of(rest) if rest else session, "--bus says so")
    elif kind == "socketcan" and rest:
        _require_socketcan(rest)
        choice = _socketcan_choice(rest, "--bus says so", session)
    elif kind == "virtual":
        name = rest or session
        why = "python-can's virtual bus, within this one process"
        choice = BusChoice("virtual", f"virtual:{name}-vehicle", f"virtual:{name}-bench", why)
    elif kind in can.VALID_INTERFACES and kind != "socketcan":
        raise InputError(f"{text} is not open to a bench: {NO_GATE}", code="no_gate", key="--bus", hint=USE_VIRTUAL)
    else:
        raise InputError(f"no bus {text!r}", key="--bus", hint=f"one of {KINDS}")
    if not bench_bus:
        return choice
    bench = _bench_address(bench_bus, session)
    if bench == choice.vehicle_address:
        raise InputError(
            f"{bench} is the vehicle's link, and the bench channel never shares it",
            code="same_link",
            key="--bench-bus",
            hint="leave --bench-bus out, or give another vcan link: socketcan:vcan1",
        )
    return choice._replace(bench_address=bench, bench_text=bench)


def _hub_choice(session: str, reason: str) -> BusChoice:
    why = f"tfhub, session {session}, because {reason}"
    return BusChoice("tfhub", _hub(session, "vehicle"), _hub(session, "bench"), why)


def _socketcan_choice(link: str, reason: str, session: str) -> BusChoice:
    addresses = f"socketcan:{link}", _hub(session, "bench")
    return BusChoice("socketcan", *addresses, f"SocketCAN {link}, because {reason}", f"tfhub, session {session}")


class LinkRequest(NamedTuple):
    """How a node wants its link. `options`: of a SocketCAN link; the fields here win over it."""

    name: str = ""
    role: str = "member"  # or observer, which only listens
    stamps: bool = False  # this member stamps its frames itself (lockstep)
    fd: bool = False  # CAN FD, sent with bit-rate switch
    only: Sequence[int] = ()  # on a hub and on SocketCAN only frames with these ids are handed over; () for all
    clock: str = ""  # that a hub must have, one of CLOCKS; '' for any
    options: Options = Options()


def open_link(
    choice: BusChoice | str,
    channel: str = "vehicle",
    request: LinkRequest = LinkRequest(),  # noqa: B008
) -> BusLink:
    """Open one channel of a choice, or an address as it stands in one.

    InputError where transmitting or the hub's clock is refused, BenchError where the bus does not open.
    """
    if channel not in CHANNELS:
        raise InputError(f"no channel {channel!r}", key="channel", hint=f"one of {', '.join(CHANNELS)}")
    if isinstance(choice, BusChoice):
        choice = choice.vehicle_address if channel == "vehicle" else choice.bench_address
    kind, _, rest = choice.partition(":")
    if kind == "tfhub":
        where = _endpoint_of(rest, channel)
        bus = HubBus(where, role=request.role, name=request.name, stamps=request.stamps, only=request.only)
        _require_clock(bus.welcome, request.clock, bus.shutdown)
        return HubLink(bus)
    may_send, name = request.role == "member", request.name or default_name()
    if kind == "socketcan" and rest:
        _require_socketcan(rest)
        if may_send:
            require_virtual_link(rest)
        if request.fd:
            require_fd_link(rest)
        options = request.options._replace(may_send=may_send, fd=request.fd, only=request.only)
        return open_socketcan(rest, name, options)
    if kind != "virtual":
        raise InputError(f"{choice} is not open to a bench: {NO_GATE}", code="no_gate", key="--bus", hint=USE_VIRTUAL)
    return CanLink(_virtual(rest, request.stamps), name, may_send=may_send, keeps_stamps=request.stamps)


def open_links(choice: BusChoice, request: LinkRequest) -> Links:
    """Both channels of a member; over one connection where both are channels of one hub.

    `only` counts for the vehicle's link where that is SocketCAN. On the bench channel nothing is dropped, so of
    `options` only `alive` counts there.
    """
    vehicle, bench = (text.partition(":") for text in (choice.vehicle_address, choice.bench_address))
    if vehicle[0] == bench[0] == "tfhub" and _session_of(vehicle[2]) == _session_of(bench[2]):
        pair = HubPair(_endpoint_of(vehicle[2], "vehicle"), name=request.name, stamps=request.stamps)
        _require_clock(pair.welcome, request.clock, pair.close)
        return Links(PairLink(pair, 0), PairLink(pair, 1), pair.prepare)
    vehicle_link = open_link(choice, "vehicle", request if vehicle[0] == "socketcan" else request._replace(only=()))
    patient = Options(alive=request.options.alive)
    try:
        bench_link = open_link(choice, "bench", request._replace(fd=False, only=(), options=patient))
    except BaseException:
        vehicle_link.close()
        raise
    return separate_links(vehicle_link, bench_link)


def alone_on(vehicle: BusLink) -> Links:
    """The links of a node without a bench channel: nothing is sent or received there."""
    bus = f"alone-{id(vehicle)}"
    bench = CanLink(_virtual(bus, False), vehicle.name, may_send=True)  # its own bus: what is sent there is lost
    return separate_links(vehicle, bench)


def require_virtual_link(name: str) -> None:
    """InputError unless the kernel says that this network link is of kind vcan; its name does not count."""
    state = link_state(name)
    if state.exists and state.kind == "vcan":
        return
    kind = f"of kind {state.kind}" if state.kind else "hardware"
    raise InputError(
        f"{name} is not a vcan link but {kind if state.exists else 'not there'}: {NO_GATE}",
        code="no_gate",
        key="--bus",
        hint=USE_VIRTUAL,
    )


def require_fd_link(name: str) -> None:
    """InputError for a link that carries classic frames only, with the command that changes it."""
    state = link_state(name)
    if state.mtu < FD_MTU:
        raise InputError(
            f"{name} is a classic CAN link (mtu {state.mtu}), and this vehicle sends CAN FD frames (mtu {FD_MTU})",
            code="classic_link",
            key="--bus",
            hint=MAKE_FD.format(name=name),
        )


def _auto(session: str) -> BusChoice:
    """SocketCAN when vcan0 is there, up, of kind vcan and carries no other bench of ours, else tfhub."""
    state = link_state(DEFAULT_LINK)
    is_usable = state.exists and state.up and state.kind == "vcan" and kernel_has_can()
    used_by = holder(DEFAULT_LINK) if is_usable else 0
    if is_usable and used_by in (0, os.getpid()):
        return _socketcan_choice(DEFAULT_LINK, "it is up", session)
    if used_by:
        reason = f"{DEFAULT_LINK} carries another bench, pid {used_by}"
    elif not kernel_has_can():
        reason = "this kernel has no CAN"
    elif not state.exists:
        reason = f"there is no {DEFAULT_LINK}"
    elif state.kind != "vcan":
        reason = f"{DEFAULT_LINK} is not a vcan link"
    else:
        reason = f"{DEFAULT_LINK} is down"
    return _hub_choice(session, reason)


def _require_clock(welcome: Welcome, clock: str, close: Callable[[], None]) -> None:
    """InputError, after `close`, where a hub's stamps are those of the other kind of bench."""
    if clock in ("", welcome.clock):
        return
    close()
    others = "with" if welcome.clock == "real" else "without"
    raise InputError(
        f"the hub of session {welcome.session} stamps frames {CLOCKS[welcome.clock]}, this would be {CLOCKS[clock]}",
        code="hub_clock",
        key="--realtime",
        hint=f"start it anew as `tunefree-hil hub --session {welcome.session} --clock {clock}`, or all the others "
        f"{others} --realtime",
    )


def _require_socketcan(name: str) -> None:
    """InputError with what to do when this SocketCAN link cannot be opened."""
    hint = MAKE_VCAN.format(name=name)
    if not kernel_has_can():
        raise InputError("this kernel has no CAN (no PF_CAN sockets)", code="no_can", key="--bus", hint=hint)
    state = link_state(name)
    if not state.exists:
        raise InputError(f"there is no network link {name}", code="no_link", key="--bus", hint=hint)
    if not state.up:
        raise InputError(f"{name} is down", code="link_down", key="--bus", hint=f"sudo ip link set up {name}")


def _bench_address(text: str, session: str) -> str:
    """`--bench-bus`: tfhub, virtual, or another link that the kernel calls vcan; never a real interface."""
    kind, _, rest = text.partition(":")
    if kind == "socketcan" and rest:
        _require_socketcan(rest)
        require_virtual_link(rest)
        return text
    return resolve_bus(text, session).bench_address


def _hub(session: str, channel: str) -> str:
    return f"tfhub:{address.endpoint(session, channel)}"


def _session_of(text: str) -> str:
    """The session that the ADDRESS of `tfhub:ADDRESS` belongs to: a name, a directory, or an address of a channel."""
    if text.startswith("unix:"):
        return _folder(address.parse(text).path)
    if text.startswith("tcp:"):
        wanted = str(address.parse(text))
        for info in address.running_hubs():
            if wanted in info.addresses.values():
                return info.session
        raise BenchError(f"no hub of yours listens at {wanted}", code="no_hub", hint="name its session: tfhub:SESSION")
    return _folder(text)


def _folder(text: str) -> str:
    """`text` without its endpoint."""
    folder, _, last = text.rpartition("/")
    return folder if folder and last in ("veh", "vehicle", "bench") else text


def _endpoint_of(text: str, channel: str) -> str:
    """The address for HubBus: `text`, with the channel's endpoint when it names only a session."""
    plain, options = address.split_options(text)
    if options or plain.startswith(("unix:", "tcp:")) or _folder(plain) != plain:
        return text
    return address.endpoint(plain, channel)


def _virtual(name: str, stamps: bool) -> can.BusABC:
    """python-can's bus within this process, without its configuration files."""
    try:
        return can.Bus(name, interface="virtual", preserve_timestamps=stamps, ignore_config=True)
    except (can.CanError, OSError) as error:
        raise BenchError(f"virtual:{name} does not open: {error}", code="bus_error") from error

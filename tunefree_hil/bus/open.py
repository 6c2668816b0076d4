"""Opens the links that `--bus TEXT` names (docs/reference/files.md), and refuses to transmit on real CAN hardware."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.link import BusLink, CanLink, HubLink, Links, PairLink
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
        hub_session = _session_of(rest) if rest else session
        why = f"tfhub, session {hub_session}, because --bus says so"
        choice = BusChoice("tfhub", _hub(hub_session, "vehicle"), _hub(hub_session, "bench"), why)
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


def _socketcan_choice(link: str, reason: str, session: str) -> BusChoice:
    addresses = f"socketcan:{link}", _hub(session, "bench")
    return BusChoice("socketcan", *addresses, f"SocketCAN {link}, because {reason}", f"tfhub, session {session}")


def open_link(
    choice: BusChoice | str,
    channel: str = "vehicle",
    *,
    name: str = "",
    role: str = "member",
    stamps: bool = False,
    fd: bool = False,
    only: Sequence[int] = (),
    clock: str = "",
    options: Options | None = None,
) -> BusLink:
    """Open one channel of a choice, or an address as it stands in one.

    `role` observer only listens. `stamps`: this member stamps its frames itself (lockstep). `fd`: CAN FD, sent with
    bit-rate switch. `only`: on a hub and on SocketCAN, only frames with these ids are handed over. `clock`: the one
    that a hub must have, one of CLOCKS; '' for any. `options`: of a SocketCAN link; the others win. InputError where
    transmitting or the hub's clock is refused, BenchError where the bus does not open.
    """
    if channel not in CHANNELS:
        raise InputError(f"no channel {channel!r}", key="channel", hint=f"one of {', '.join(CHANNELS)}")
    if isinstance(choice, BusChoice):
        choice = choice.vehicle_address if channel == "vehicle" else choice.bench_address
    kind, _, rest = choice.partition(":")
    if kind == "tfhub":
        bus = HubBus(_endpoint_of(rest, channel), role=role, name=name, stamps=stamps, only=only)
        _require_clock(bus.welcome, clock, bus.shutdown)
        return HubLink(bus)
    may_send = role == "member"
    if kind == "socketcan" and rest:
        _require_socketcan(rest)
        if may_send:
            require_virtual_link(rest)
        if fd:
            require_fd_link(rest)
        given = (options or Options())._replace(may_send=may_send, fd=fd, only=only)
        return open_socketcan(rest, name or default_name(), given)
    if kind != "virtual":
        raise InputError(f"{choice} is not open to a bench: {NO_GATE}", code="no_gate", key="--bus", hint=USE_VIRTUAL)
    return CanLink(_virtual(rest, stamps), name or default_name(), may_send=may_send, keeps_stamps=stamps)


def open_links(
    choice: BusChoice,
    *,
    name: str = "",
    stamps: bool = False,
    fd: bool = False,
    only: Sequence[int] = (),
    clock: str = "",
    options: Options | None = None,
) -> Links:
    """Both channels of a member; over one connection where both are channels of one hub.

    `only`, `clock`, `options`: as open_link, the first of the vehicle's link where that is SocketCAN. On the bench
    channel nothing is dropped, so of `options` only patience and `alive` count there.
    """
    vehicle, bench = (text.partition(":") for text in (choice.vehicle_address, choice.bench_address))
    if vehicle[0] == bench[0] == "tfhub" and _session_of(vehicle[2]) == _session_of(bench[2]):
        pair = HubPair(_endpoint_of(vehicle[2], "vehicle"), name=name, stamps=stamps)
        _require_clock(pair.welcome, clock, pair.close)
        return Links(PairLink(pair, 0), PairLink(pair, 1), pair.send)
    vehicle_ids = only if vehicle[0] == "socketcan" else ()
    links = [
        open_link(choice, "vehicle", name=name, stamps=stamps, fd=fd, only=vehicle_ids, clock=clock, options=options)
    ]
    patient = Options(alive=options.alive if options else None)
    try:
        links.append(open_link(choice, "bench", name=name, stamps=stamps, clock=clock, options=patient))
    except BaseException:
        links[0].close()
        raise

    def send_both(vehicle_frames: Sequence[CanFrame], bench_frames: Sequence[CanFrame]) -> None:
        if vehicle_frames:
            links[0].send(vehicle_frames)
        if bench_frames:
            links[1].send(bench_frames)

    return Links(links[0], links[1], send_both)


def alone_on(vehicle: BusLink) -> Links:
    """The links of a node without a bench channel: nothing is sent or received there."""
    bus = f"alone-{id(vehicle)}"
    bench = CanLink(_virtual(bus, False), vehicle.name, may_send=True)

    def send_both(vehicle_frames: Sequence[CanFrame], bench_frames: Sequence[CanFrame]) -> None:
        if vehicle_frames:
            vehicle.send(vehicle_frames)

    return Links(vehicle, bench, send_both)


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
    return BusChoice(
        "tfhub", _hub(session, "vehicle"), _hub(session, "bench"), f"tfhub, session {session}, because {reason}"
    )


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


__all__ = ["BusChoice", "alone_on", "open_link", "open_links", "require_fd_link", "require_virtual_link", "resolve_bus"]

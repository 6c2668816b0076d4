"""Peers joining and leaving a hub: HELLO, BYE, and lost connections, which are announced to all members."""

from __future__ import annotations

import contextlib
import hmac
import socket
import time
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.bus.tfhub.records import (
    CHANNELS,
    PEER_GONE,
    PROTOCOL,
    REFUSED,
    WELCOME,
    RecordError,
    pack_control,
)
from tunefree_hil.bus.tfhub.server.connections import Peer

if TYPE_CHECKING:
    from tunefree_hil.bus.tfhub.server.hub import Hub

HELLO_PATIENCE_S = 2.0
OWNER_PATIENCE_S = 10.0
ROLES = ("member", "observer", "owner")
MOST_PEERS = 255  # a sender's index is one byte, and 0 is the hub


class JoinRefusal(NamedTuple):
    """Why a peer may not join."""

    code: str
    message: str
    hint: str


def accept(hub: Hub, listener: socket.socket, channel: str) -> None:
    """Take a new connection; it has HELLO_PATIENCE_S to send HELLO."""
    try:
        sock, _ = listener.accept()
    except OSError:  # it went before it was taken
        return
    sock.setblocking(False)
    if sock.family == socket.AF_INET:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    hub.board.add(sock, channel, time.monotonic() + HELLO_PATIENCE_S)


def patience_s(hub: Hub) -> float | None:
    """How long the hub may sleep: until the next deadline, None when there is none."""
    if not hub.board.unidentified and not hub.owner_deadline_s:
        return None
    deadlines = [peer.deadline_s for peer in hub.board.unidentified]
    if hub.owner_deadline_s:
        deadlines.append(hub.owner_deadline_s)
    return max(0.0, min(deadlines) - time.monotonic())


def enforce_deadlines(hub: Hub) -> None:
    """Drop connections without HELLO, and end a hub whose owner never came."""
    if not hub.board.unidentified and not hub.owner_deadline_s:
        return
    now_s = time.monotonic()
    for peer in list(hub.board.unidentified):
        if peer.deadline_s <= now_s:
            drop(hub, peer, f"it sent no hello within {HELLO_PATIENCE_S:g} s")
    if hub.owner_deadline_s and hub.owner_deadline_s <= now_s:
        hub.ended = f"no owner came within {OWNER_PATIENCE_S:g} s"


def hello(hub: Hub, peer: Peer, body: dict[str, Any]) -> None:
    """Admit a peer, or refuse it with a reason. RecordError for a malformed hello."""
    role, name, pid = body.get("role"), body.get("name"), body.get("pid")
    if role not in ROLES or not isinstance(name, str) or not isinstance(pid, int):
        raise RecordError("its hello has no role, name or pid")
    only = body.get("only", [])
    if not isinstance(only, list) or not all(isinstance(can_id, int) for can_id in only):
        raise RecordError("its hello has no list of ids")
    name = "".join(letter if letter.isprintable() else "?" for letter in name)[:80] or "nameless"
    if not body.get("fixed_name", True):
        name = _free_name(hub, peer.channel, name)
    refusal = _refusal(hub, peer, body, role, name)
    if refusal:
        _refuse(hub, peer, refusal)
        return
    peer.role, peer.name, peer.pid = role, name, pid
    peer.also = _other_channel(peer, body)
    peer.only = frozenset(only)
    peer.echo, peer.stamps = body.get("echo") is True, body.get("stamps") is True
    peer.listen = role != "owner" and body.get("listen") is not False
    peer.index = min(set(range(1, MOST_PEERS + 1)) - {other.index for other in hub.board.peers})
    if role == "owner":
        hub.owner_deadline_s = 0.0
    hub.board.admit(peer, _welcome(hub, peer))


def _welcome(hub: Hub, peer: Peer) -> bytes:
    info = hub.session.info
    body = {
        "protocol": PROTOCOL,
        "index": peer.index,
        "name": peer.name,
        "channel": peer.channel,
        "log_name": hub.log_names[peer.channel],
        "session": info.session,
        "pid": info.pid,
        "clock": info.clock,
        "epoch_offset_ns": hub.epoch_offset_ns,
    }
    return pack_control(WELCOME, body)


def _refusal(hub: Hub, peer: Peer, body: dict[str, Any], role: str, name: str) -> JoinRefusal | None:
    """Why the peer may not join; None where it may."""
    token = hub.session.token
    given = body.get("token")
    if token and not (isinstance(given, str) and hmac.compare_digest(token.encode(), given.encode(errors="replace"))):
        return JoinRefusal(
            "wrong_token", "the token is wrong", "name the token file of the hub's session: ?token_file=..."
        )
    if body.get("protocol") != PROTOCOL:
        message = f"this hub speaks protocol {PROTOCOL}, not {body.get('protocol')}"
        return JoinRefusal("protocol", message, "use one version for all")
    for member in hub.board.peers:
        if role == member.role == "owner":
            message = f"this hub has an owner already: {member.name}, pid {member.pid}"
            return JoinRefusal("owned", message, "start a hub of your own")
        if role != "owner" and member.role in ("member", "observer") and _same(member, peer, body, name):
            message = f"{name} is on the bus already (pid {member.pid})"
            return JoinRefusal("duplicate_name", message, "choose another name: ?name=...")
    if len(hub.board.peers) > MOST_PEERS:
        return JoinRefusal("full", f"the hub has {MOST_PEERS} peers", "close some")
    return None


def _other_channel(peer: Peer, body: dict[str, Any]) -> str:
    """The second channel of a joint connection; only members have one."""
    return next((one for one in CHANNELS if one != peer.channel), "") if body.get("both") is True else ""


def _same(member: Peer, peer: Peer, body: dict[str, Any], name: str) -> bool:
    wanted = {peer.channel, _other_channel(peer, body)} - {""}
    return bool(wanted & set(member.channels)) and member.name == name


def _free_name(hub: Hub, channel: str, name: str) -> str:
    """`name`, or with a number behind it when it is taken."""
    taken = {other.name for other in hub.board.peers if channel in other.channels and other.role}
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name}-{number}"
    return free


def _refuse(hub: Hub, peer: Peer, refusal: JoinRefusal) -> None:
    hub.note(f"refused {peer.name}: {refusal.message}")
    _send_refusal(hub, peer, refusal)


def _send_refusal(hub: Hub, peer: Peer, refusal: JoinRefusal) -> None:
    """Send the reason, as far as the socket takes it, and close."""
    peer.enqueue(pack_control(REFUSED, refusal._asdict()), 0)
    with contextlib.suppress(OSError):  # the connection is closed already
        peer.flush()
    hub.board.forget(peer)


def farewell(hub: Hub, peer: Peer) -> None:
    """Remove a peer that sent BYE."""
    hub.board.forget(peer)
    if peer.role == "owner":
        _end_ownership(hub, f"its owner {peer.name} left")


def lose(hub: Hub, peer: Peer, why: str) -> None:
    """Remove a peer whose connection closed without BYE."""
    hub.board.forget(peer)
    if peer.role == "owner":
        _end_ownership(hub, f"its owner {peer.name} is gone")
    elif peer.role:
        _announce_loss(hub, peer, why)


def drop(hub: Hub, peer: Peer, why: str) -> None:
    """Drop a peer that broke the protocol, and announce it to the members."""
    label = f"{peer.name} (pid {peer.pid})" if peer.role else f"a connection to {peer.channel}"
    hub.note(f"dropped {label}: {why}")
    hub.lost.append(f"{label} was dropped: {why}")
    _send_refusal(hub, peer, JoinRefusal("dropped", f"the hub dropped this connection: {why}", ""))
    if peer.role == "owner":
        _end_ownership(hub, f"its owner {peer.name} was dropped: {why}")
    elif peer.role == "member":
        _notify_members(hub, peer, f"the hub dropped it: {why}")


def _announce_loss(hub: Hub, peer: Peer, why: str) -> None:
    """Note a loss, and announce it once a process, which may have a connection on each channel."""
    if peer.loss_announced:
        return
    hub.lost.append(f"{peer.role} {peer.name} (pid {peer.pid}): {why}")
    hub.note(f"lost {peer.role} {peer.name} (pid {peer.pid}): {why}")
    if peer.role == "member":
        _notify_members(hub, peer, why)


def _notify_members(hub: Hub, lost: Peer, why: str) -> None:
    record = pack_control(PEER_GONE, {"name": lost.name, "pid": lost.pid, "why": why}, sender=lost.index)
    for member in hub.board.peers:
        if member.role != "member":
            continue
        if member.name == lost.name and member.pid == lost.pid:
            member.loss_announced = True
        elif member.listen:
            hub.board.enqueue(member, record)


def _end_ownership(hub: Hub, why: str) -> None:
    """Abandon the logs, which only the owner can stop, and end a hub that was started for its owner."""
    for log in hub.logs.values():
        log.abandon()
    hub.logs = {}
    if not hub.standalone:
        hub.ended = hub.ended or why

"""A hub's directory: private, claimed once, cleaned up; what a killed hub left is replaced."""

from __future__ import annotations

import os
import socket
import stat
from pathlib import Path

import pytest

from tests.bus.tfhub_help import frame, thread_hub
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.bus.tfhub.server.hub import HubOptions
from tunefree_hil.bus.tfhub.server.serve import serve
from tunefree_hil.bus.tfhub.session import LONGEST_PATH, Session


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


def test_modes_and_cleaning_up(tmp_path: Path) -> None:
    for transport in ("unix", "tcp"):
        session = Session(str(tmp_path / "hub"), transport, "real")
        assert mode(tmp_path / "hub") == 0o700
        assert mode(tmp_path / "hub" / address.HUB_FILE) == 0o600
        assert (tmp_path / "hub" / address.TOKEN_FILE).exists() == (transport == "tcp")
        if transport == "tcp":
            assert mode(tmp_path / "hub" / address.TOKEN_FILE) == 0o600
            assert len(session.token) == 64
            assert all(text.startswith("tcp:127.0.0.1:") for text in session.info.addresses.values())
        session.close()
        assert not (tmp_path / "hub").exists()


def test_what_others_put_there_stays(tmp_path: Path) -> None:
    session = Session(str(tmp_path / "hub"), "unix", "real")
    (tmp_path / "hub" / "notes").write_text("mine")
    session.close()
    assert os.listdir(tmp_path / "hub") == ["notes"]


def test_a_second_hub_is_told_of_the_first(tmp_path: Path) -> None:
    with thread_hub(tmp_path) as hub:
        with pytest.raises(InputError, match=f"already runs here, pid {os.getpid()}") as raised:
            serve(hub.session)
        assert "--join" in raised.value.hint and "--session OTHER" in raised.value.hint
        with hub.member("a") as a, hub.member("b") as b:  # the first one is unharmed
            a.send_frames([frame(1)])
            assert b.recv_frames(5.0)


def test_a_hub_without_lock_is_noticed_by_its_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Session, "_lock", lambda self: -1)  # as on a system without flock
    session = Session(str(tmp_path / "hub"), "unix", "real")
    with pytest.raises(InputError, match="already runs here"):
        Session(str(tmp_path / "hub"), "unix", "real")
    session.close()


def test_the_socket_of_a_killed_hub_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "hub"
    folder.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as left:
        left.bind(str(folder / "veh"))  # closing it leaves the file, as kill -9 does
    (folder / address.HUB_FILE).write_text("{}")
    session = Session(str(folder), "unix", "real")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.connect(str(folder / "veh"))
    session.close()


def test_a_directory_that_others_may_enter_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "hub"
    folder.mkdir()
    folder.chmod(0o750)
    with pytest.raises(InputError, match="yours alone") as raised:
        Session(str(folder), "unix", "real")
    assert raised.value.code == "not_private" and "chmod 700" in raised.value.hint
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path)
    for name in ("file", "link"):
        with pytest.raises(InputError, match="yours alone"):
            Session(str(tmp_path / name), "unix", "real")


def test_a_path_too_long_for_a_socket_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too long for a socket") as raised:
        Session(str(tmp_path / ("x" * LONGEST_PATH)), "unix", "real")
    assert "--tcp" in raised.value.hint
    assert not list(tmp_path.iterdir())
    Session(str(tmp_path / ("x" * LONGEST_PATH)), "tcp", "real").close()


def test_nobody_there(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="no hub runs in session") as raised:
        Owner(str(tmp_path / "hub"))
    assert raised.value.code == "no_hub"


def test_wrong_words_to_serve(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="transport"):
        serve(str(tmp_path / "hub"), HubOptions(transport="udp"))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="channel's name"):
        serve(str(tmp_path / "hub"), HubOptions(log_names={"vehicle": "can 0"}))

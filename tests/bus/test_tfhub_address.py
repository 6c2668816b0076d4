"""Addresses: what is accepted, what is refused, and that nothing but loopback ever is accepted."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus.tfhub import address


def write_hub(folder: Path, **changes: object) -> None:
    folder.mkdir(exist_ok=True)
    found = {"session": "s", "pid": 1, "clock": "real", "token_file": "t"}
    found["addresses"] = {"vehicle": "tcp:127.0.0.1:4001", "bench": "tcp:127.0.0.1:4002"}  # type: ignore[assignment]
    (folder / address.HUB_FILE).write_text(json.dumps({**found, **changes}))


@pytest.fixture
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


def test_forms(runtime: Path) -> None:
    assert address.parse("unix:/run/x/veh").path == address.parse("unix:///run/x/veh").path == "/run/x/veh"
    assert address.parse("tcp:127.0.0.1:80", "f") == address.parse("tcp://127.0.0.1:80", "f")
    assert address.parse("tcp:localhost:80").host == "127.0.0.1"
    write_hub(runtime / f"tfhub-{address.user_id()}-default")
    for text in (
        "default/veh",
        "default/vehicle",
        "tfhub-default/veh",
        str(runtime / f"tfhub-{address.user_id()}-default/veh"),
    ):
        assert address.parse(text) == address.Address(host="127.0.0.1", port=4001, token_file="t")
    assert address.parse("default/bench").port == 4002


def test_a_port_finds_its_token(runtime: Path) -> None:
    write_hub(runtime / f"tfhub-{address.user_id()}-mine", token_file="there")
    assert address.parse("tcp:127.0.0.1:4002").token_file == "there"
    assert address.parse("tcp:127.0.0.1:4003").token_file == ""
    assert [info.session for info in address.running_hubs()] == ["s"]


@pytest.mark.parametrize(
    "host",
    [
        "0.0.0.0",
        "192.168.0.1",
        "10.0.0.1",
        "128.0.0.1",
        "::",
        "example.org",
        "localhost.example.org",
        "127.1",
        "2130706433",
    ],
)
def test_only_loopback(host: str) -> None:
    with pytest.raises(InputError, match="not a loopback") as raised:
        address.parse(f"tcp:{host}:4000")
    assert raised.value.code == "not_loopback"


@given(st.ip_addresses(v=4))
def test_only_loopback_of_all(host: object) -> None:
    if str(host).startswith("127."):
        assert address.loopback(str(host)) == str(host)
    else:
        with pytest.raises(InputError):
            address.loopback(str(host))


@pytest.mark.parametrize(
    "text", ["", "veh", "default", "default/other", "tcp:127.0.0.1", "tcp:127.0.0.1:0", "tcp:127.0.0.1:99999"]
)
def test_no_address(text: str, runtime: Path) -> None:
    with pytest.raises(InputError):
        address.parse(text)


def test_no_hub_is_said(runtime: Path) -> None:
    with pytest.raises(BenchError, match="no hub runs in session 'nobody'") as raised:
        address.parse("nobody/veh")
    assert raised.value.code == "no_hub" and "tunefree-hil hub --session nobody" in raised.value.hint


def test_a_broken_hub_file_is_named(runtime: Path) -> None:
    folder = runtime / f"tfhub-{address.user_id()}-odd"
    folder.mkdir()
    for text in ("{", "[]", '{"session": "x"}', '{"strange": 1}'):
        (folder / address.HUB_FILE).write_text(text)
        with pytest.raises(BenchError, match=r"hub\.json"):
            address.read_hub("odd")
        assert address.running_hubs() == []


def test_options() -> None:
    assert address.split_options("a/veh?role=member&name=x") == ("a/veh", {"role": "member", "name": "x"})
    assert address.split_options("a/veh") == ("a/veh", {})
    with pytest.raises(InputError, match="'rule'"):
        address.split_options("a/veh?rule=member")


def test_session_directories(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert address.session_dir("x") == runtime / f"tfhub-{address.user_id()}-x"
    assert address.session_dir("some/where") == Path.cwd() / "some/where"
    assert address.endpoint("x", "bench").endswith("-x/bench")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", os.sep + "elsewhere")
    assert address.session_dir("x").parent == Path(os.sep + "elsewhere")
    with pytest.raises(InputError):
        address.session_dir("")
    with pytest.raises(InputError):
        address.endpoint("x", "other")

"""Two vcan links of a real kernel, and how this folder is run where the machine's own kernel has none.

    tools/vcan_vm --cpus 2 -- .venv/bin/python -m pytest tests/vcan -m vcan

Everything is skipped, with the reason, where the links are not there. A machine that `tools/vcan_vm` emulates is some
20 times slower than its host: the scenarios last 3 s, nodes are not compiled, and what need not be imported is not.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.vcan.peers import HERE, Links, ip
from tests.vcan.reference import Reference, reference_of
from tunefree_hil.bus.socketcan.kernel_link import kernel_has_can, link_state

IN_A_VM = "tools/vcan_vm -- COMMAND runs it in a kernel that has them"
START_LIMIT_S = "600"  # of a bench on an emulated machine


@pytest.fixture(scope="module", autouse=True)
def links() -> Links:
    """The links; whoever asks for them is skipped where they are not there, and so is every test of this folder."""
    found = Links()
    if not kernel_has_can():
        pytest.skip(f"this kernel has no CAN; {IN_A_VM}")
    for name in found:
        state = link_state(name)
        if not (state.exists and state.up and state.kind == "vcan"):
            pytest.skip(f"there is no vcan link {name} that is up; {IN_A_VM}")
    return found


@pytest.fixture(scope="module", autouse=True)
def _patient_and_lean() -> Iterator[None]:
    """For the processes that the tests start: lean/sitecustomize.py, and time to come up."""
    more = {"PYTHONPATH": str(HERE / "lean"), "TUNEFREE_START_LIMIT_S": START_LIMIT_S}
    before = {name: os.environ.get(name) for name in more}
    os.environ.update(more)
    yield
    for name, value in before.items():
        if value is None:
            del os.environ[name]
        else:
            os.environ[name] = value


@pytest.fixture(scope="package")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Reference:
    """What the drives come to over our hub; where the host has not driven them, minutes in an emulated machine."""
    return reference_of(tmp_path_factory.mktemp("reference"))


@pytest.fixture
def mended(links: Links) -> Iterator[None]:
    """For a test that takes a link down or away: both are there, up, and carry CAN FD afterwards."""
    yield
    for name in links:
        if not link_state(name).exists:
            ip("link", "add", "dev", name, "type", "vcan")
        ip("link", "set", "down", name)
        ip("link", "set", name, "mtu", "72")
        ip("link", "set", "up", name)

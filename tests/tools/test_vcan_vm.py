"""tools/vcan_vm without a machine: what it is asked, what it starts, what it says when it cannot. With one: a boot."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import io
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.house import ROOT
from tools.vm import image, machine, needs
from tools.vm.image import Image
from tools.vm.words import EXIT_TIMEOUT, EXIT_VM, VmError

TOOL = ROOT / "tools" / "vcan_vm"


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    """The program as a module."""
    loader = importlib.machinery.SourceFileLoader("vcan_vm_program", str(TOOL))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def made(folder: Path) -> Image:
    return Image(folder / "vmlinuz", folder / "initramfs.gz", folder / "busybox", "6.1.0")


# --- what it is asked --------------------------------------------------------------------------------------------


def test_options_end_at_the_first_dashes(tool: ModuleType) -> None:
    options, command = tool.parsed(["--cpus", "2", "--env", "A=b=c", "--", "ls", "--", "--cpus"])
    assert command == ["ls", "--", "--cpus"]
    wish = tool.wish_of(options, command)
    assert (wish.cpus, wish.variables, wish.timeout_s) == (2, {"A": "b=c"}, 900.0)
    assert wish.path == [ROOT / ".venv" / "bin"] and wish.folder == Path.cwd()


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["ls"],
        ["--"],
        ["--prepare", "--", "ls"],
        ["--timeout", "0", "--", "ls"],
        ["--timeout", "inf", "--", "ls"],
        ["--cpus", "0", "--", "ls"],
        ["--memory", "64", "--", "ls"],
        ["--env", "A", "--", "ls"],
        ["--colour", "--", "ls"],
    ],
)
def test_a_mistake_is_status_2_before_anything_is_installed(words: list[str]) -> None:
    done = subprocess.run([sys.executable, str(TOOL), *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stdout == ""
    assert "usage: tools/vcan_vm" in done.stderr and "Traceback" not in done.stderr


# --- what it starts ----------------------------------------------------------------------------------------------


def test_the_command_runs_in_our_folder_with_the_words_it_was_given(tmp_path: Path) -> None:
    """Words with spaces and quotes arrive whole; what COMMAND gives is what the script gives."""
    odd = tmp_path / "it's a folder"
    odd.mkdir()
    words = [sys.executable, "-c", "import os, sys; print(os.getcwd(), sys.argv[1:], os.environ['X']); sys.exit(7)"]
    wish = machine.Wish([*words, "a b", "$HOME", "'"], odd, variables={"X": 'say "x"'})
    done = subprocess.run(["sh", "-c", machine.command_script(wish)], capture_output=True, text=True)
    assert done.returncode == 7, done.stderr
    assert done.stdout == f"{odd} ['a b', '$HOME', \"'\"] say \"x\"\n"


def test_a_folder_that_is_not_there_is_not_run_in(tmp_path: Path) -> None:
    wish = machine.Wish(["echo", "run"], tmp_path / "none")
    done = subprocess.run(["sh", "-c", machine.command_script(wish)], capture_output=True, text=True)
    assert done.returncode == 126 and done.stdout == ""


def test_the_machine_reads_our_files_and_writes_only_to_its_scratch(tmp_path: Path) -> None:
    scratch = tmp_path / "a,b"
    words = machine.qemu_words(made(tmp_path), machine.Wish(["ls"], tmp_path, cpus=2, memory_mb=512), scratch)
    shares = [words[i + 1] for i, word in enumerate(words) if word == "-virtfs"]
    assert len(shares) == 2 and all("security_model=none" in share for share in shares)
    host, own = shares
    assert "path=/," in host and host.endswith("readonly=on")
    assert f"path={str(scratch).replace(',', ',,')}," in own and "readonly" not in own
    assert words[words.index("-nic") + 1] == "none"
    assert (words[words.index("-smp") + 1], words[words.index("-m") + 1]) == ("2", "512")
    assert "--pdeathsig" in words, "the kernel ends QEMU when we are killed"


def test_output_is_handed_on_as_it_comes(tmp_path: Path) -> None:
    to, file = io.BytesIO(), tmp_path / "stdout"
    tail = machine.Tail(file, to)
    tail.pass_on()
    for text in (b"one\n", b"t", b"wo\n"):
        with file.open("ab") as more:
            more.write(text)
        tail.pass_on()
    assert to.getvalue() == b"one\ntwo\n"


# --- what it says ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({}, "the kernel did not boot"),
        ({"console": "Kernel panic - not syncing: no init"}, "no init"),
        ({"qemu": "qemu: could not load kernel"}, "could not load kernel"),
        ({"booted": "up"}, "the kernel ended before the command did"),
    ],
)
def test_a_machine_that_ends_without_an_answer_is_status_3(tmp_path: Path, files: dict[str, str], words: str) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(VmError, match=words) as caught:
        machine._status(tmp_path, 1)
    assert caught.value.status == EXIT_VM


def test_the_status_is_the_commands_own(tmp_path: Path) -> None:
    (tmp_path / "status").write_text("42\n")
    assert machine._status(tmp_path, 0) == 42


def test_a_command_that_does_not_end_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A QEMU that does nothing stands for a machine that hangs."""
    (tmp_path / "busybox").write_text("")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(machine, "qemu_words", lambda *_: ["sleep", "60"])
    with pytest.raises(VmError, match=r"stopped after 0.2 s: the kernel had not booted") as caught:
        machine.run(made(tmp_path), machine.Wish(["ls"], tmp_path, timeout_s=0.2), scratch)
    assert caught.value.status == EXIT_TIMEOUT and "--timeout" in caught.value.hint


def test_without_rights_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(needs, "find", lambda program: "/usr/bin/apt-get" if program == "apt-get" else None)
    monkeypatch.setattr(needs.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(needs.platform, "machine", lambda: "x86_64")
    with pytest.raises(VmError, match="not root") as caught:
        needs.require()
    assert "qemu-system-x86" in caught.value.hint and caught.value.hint.startswith("sudo apt-get install")


def test_another_processor_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(needs.platform, "machine", lambda: "aarch64")
    with pytest.raises(VmError, match="x86-64 host, not aarch64"):
        needs.require()


def test_a_busybox_with_libraries_does_not_do(tmp_path: Path) -> None:
    assert not needs.is_static(Path(shutil.which("sh") or "/bin/sh").resolve())
    script = tmp_path / "busybox"
    script.write_text("#!/bin/sh\n" * 20)
    assert not needs.is_static(script)


def test_another_recipe_is_another_image(monkeypatch: pytest.MonkeyPatch) -> None:
    before = image.recipe_hash()
    monkeypatch.setattr(image, "MODULES", (*image.MODULES, "can-isotp"))
    assert image.recipe_hash() != before


# --- with a machine ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_command_in_a_kernel_with_can(tmp_path: Path) -> None:
    """Both links are up, the output and the status are the command's, the host's files are not written."""
    if needs.missing():
        pytest.skip(f"not installed: {', '.join(needs.missing())}")
    if not (image.default_cache() / image.recipe_hash()).is_dir():
        pytest.skip("no kernel in the cache: tools/vcan_vm --prepare downloads one")
    script = "ip -br link show type vcan; echo words >&2; touch touched || exit 9; exit 5"
    words = [sys.executable, str(TOOL), "--timeout", "100", "--", "sh", "-c", script]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=115)
    assert done.returncode == 5, done.stderr
    lines = [line.split()[0] for line in done.stdout.splitlines()]
    assert lines == ["vcan0", "vcan1"] and done.stderr == "words\n"
    assert not (tmp_path / "touched").exists()

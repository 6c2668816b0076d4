"""A part is a file: ours by its name, a user's by its path, loaded again only when it is another one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import Effect
from tunefree_hil.base.errors import InputError

LATERAL = "tunefree_hil.control.lateral"


def test_a_users_file_is_loaded_again_only_when_its_text_changed(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("class CONTROLLER: pass\n")
    first = parts.load(LATERAL, f"{file}:CONTROLLER", "CONTROLLER")
    assert parts.load(LATERAL, f"{file}:CONTROLLER", "CONTROLLER") is first
    file.write_text("class CONTROLLER: gain = 1\n")
    assert parts.load(LATERAL, f"{file}:CONTROLLER", "CONTROLLER").gain == 1


def test_what_is_not_there_is_said_with_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there are lqr"):
        parts.load(LATERAL, "lqg", "CONTROLLER")
    with pytest.raises(InputError, match="does not exist"):
        parts.load(LATERAL, f"{tmp_path}/no.py:CONTROLLER", "CONTROLLER")
    (tmp_path / "mine.py").write_text("")
    with pytest.raises(InputError, match="has no CONTROLLER"):
        parts.load(LATERAL, f"{tmp_path}/mine.py:CONTROLLER", "CONTROLLER")


@pytest.mark.parametrize(
    ("text", "said"),
    [("x = 1\nimport no_such_thing\n", "line 2: ModuleNotFoundError"), ("x = 1\n\ndef (:\n", "line 3: SyntaxError")],
)
def test_a_users_file_that_does_not_load_is_said_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "mine.py"
    file.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        parts.load(LATERAL, f"{file}:CONTROLLER", "CONTROLLER")
    assert str(file) in caught.value.message and caught.value.hint


def test_a_users_export_of_another_kind_is_said(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("EFFECT = 7\n")
    with pytest.raises(InputError, match="is of type int, where Effect is expected"):
        parts.load("tunefree_hil.effects", f"{file}:EFFECT", "EFFECT", Effect)

"""What README and docs tell a reader to type exists: commands with their options, tools, make targets, links, files."""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from tests.house import ROOT
from tools.gap_exam.__main__ import parser as exam_parser
from tunefree_hil.cli.app import app

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# A fenced block, an indented one, or a code span of our program: whichever comes first.
PASTED = re.compile(
    r"^```(?P<language>[^\n]*)\n(?P<fenced>.*?)^```|(?P<indented>(?:^    \S[^\n]*\n)+)"
    r"|`(?P<span>(?:\.venv/bin/)?tunefree-hil [^`]+)`",
    re.MULTILINE | re.DOTALL,
)
PROGRAM = re.compile(r"^(?:\.venv/bin/)?tunefree-hil\b")
# Programs of other projects, and shell words: their options are not ours.
FOREIGN = ("sudo", "export", "candump", "optuna-dashboard", "canplayer", "cansend", "python", "pytest", "git")


def commands(text: str) -> Iterator[str]:
    """The commands of a page in its order: every line of a fenced block without a language and of an indented block,
    and code spans of our program. What is no command (a diagram) is fenced as `text`.
    """
    for found in PASTED.finditer(text):
        if found["span"]:
            yield " ".join(found["span"].split())
        elif not found["language"]:
            yield from _lines(found["fenced"] or textwrap.dedent(found["indented"] or ""))


def _lines(block: str) -> Iterator[str]:
    """Lines without their comments; one that ends in a backslash, or is followed by an indented one, goes on."""
    for line in re.sub(r"\\?\n[ \t]+(?=\S)", " ", block).splitlines():
        command = re.split(r"(?:^|\s+)#", line)[0].strip()
        if command:
            yield command


def parse(command: str) -> None:
    """Parse a `tunefree-hil` command line without running it. Raises what typer raises for a wrong option."""
    words = [word.strip("[]") for word in shlex.split(command)][1:]
    words = [word for word in words if not word.endswith(("...", "|"))]
    found = typer.main.get_command(app)
    context = found.context_class(found, info_name="tunefree-hil")
    while hasattr(found, "resolve_command"):
        name, found, words = found.resolve_command(context, words)
        context = found.context_class(found, info_name=name, parent=context)
    found.make_context(found.name, list(words), parent=context.parent)


def everything() -> list[tuple[str, str]]:
    """(page, command) of all pages."""
    return [(str(page.relative_to(ROOT)), line) for page in PAGES for line in commands(page.read_text("utf-8"))]


OURS = [pytest.param(line, id=f"{page}: {line}") for page, line in everything() if PROGRAM.match(line)]


@pytest.mark.parametrize("command", OURS)
def test_a_pasted_command_has_these_options(command: str) -> None:
    if "COMMAND" in command.split()[1:2]:
        return
    command = re.sub(r"\bN\b", "2", command.replace("[--", "--").replace("]", ""))
    parse(re.split(r" (?:&|;|\|) ", command)[0])


@pytest.mark.parametrize(("page", "command"), [pair for pair in everything() if not PROGRAM.match(pair[1])])
def test_a_pasted_tool_is_there(page: str, command: str) -> None:
    words = shlex.split(command)
    if words[0] == "make":
        targets = (ROOT / (words[words.index("-C") + 1] if "-C" in words else ".") / "Makefile").read_text()
        named = [word for word in words[1:] if "=" not in word and word != "-C" and "/" not in word]
        assert all(re.search(rf"^{name}:", targets, re.MULTILINE) for name in named), f"{page}: {command}"
    elif words[0].startswith("tools/"):
        assert (ROOT / words[0]).exists()
        if words[0] == "tools/measure" and len(words) > 1 and words[1].islower():
            assert (ROOT / "tools" / "measures" / f"{words[1]}.py").exists(), f"{page}: {command}"
    elif words[0] == ".venv/bin/python" and words[1:3] == ["-m", "tools.gap_exam"]:
        exam_parser().parse_args(words[3:])
    else:
        assert words[0] in FOREIGN or words[0].startswith(".venv/bin/"), f"{page}: {command}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text("utf-8"))
    broken = [target for target in targets if "://" not in target and not (page.parent / target).exists()]
    assert broken == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_are_named_exist(page: Path) -> None:
    named = re.findall(r"`((?:tunefree_hil/)?(?:[a-z_]+/)+[a-z_0-9]+\.(?:py|toml|dbc))`", page.read_text("utf-8"))
    missing = [name for name in named if not any((ROOT / base / name).exists() for base in ("", "tunefree_hil"))]
    assert missing == []


def test_a_planted_mistake_is_found() -> None:
    parse("tunefree-hil drive bench.toml --scenario left_turn")
    for wrong in ("tunefree-hil drive bench.toml --scenrio left_turn", "tunefree-hil derive bench.toml"):
        with pytest.raises(Exception, match="No such"):
            parse(wrong)

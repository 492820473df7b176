"""The commands that pages name, in blocks and within text, held against the command line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import typer

from wheelsight.app.cli import app

# What stands for any command or any option in tables.
_PLACEHOLDERS = ("COMMAND", "…", "info,", "--help", "--ply|--mesh")


def wheelsight_commands(text: str) -> Iterator[list[str]]:
    """The words after `wheelsight` of each command in a page; comments, and explanations behind it, are left out."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    within = re.findall(r"`(wheelsight [^`]*)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    for reported in (*lines, *within):
        if found := re.match(r"(?:[$>] +)?(?:\S*/)?wheelsight ([a-z].*)", reported.strip(), re.DOTALL):
            yield re.split(r"\s{2,}| \| ", found[1])[0].split()


@cache
def _command_line() -> Any:
    return typer.main.get_command(app)


def unknown_in(words: list[str]) -> list[str]:
    """Names of commands and options among the words that the command line does not have."""
    command = _command_line()
    while hasattr(command, "get_command") and words and words[0] not in _PLACEHOLDERS:
        if words[0].startswith("-"):
            break
        inner = command.get_command(None, words[0])
        if inner is None:
            return words[:1]
        command, words = inner, words[1:]
    known = {name for one in command.params for name in (*one.opts, *one.secondary_opts)}
    reported = [word.partition("=")[0] for word in words if word.startswith("--") and word not in _PLACEHOLDERS]
    return [name for name in reported if name not in known]

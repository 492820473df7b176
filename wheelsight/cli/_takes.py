"""Commands of many options: these are the fields of a class, and the command is handed one value."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

Options = TypeVar("Options")


def takes(kind: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Make a function of one dataclass a command whose options are the fields, with their annotations and defaults."""
    signature = inspect.signature(kind, eval_str=True)

    def command_of(work: Callable[[Options], None]) -> Callable[..., None]:
        def command(**given: Any) -> None:
            work(kind(**given))

        command.__name__, command.__doc__, command.__module__ = work.__name__, work.__doc__, work.__module__
        command.__annotations__ = {}
        command.__signature__ = signature.replace(return_annotation=None)  # type: ignore[attr-defined]
        return command

    return command_of

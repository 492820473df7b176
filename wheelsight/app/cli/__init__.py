"""The command line: one thin file a command. Heavy imports wait until a command runs.

The application is loaded at its first use: commands of packages beside wheelsight import modules of this one.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from wheelsight.app.cli.application import app, main

__all__ = ["app", "main"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'wheelsight.app.cli' has no attribute {name!r}")
    from wheelsight.app.cli import application

    return getattr(application, name)

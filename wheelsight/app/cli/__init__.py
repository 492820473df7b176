"""The command line: one thin file a command. Heavy imports wait until a command runs."""

from wheelsight.app.cli.application import app, main

__all__ = ["app", "main"]

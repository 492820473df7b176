"""The command line: one thin file a command. Nothing heavy loads before a command runs."""

from wheelsight.app.cli.application import app, main

__all__ = ["app", "main"]

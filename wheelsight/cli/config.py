"""`wheelsight config`: the settings that a run would go by."""

from __future__ import annotations

from typing import Annotated

import typer

from wheelsight.cli._options import Profile, settings_from
from wheelsight.cli._run_options import SettingsFile


def config(
    profile: Profile = None,
    config: SettingsFile = None,
    changed: Annotated[bool, typer.Option("--changed", help="Only what is not as by default.")] = False,
) -> None:
    """Print all settings as YAML, as `wheelsight run` takes them by --config.

    docs/configuration.md says of each what it is, and why it is what it is.

    [bold]Examples[/bold]

    wheelsight config --profile pi --changed

    wheelsight config > settings.yaml
    """
    from wheelsight.files import settings_text
    from wheelsight.settings.profiles import differing

    settings = settings_from({"--profile": profile}, config).to_dict()
    shown = differing(settings, settings_from({}).to_dict()) if changed else settings
    typer.echo(settings_text(shown), nl=False)

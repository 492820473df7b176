"""docs/configuration.md, made from the settings. Update it: python tests/configuration_page.py"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from wheelsight.config import Config

PAGE = Path(__file__).resolve().parent.parent / "docs" / "configuration.md"
HEAD = """# Configuration

All settings of a run, with their defaults. `wheelsight run RECORDING --config settings.yaml` reads them from a file,
which names only what it changes:

```yaml
clocks: {followers: 5}
report:
  pictures: 8
```

A run writes its settings, defaults included, to `config.yaml` beside its results. `--config` accepts that file again.
An unknown name, or a value out of range, is refused with file, line and fix. In Python, use
`wheelsight.config.load_config(path)`.

Settings of earlier versions that are constants now are refused with their value. To use the file of an old run, write
the rest to a new file: `wheelsight config --config OLD.yaml --drop-removed --changed > NEW.yaml`. wheelsight itself
ignores such names in old results and maps.

The last column is the source of the default. No real drive has confirmed those "found on the simulator alone".

This page is made from the settings by `python tests/configuration_page.py`.
"""


def limits(about: FieldInfo) -> str:
    """Such as "> 0, ≤ 10"."""
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    rules = (
        (sign, getattr(rule, name)) for rule in about.metadata for name, sign in signs.items() if hasattr(rule, name)
    )
    return ", ".join(f"{sign} {bound:g}" for sign, bound in rules)


def reported(value: Any) -> str:
    if value is PydanticUndefined:
        return "needed"
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def sections(settings: BaseModel, name: str = "") -> Iterator[tuple[str, BaseModel]]:
    yield name, settings
    for own in type(settings).model_fields:
        value = getattr(settings, own)
        if isinstance(value, BaseModel):
            yield from sections(value, f"{name}.{own}".strip("."))


def rows(settings: BaseModel) -> Iterator[str]:
    for name, about in type(settings).model_fields.items():
        value = getattr(settings, name)
        if isinstance(value, BaseModel):
            continue
        source = about.json_schema_extra.get("source", "") if isinstance(about.json_schema_extra, dict) else ""
        cells = (f"`{name}`", reported(value), limits(about), about.description or "", source)
        yield "| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |"


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for name, settings in sections(Config()):
        table = [*rows(settings)]
        if table:
            says = (type(settings).__doc__ or "").split("\n\n")[0].replace("\n    ", " ").strip()
            title = f"## `{name}`" if name else "## At the top"
            head = "| setting | default | range | what it is, and why | where it comes from |\n|---|---|---|---|---|"
            parts.append("\n".join((title, "", says, "", head, *table)) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

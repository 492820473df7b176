"""docs/configuration.md, made of the settings themselves. Write it anew: python tests/configuration_page.py"""

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

Every setting of a run, with its default. A run takes them from a file, `wheelsight run RECORDING --config
settings.yaml`, which names what it changes and nothing else:

```yaml
clocks: {followers: 5}
localizer:
  base_check: {sure_m: 1.0}
```

What a run went by, defaults included, stands in the `config.yaml` beside its results; that file can be given to
`--config` again. A name that is unknown, or a value out of its range, is refused with file, line and what would be
right. In Python it is `wheelsight.config.load_config(path)`.

The last column says where a default comes from: "found on the simulator alone" means that no real drive has confirmed
it.

This page is made of the settings themselves, by `python tests/configuration_page.py`.
"""


def limits(about: FieldInfo) -> str:
    """Such as "> 0, ≤ 10"."""
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    rules = (
        (sign, getattr(rule, name)) for rule in about.metadata for name, sign in signs.items() if hasattr(rule, name)
    )
    return ", ".join(f"{sign} {bound:g}" for sign, bound in rules)


def told(value: Any) -> str:
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
        cells = (f"`{name}`", told(value), limits(about), about.description or "", source)
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

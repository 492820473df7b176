"""The packages, and what sources import, read once for all tests that ask."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# wheelsight and the packages beside it.
PACKAGES = tuple(sorted(path.parent.name for path in ROOT.glob("wheelsight*/__init__.py")))
BESIDE = tuple(name for name in PACKAGES if name != "wheelsight")


@cache
def imports_in(source: str) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """All imports of a source, those inside functions and TYPE_CHECKING blocks too."""
    return tuple(node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Import | ast.ImportFrom))

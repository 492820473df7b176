"""What sources import, read once for all tests that ask."""

from __future__ import annotations

import ast
from functools import cache


@cache
def imports_in(source: str) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """All imports of a source, those inside functions and TYPE_CHECKING blocks too."""
    return tuple(node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Import | ast.ImportFrom))

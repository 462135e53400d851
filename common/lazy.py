"""Names of a module that are loaded when they are first used: those that it imports for type checkers alone."""

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def lazily(module: str) -> Callable[[str], Any]:
    """The `__getattr__` of a module: it loads what the module imports under ``if TYPE_CHECKING``, one name at a time.

    >>> import fem  # which says `__getattr__ = lazily(__name__)`
    >>> fem.read_scene.__module__
    'fem.scene.scene_file'
    """

    def loaded(name: str) -> Any:
        homes = _homes(str(sys.modules[module].__file__))
        if name not in homes:
            raise AttributeError(f"module '{module}' has no attribute '{name}'; it has {', '.join(sorted(homes))}.")
        home, own = homes[name]
        return getattr(import_module(home), own)

    return loaded


@cache
def _homes(file: str) -> dict[str, tuple[str, str]]:
    """Module and name there of each name that a file imports for type checkers alone."""
    tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    blocks = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    imported = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    return {each.asname or each.name: (str(node.module), each.name) for node in imported for each in node.names}

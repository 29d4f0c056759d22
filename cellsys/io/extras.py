"""What to install where a package of an extra is missing."""

from __future__ import annotations

import importlib
from types import ModuleType

from cellsys.errors import ParameterError


def extra(module: str, name: str, what: str) -> ModuleType:
    """A module of an extra.

    Raises
    ------
    ParameterError
        With the line that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ParameterError(
            f"{what} needs {module.partition('.')[0]}: pip install 'cellsys[{name}]'"
        ) from error

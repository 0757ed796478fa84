"""Message classes by their names, without rosidl_runtime_py, which has no wheel."""

from __future__ import annotations

import importlib
import re
from typing import Any

_TYPE_NAME = re.compile(r'([a-z][a-z0-9_]*)/(?:msg/)?([A-Z][A-Za-z0-9]*)\Z')


def message_class(type_name: str) -> Any | None:
    """Return the Python class of ``package/msg/Name``; None where this environment does not have it."""
    found = _TYPE_NAME.match(type_name)
    if found is None:
        return None
    try:
        return getattr(importlib.import_module(f'{found[1]}.msg'), found[2], None)
    except ImportError:
        return None

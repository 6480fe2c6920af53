"""How the classes of the settings are checked: strictly; the text below a field is its description."""

from __future__ import annotations

from pydantic import ConfigDict

from storage.contract import STRICT

DOCUMENTED = ConfigDict(**STRICT, use_attribute_docstrings=True)

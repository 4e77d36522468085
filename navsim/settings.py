"""What all settings have in common: a number is a number, and no text that looks like one."""

from __future__ import annotations

import dataclasses
from numbers import Integral, Real
from typing import Any

import numpy as np

_KINDS = {"float": "a number", "int": "a whole number", "bool": "true or false"}


def check_kinds(settings: Any, name: str) -> None:
    """Raises ValueError where a field of a dataclass holds another kind of value than it is declared to.

    Args:
        settings: an instance of a dataclass whose module postpones annotations; fields of other types than float, int
            and bool are passed over.
        name: what the settings are called in the message, such as ``"camera"``.
    """
    for field in dataclasses.fields(settings):
        value = getattr(settings, field.name)
        if field.type in _KINDS and not is_of_kind(str(field.type), value):
            raise ValueError(f"{name} {field.name} must be {_KINDS[str(field.type)]}; got {value!r}")


def is_of_kind(kind: str, value: object) -> bool:
    """Whether a value is a ``float``, ``int`` or ``bool``, of Python's or numpy's; a whole number is a float, too."""
    is_truth_value = isinstance(value, bool | np.bool_)
    if kind == "bool":
        return is_truth_value
    return not is_truth_value and isinstance(value, Integral if kind == "int" else Real)

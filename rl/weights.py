"""Whether a file of weights belongs to a network."""

from __future__ import annotations

import torch


def misfit(wanted: dict[str, torch.Tensor], found: object) -> str:
    """The first thing that is wrong with ``found`` as the weights ``wanted``; empty where nothing is."""
    if not isinstance(found, dict):
        return f"it holds a {type(found).__name__}, not weights by name"
    for name, weight in wanted.items():
        if not isinstance(found.get(name), torch.Tensor):
            return f'weight "{name}" is missing'
        if found[name].shape != weight.shape:
            return f'weight "{name}" has shape {tuple(found[name].shape)}, not {tuple(weight.shape)}'
        if found[name].layout != torch.strided or found[name].is_meta:
            return f'weight "{name}" is no dense tensor'
        if not found[name].isfinite().all():
            return f'weight "{name}" holds numbers that are not finite'
    unknown = [name for name in found if name not in wanted]
    return f'weight "{unknown[0]}" is unknown' if unknown else ""

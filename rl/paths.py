"""Which paths of a world, or of several, are driven in an evaluation."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from navsim.task import Path
from navsim.world import World

MOST_PATHS = 1000
"""Of several worlds together, where it is not said how many."""
_DRAWN_PATHS = 100


def few_paths(worlds: Sequence[World]) -> int | None:
    """How many paths tell enough while training: all of one world; of several 100, or one in each."""
    return None if len(worlds) == 1 else min(max(_DRAWN_PATHS, len(worlds)), sum(map(_number_of_paths, worlds)))


def _number_of_paths(world: World) -> int:
    return len(world.paths) or _DRAWN_PATHS


def all_paths(worlds: Sequence[World], num_paths: int | None, seed: int) -> list[Path]:
    """The paths to drive, ordered by their worlds."""
    if num_paths is not None and num_paths < 1:
        raise ValueError(f"num_paths must be at least 1; got {num_paths}")
    if len(worlds) == 1:
        return _paths_of(worlds[0], num_paths)
    if num_paths is None:
        num_paths = min(max(MOST_PATHS, len(worlds)), sum(map(_number_of_paths, worlds)))
    if num_paths < len(worlds):
        raise ValueError(f"num_paths ({num_paths}) must be at least 1 in each of the {len(worlds)} worlds")
    shares = _shared_out(num_paths, [len(world.paths) or num_paths for world in worlds])
    generators = np.random.default_rng(seed).spawn(len(worlds))
    paths = []
    for index, (world, share, generator) in enumerate(zip(worlds, shares, generators, strict=True)):
        own = _paths_of(world, None if world.paths else share)
        chosen = np.sort(generator.permutation(len(own))[:share])
        paths += [own[i]._replace(world_index=index) for i in chosen]
    return paths


def _shared_out(wanted: int, most: Sequence[int]) -> list[int]:
    """``wanted`` in shares as even as can be, none of them over ``most``; the first ones take what is left over.

    >>> _shared_out(10, [9, 2, 9])
    [4, 2, 4]
    """
    if wanted > sum(most):
        raise ValueError(f"the {len(most)} worlds have {sum(most)} paths together; num_paths asks for {wanted}")
    shares = [0] * len(most)
    while wanted:
        open_ones = [i for i, share in enumerate(shares) if share < most[i]]
        each = max(1, wanted // len(open_ones))
        for i in open_ones:
            added = min(each, most[i] - shares[i], wanted)
            shares[i] += added
            wanted -= added
    return shares


def _paths_of(world: World, num_paths: int | None) -> list[Path]:
    if num_paths is not None and num_paths < 1:
        raise ValueError(f"num_paths must be at least 1; got {num_paths}")
    if not world.paths:  # starts, goals or both are drawn: the listed ones take turns
        starts = [-1] if isinstance(world.starts, str) else range(len(world.starts))
        goals = [-1] if isinstance(world.goals, str) else range(len(world.goals))
        turns = itertools.cycle(itertools.product(starts, goals))
        return [Path(start, goal) for start, goal in itertools.islice(turns, num_paths or _DRAWN_PATHS)]
    if num_paths is not None and num_paths > len(world.paths):
        raise ValueError(f'world "{world.name}" has {len(world.paths)} paths; num_paths asks for {num_paths}')
    return [Path(start, goal) for start, goal in world.paths[:num_paths]]

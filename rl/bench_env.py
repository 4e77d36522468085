"""How fast ``NavEnv`` collects transitions, and where the time of a step goes.

All is processor time of one thread, which other programs on the machine change little. Freed memory is kept, as in
training (``rl.memory``).
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import torch
from rich.console import Console
from rich.progress import track
from rich.table import Table
from torchrl.collectors import Collector

import navsim.simulator
from navsim.camera import DepthCamera
from navsim.physics import Physics
from navsim.simulator import Simulator
from rl.baselines import RandomPolicy
from rl.env import NavEnv
from rl.memory import keep_freed_memory
from rl.run import processor
from rl.stopwatch import stopwatch

NUM_ENVS = 16
BATCH = 16 * NUM_ENVS
"""Transitions in a batch of the collector."""
_ROUNDS = 7
_WARM_UP = 8 * BATCH

_PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "physics": ((Physics, "drive"),),
    "camera": ((navsim.simulator, "cast"), (DepthCamera, "from_planar"), (DepthCamera, "to_uint8")),
    "rules of the task": ((Simulator, "step"),),
    "new episodes": ((Simulator, "reset"),),
    "image stacks and tensors": ((NavEnv, "_step"), (NavEnv, "_reset"), (NavEnv, "maybe_reset")),
}
"""What each part of a step consists of."""
_REST = "TorchRL"


def run(console: Console, *, world: str = "complex_train", steps: int = 4_096) -> float:
    """Prints transitions a second of 16 robots with 80x64 images, stacks of four, random actions, on one thread.

    Args:
        console: where to.
        world: a world file, or the name of a shipped world.
        steps: transitions in each of the seven rounds, of which the median counts.

    Returns:
        transitions a second, TorchRL's ``Collector`` included.

    Raises:
        navsim.WorldError: for a world file that cannot be used.
    """
    torch.set_num_threads(1)
    keep_freed_memory()
    env = NavEnv(world, NUM_ENVS, seed=0)
    collector = Collector(
        env,
        RandomPolicy(),
        frames_per_batch=BATCH,
        total_frames=-1,
        track_traj_ids=False,
        use_buffers=False,
        auto_register_policy_transforms=False,
    )
    batches = iter(collector)
    collect = lambda count: [next(batches) for _ in range(0, count, BATCH)]  # noqa: E731
    collect(_WARM_UP)
    rounds = track(range(_ROUNDS), "collecting", console=console, transient=True, disable=not console.is_terminal)
    rates = [steps / _seconds(lambda: collect(steps)) for _ in rounds]
    with stopwatch(_PARTS, time.process_time) as spent:
        total = _seconds(lambda: collect(steps))
    collector.shutdown()

    rate = statistics.median(rates)
    camera = env.simulator.camera
    console.print(
        f"[bold]{rate:,.0f} transitions/s[/bold] ({min(rates):,.0f} to {max(rates):,.0f} in {_ROUNDS} rounds): "
        f"{NUM_ENVS} robots in {world}, {camera.width}x{camera.height}, random actions, "
        f"processor time of one thread, {processor()}"
    )
    console.print(_breakdown(spent, total, 1e6 * total / steps))
    return rate


def _breakdown(spent: dict[str, float], total: float, microseconds: float) -> Table:
    table = Table(title="where a transition's time goes", title_justify="left")
    table.add_column("part")
    table.add_column("share", justify="right")
    table.add_column("µs", justify="right")
    spent = {**{part: spent.get(part, 0.0) for part in _PARTS}, _REST: total - sum(spent.values())}
    for part, seconds in spent.items():
        table.add_row(part, f"{seconds / total:.0%}", f"{microseconds * seconds / total:.1f}")
    table.add_section()
    table.add_row("all", "100%", f"{microseconds:.1f}")
    return table


def _seconds(function: Callable[[], Any]) -> float:
    begin = time.process_time()
    function()
    return time.process_time() - begin

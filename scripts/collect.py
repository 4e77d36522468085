"""A dataset of robots that drive at random, made with nothing but ``NavEnv`` and TorchRL.

    python scripts/collect.py --out datasets/random --batches 20 --processes 2

A transition takes 41 kB on disk. The dataset is read where it lies, as memory-mapped files::

    transitions = TensorDict.load_memmap("datasets/random")
    replay = ReplayBuffer(storage=TensorStorage(transitions), batch_size=64)
"""

import signal
import sys
import tempfile
from functools import partial
from pathlib import Path

import torch
import tyro
from rich.progress import track
from tensordict import TensorDict
from torchrl.collectors import Collector

from rl import NavEnv


def collect(
    out: Path, world: str = "complex_train", batches: int = 20, num_envs: int = 16, processes: int = 0, seed: int = 0
) -> None:
    """Collect transitions of robots that drive at random, and store them on disk.

    Args:
        out: Directory to make; it appears when all is collected.
        world: World file, name of a shipped world, or generated rooms such as generate:clutter,count=200.
        batches: Batches to collect, each of 16 steps of every robot.
        num_envs: Robots that one environment simulates together.
        processes: Processes that collect side by side, each with an environment; 0 collects in this one.
        seed: Seed of starts, goals and actions.
    """
    if out.exists():
        raise ValueError(f"{out} is there already; move it away, or choose another directory (--out)")
    least = {"batches": (batches, 1), "num-envs": (num_envs, 1), "processes": (processes, 0), "seed": (seed, 0)}
    for name, (value, at_least) in least.items():
        if value < at_least:
            raise ValueError(f"--{name} must be at least {at_least}; got {value}")
    torch.manual_seed(seed)
    create_env = [partial(NavEnv, world, num_envs, seed=seed + i) for i in range(max(1, processes))]
    collector = Collector(
        create_env if processes else create_env[0],
        num_collectors=processes or None,
        sync=True if processes else None,
        frames_per_batch=(size := 16 * num_envs * len(create_env)),
        total_frames=batches * size,
    )
    if processes:
        collector.set_seed(seed)  # of the processes' actions, too
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as unfinished:
        dataset: TensorDict | None = None
        try:
            for i, batch in enumerate(track(collector, "collecting", total=batches)):
                transitions = batch.reshape(-1)
                if dataset is None:
                    dataset = transitions[:1].expand(batches * size).memmap_like(Path(unfinished) / "dataset")
                dataset[i * size : (i + 1) * size] = transitions
        finally:
            collector.shutdown()
        (Path(unfinished) / "dataset").rename(out)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that nothing half done is left behind then, either
    try:
        tyro.cli(collect)
    except (OSError, ValueError) as error:  # a WorldError is one
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit("interrupted; nothing is kept")

"""Deep Q-learning in a page: ``NavEnv`` and this project's replay between TorchRL's own parts, to be changed at will.

    python scripts/own_loop.py --out own_loop.pt --steps 40000

A loss of your own goes in the place of ``D3QNLoss``; TorchRL's ``DQNLoss(actor, double_dqn=True, delay_value=True,
action_space="categorical")`` takes the same samples, if ``loss.make_value_estimator(gamma=0.97)`` gives it the replay's
discount. A network of your own, any module of depth images ``(..., 4, 64,
80)`` uint8 and headings ``(..., 1)``, radians, that returns the seven actions' values ``(..., 7)``, goes into
``QValueActor(network, in_keys=["depth", "heading"], spec=env.action_spec_unbatched)``. docs/own_code.md has more, and
how to use what was learnt.
"""

import sys
from pathlib import Path

import torch
import tyro
from rich.progress import track
from tensordict.nn import TensorDictSequential
from torch.optim.lr_scheduler import CosineAnnealingLR
from torchrl.collectors import Collector
from torchrl.modules import EGreedyModule
from torchrl.objectives import SoftUpdate

from navsim import WorldError
from navsim.worldsource import worlds_from
from rl import D3QNLoss, NavEnv, evaluate, make_q_actor, make_replay


def learn(
    out: Path,
    world: str = "generate:clutter,count=100",
    eval_world: str = "complex_eval",
    steps: int = 40_000,
    num_envs: int = 16,
    seed: int = 0,
) -> None:
    """Train a robot with a loop of one page, let it drive greedily where it has never been, and keep its weights.

    Args:
        out: File to write the network's weights to, which are for make_q_actor("I", depth_scale="inverse").
        world: World file, name of a shipped world, or generated rooms, to train in.
        eval_world: World to drive in afterwards.
        steps: Transitions to learn from.
        num_envs: Robots that drive at once.
        seed: Of starts, goals, exploration and network; rooms are others with a seed of their own, as in
            generate:clutter,count=100,seed=7.
    """
    if out.is_dir():
        raise SystemExit(f"{out} is a directory; --out names the file to write weights to, such as {out / 'actor.pt'}")
    for name, value, at_least in (("steps", steps, 1), ("num-envs", num_envs, 1), ("seed", seed, 0)):
        if value < at_least:
            raise SystemExit(f"--{name} must be at least {at_least}; got {value}")
    rooms = worlds_from(eval_world)  # what is wrong with it is told before the training, not after
    out.parent.mkdir(parents=True, exist_ok=True)
    torch.set_flush_denormal(True)  # else Adam gets slower as units fall silent: docs/performance.md
    torch.manual_seed(seed)
    env = NavEnv(world, num_envs, seed=seed)
    actor = make_q_actor("I", depth_scale="inverse")  # what is near fills most of the scale
    loss = D3QNLoss(actor, gamma=0.97, loss_function="smooth_l1")
    target = SoftUpdate(loss, tau=0.005)
    optimiser = torch.optim.Adam(loss.parameters(), lr=5e-4, fused=True)
    replay = make_replay(capacity=50_000, batch_size=64, n_step=3, gamma=0.97, mirror=True)

    size = 16 * num_envs
    batches, updates = -(-steps // size), size // 8  # each transition is learnt from eight times
    descent = CosineAnnealingLR(optimiser, batches * updates)
    exploration = EGreedyModule(env.action_spec, eps_init=1.0, eps_end=0.05, annealing_num_steps=batches // 2)
    policy = TensorDictSequential(actor, exploration)
    collector = Collector(
        env, policy, frames_per_batch=size, total_frames=batches * size, auto_register_policy_transforms=False
    )
    for batch in track(collector, "learning", total=batches):
        replay.extend(batch)
        exploration.step()
        for _ in range(updates):
            loss(replay.sample())["loss"].backward()
            optimiser.step()
            optimiser.zero_grad()
            descent.step()
            target.step()

    torch.save(actor.state_dict(), out)
    print(f"{evaluate(actor, rooms).success_rate:.0%} of goals reached in {eval_world}; weights in {out}")


if __name__ == "__main__":
    try:
        tyro.cli(learn)
    except WorldError as error:
        sys.exit(str(error))

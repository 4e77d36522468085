"""Deep Q-learning for `navsim`, on TorchRL: environment, networks, loss, replay, training, evaluation, report."""

from rl.loss import D3QNLoss
from rl.networks import make_q_actor

__all__ = ["D3QNLoss", "make_q_actor"]

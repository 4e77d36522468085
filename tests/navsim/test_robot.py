import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from navsim.robot import (
    ACTIONS,
    INITIAL_COMMAND,
    MIRRORED_ACTIONS,
    NUM_ACTIONS,
    Robot,
    apply_actions,
    follow_arc,
    wrap_angle,
)


def test_an_action_changes_one_command_and_leaves_the_other():
    commands = np.array([[0.4, 0.3]] * NUM_ACTIONS)
    expected = [[0.2, 0.3], [0.4, 0.3]] + [
        [0.4, turn] for turn in (math.pi / 4, math.pi / 8, 0.0, -math.pi / 8, -math.pi / 4)
    ]
    np.testing.assert_array_equal(apply_actions(commands, np.arange(NUM_ACTIONS)), expected)


def test_ten_commands_are_reachable():
    reached, frontier = {INITIAL_COMMAND}, {INITIAL_COMMAND}
    while frontier:
        following = {
            tuple(apply_actions(np.array([command]), np.array([action]))[0].tolist())
            for command in frontier
            for action in range(NUM_ACTIONS)
        }
        frontier = following - reached
        reached |= frontier
    assert len(reached) == 10
    assert {linear for linear, _ in reached} == {0.2, 0.4}


def test_mirrored_actions_turn_the_other_way():
    for action, mirrored in zip(ACTIONS, MIRRORED_ACTIONS, strict=True):
        assert ACTIONS[mirrored].linear == action.linear
        if action.angular is not None:
            assert ACTIONS[mirrored].angular == -action.angular


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_the_same_direction_in_the_half_open_range(angle):
    wrapped = float(wrap_angle(np.array(angle)))
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@pytest.mark.parametrize("multiple", [-5, -3, -1, 1, 3, 5])
def test_odd_multiples_of_pi_wrap_to_plus_pi(multiple):
    assert float(wrap_angle(np.array(multiple * math.pi))) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("linear", "angular"), [(0.4, 0.0), (0.4, 1e-9), (0.2, math.pi / 4), (0.65, -math.pi), (0.0, 1.0)]
)
def test_arcs_agree_with_integrated_unicycle_equations(linear, angular):
    start = np.array([0.3, -0.2, 0.7])
    solution = solve_ivp(
        lambda _, state: [linear * math.cos(state[2]), linear * math.sin(state[2]), angular],
        (0.0, 3.0),
        start,
        rtol=1e-11,
        atol=1e-12,
    )
    ended = follow_arc(start, np.array([linear, angular]), 3.0)
    np.testing.assert_allclose(ended[:2], solution.y[:2, -1], atol=1e-8)
    assert float(wrap_angle(ended[2] - solution.y[2, -1])) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"radius": 0.0}, "radius"),
        ({"mass": math.nan}, "mass"),
        ({"max_linear_speed": -1.0}, "max_linear_speed"),
        ({"linear_acceleration": 0.0}, "linear_acceleration"),
    ],
)
def test_impossible_robots_are_refused_by_name(settings, named):
    with pytest.raises(ValueError, match=named):
        Robot(**settings)

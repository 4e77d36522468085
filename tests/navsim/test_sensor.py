"""The sensor's noise: its measured statistics against the formulas of the papers that they come from."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from navsim.camera import DepthCamera
from navsim.raycast import render_depth
from navsim.robot import NUM_ACTIONS
from navsim.sensor import (
    KINECT,
    Sensor,
    SensorModel,
    axial_sigma,
    beside_edge,
    in_shadow,
    incidence,
    lateral_sigma,
)
from navsim.simulator import Simulator
from navsim.task import Task
from navsim.world import World

CAMERA = DepthCamera()


class FineCamera(DepthCamera):
    """A camera whose counts are so fine that they hide nothing: ``to_uint8`` gives metres."""

    def to_uint8(self, ideal: np.ndarray) -> np.ndarray:
        return ideal


def expose(model: SensorModel, ideal: np.ndarray, camera: DepthCamera = CAMERA, level: float = 1.0) -> np.ndarray:
    """``(K, H, W)`` metres, what the sensors of K robots read, before counts of ``uint8``."""
    fine = FineCamera(**vars_of(camera))
    sensor = Sensor(fine, model, len(ideal), model.latency)
    sensor.noise_level[:] = level
    sensor.reseed(np.random.SeedSequence(0).spawn(len(ideal)))
    return sensor._expose(np.arange(len(ideal)), ideal.astype(np.float32))


def vars_of(camera: DepthCamera) -> dict:
    return {name: getattr(camera, name) for name in camera.__dataclass_fields__}


def wall(depth: float, count: int = 4, camera: DepthCamera = CAMERA) -> np.ndarray:
    return np.full((count, camera.height, camera.width), depth, dtype=np.float32)


def room(*obstacles: dict) -> World:
    start = {"at": [-2.5, 0.0], "yaw_deg": 0}
    return World.from_dict(
        {"format": 1, "size": [7, 7], "obstacles": list(obstacles), "starts": [start], "goals": [[2, 2]]}
    )


def test_nothing_is_the_default():
    ideal = np.random.default_rng(0).uniform(0.0, 5.0, (2, 64, 80)).astype(np.float32)
    assert SensorModel().is_exact
    np.testing.assert_array_equal(expose(SensorModel(), ideal), ideal)


# ---- axial noise


@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0, 3.0, 4.5])
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_axial_noise_has_nguyens_sigma(depth, share):
    read = expose(SensorModel(axial_noise=share), wall(depth, 8))
    sigma = share * (0.0012 + 0.0019 * (depth - 0.4) ** 2)
    assert axial_sigma(np.array(depth)) * share == pytest.approx(sigma)
    # 99.99% confidence bounds of a standard deviation of normal numbers, and of their mean.
    freedom = read.size - 1
    low, high = np.sqrt(stats.chi2.ppf([5e-5, 1 - 5e-5], freedom) / freedom)
    assert low * sigma < read.std(ddof=1, dtype=np.float64) < high * sigma
    assert abs(read.mean(dtype=np.float64) - depth) < 4.0 * sigma / math.sqrt(read.size)
    assert stats.kstest((read.ravel()[:5000] - depth) / sigma, "norm").pvalue > 1e-4


def test_noise_of_neighbours_and_of_robots_is_independent():
    read = expose(SensorModel(axial_noise=1.0), wall(2.0, 3)) - 2.0
    for one, other in ((read[0], read[1]), (read[:, :, 1:], read[:, :, :-1]), (read[:, 1:], read[:, :-1])):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4.0 / math.sqrt(one.size)


def test_what_is_out_of_range_has_no_noise():
    ideal = wall(5.0)
    ideal[:, 32:] = 4.9
    read = expose(SensorModel(axial_noise=1.0), ideal)
    assert np.all(read[:, :32] == 5.0)
    assert read[:, 32:].max() == 5.0  # noise beyond the range is cut off
    assert read[:, 32:].std() > 0.02


def test_what_is_out_of_range_has_no_noise_in_range_images():
    camera = DepthCamera(depth="range")
    read = expose(SensorModel(axial_noise=1.0, lateral_noise=1.0), wall(5.0, camera=camera), camera)
    assert np.all(read == 5.0)


def test_range_images_have_the_noise_of_their_planar_depth():
    camera = DepthCamera(depth="range")
    read = expose(SensorModel(axial_noise=1.0), wall(2.0, 40) * camera.ray_lengths, camera) / camera.ray_lengths
    assert read.std(dtype=np.float64) == pytest.approx(axial_sigma(np.array(2.0)), rel=0.02)


def test_the_noise_level_scales_noise_and_losses():
    read = expose(SensorModel(axial_noise=1.0), wall(2.0, 8), level=0.25)
    assert read.std(dtype=np.float64) == pytest.approx(0.25 * axial_sigma(np.array(2.0)), rel=0.02)
    np.testing.assert_array_equal(
        expose(replace(KINECT, shadows=False, disparity_step=0.0), wall(2.0), level=0.0), wall(2.0)
    )


# ---- lateral noise


def step_edge(camera: DepthCamera, count: int) -> np.ndarray:
    """A board 1 m away on the left, a wall 3 m away on the right."""
    ideal = wall(3.0, count, camera)
    ideal[..., : camera.width // 2] = 1.0
    return ideal


@pytest.mark.parametrize("width", [640, 80])
def test_silhouettes_are_displaced_by_nguyens_lateral_sigma(width):
    """On either side of an edge E[max(δ, 0)] = σ/√(2π) pixels show what belongs to the other."""
    camera = DepthCamera(width=width, height=64)
    model = SensorModel(lateral_noise=1.0)
    sigma = 0.8 * camera.fx / 580.0  # head-on; σ(θ) grows by 0.2% at the edges of such an image
    read = expose(model, step_edge(camera, 16), camera)
    rows = 16 * 64
    lost = np.count_nonzero(read[..., : width // 2] > 2.0) / rows
    gained = np.count_nonzero(read[..., width // 2 :] < 2.0) / rows
    expected = sigma / math.sqrt(2.0 * math.pi)
    bound = 4.0 * math.sqrt(max(expected, sigma**2) / rows)
    assert abs(lost - expected) < bound
    assert abs(gained - expected) < bound
    assert np.isin(read.round(4), [1.0, 3.0]).all()  # one surface or the other, nothing between


def test_how_far_silhouettes_are_displaced_is_normal_in_the_kinects_own_pixels():
    camera = DepthCamera(width=640, height=64)
    read = expose(SensorModel(lateral_noise=2.0), step_edge(camera, 16), camera)
    shares = (read < 2.0).mean(axis=(0, 1))
    beyond = np.arange(640) - (320 - 1)  # columns past the last one of the board
    sigma, reach = 1.6 * camera.fx / 580.0, np.linspace(-9.0, 9.0, 20001)
    density = stats.norm.pdf(reach, scale=sigma)
    # A pixel k columns past the board shows it where its displacement, rounded at random, is -k or less.
    expected = [np.trapezoid(density * np.clip(1.0 - (reach + k), 0.0, 1.0), reach) for k in beyond[314:326]]
    np.testing.assert_allclose(shares[314:326], expected, atol=4.0 * math.sqrt(0.25 / (16 * 64)))


@pytest.mark.parametrize("direction", ["to the left", "upwards"])
def test_lateral_noise_follows_planes(direction):
    """Displacing what is seen of a wall that is turned away adds the depth of the displacement, no more."""
    camera, slope = DepthCamera(), 0.8  # metres of depth per metre to the left, or upwards
    if direction == "to the left":
        slopes, focal_length, pixel = np.broadcast_to(camera.column_slopes, (64, 80)), camera.fx, camera.fx / 580.0
    else:
        slopes, focal_length, pixel = np.repeat(camera.row_slopes[:, None], 80, axis=1), camera.fy, camera.fy / 580.0
    inverse = (1.0 - slope * slopes) / 2.0
    read = expose(SensorModel(lateral_noise=1.0), np.repeat(1.0 / inverse[None], 30, axis=0), camera)
    displaced = ((1.0 / read - inverse) / (slope / focal_length / 2.0))[:, 5:-5, 5:-5]  # pixels
    angle = np.arccos(inverse * 2.0 / math.hypot(1.0, slope) / camera.ray_lengths)[5:-5, 5:-5]
    sigma = pixel * (0.8 + 0.035 * angle / (math.pi / 2 - angle))
    assert displaced.mean(dtype=np.float64) == pytest.approx(0.0, abs=0.002)
    assert (displaced / sigma).std(dtype=np.float64) == pytest.approx(1.0, rel=0.01)


def test_lateral_sigma_grows_with_the_angle_up_to_80_degrees():
    angle = np.radians([0.0, 45.0, 80.0, 89.9])
    np.testing.assert_allclose(lateral_sigma(angle), [0.8, 0.835, 1.08, 1.08], atol=1e-6)


# ---- geometry of images


def test_incidence_is_the_angle_between_ray_and_surface():
    world = room({"box": {"at": [0.5, 0.6], "size": [1.0, 1.0], "height": 1.5, "yaw_deg": 30}})
    camera = DepthCamera(width=160, height=128, pitch_deg=8.0)
    planar = render_depth(world, np.array([[-2.0, 0.0, 0.2]]), camera)[0].astype(np.float64)
    cosine = incidence(1.0 / planar, camera)
    # On the floor: the ray's fall over its length.
    floor = np.abs(-camera.mount_z / camera.row_climbs[:, None] - planar) < 1e-5
    expected = np.broadcast_to((-camera.row_climbs[:, None]) / camera.ray_lengths, planar.shape)
    inner = floor & np.roll(floor, 1, 0) & np.roll(floor, -1, 0) & np.roll(floor, 1, 1) & np.roll(floor, -1, 1)
    assert inner.sum() > 2000
    np.testing.assert_allclose(cosine[inner], expected[inner], rtol=1e-3)
    assert np.all((cosine > 0.0) & (cosine <= 1.0 + 1e-9))


@pytest.mark.parametrize("field_of_view", [40.0, 60.0, 90.0])
def test_shadows_are_what_a_projector_to_the_right_does_not_light(field_of_view):
    camera = DepthCamera(width=640, height=4, horizontal_fov_deg=field_of_view)
    ideal = wall(3.1, 1, camera)
    ideal[..., 300:400] = 1.0
    shadow = in_shadow(1.0 / ideal, camera)[0, 0]
    # Where the way from the projector, 75 mm to the right, to each pixel's place on the wall passes the board at 1 m.
    places = 3.1 * camera.column_slopes
    passes = -0.075 + (places + 0.075) / 3.1
    left, right = (camera.column_slopes[column] for column in (300, 399))
    expected = (passes < left) & (passes > right) & (ideal[0, 0] > 2.0)
    assert np.abs(np.flatnonzero(shadow)[[0, -1]] - np.flatnonzero(expected)[[0, -1]]).max() <= 1
    assert shadow.sum() == pytest.approx(camera.fx * 0.075 * (1.0 - 1.0 / 3.1), abs=1.0)


def test_the_shadows_of_a_small_image():
    small = DepthCamera()
    ideal = wall(3.0, 1, small)
    ideal[..., 40:45] = 1.0
    assert list(np.flatnonzero(in_shadow(1.0 / ideal, small)[0, 0])) == [37, 38, 39]
    read = expose(SensorModel(shadows=True), ideal)
    assert (read == 0.0).sum() == 3 * 64


def test_edges_are_jumps_and_neither_slopes_nor_corners():
    world = room()
    planar = render_depth(world, np.array([[-2.0, 1.0, 0.6]]), CAMERA)
    assert not beside_edge(1.0 / planar)[:, 8:].any()  # floor, walls, the corner between them, the range's end
    assert beside_edge(1.0 / planar)[:, :8].any()  # the wall's upper edge
    ideal = wall(3.0, 1)
    ideal[:, 20:40, 30:50] = 1.0
    expected = np.zeros((64, 80), dtype=bool)
    expected[19:21, 30:50] = expected[39:41, 30:50] = expected[20:40, 29:31] = expected[20:40, 49:51] = True
    np.testing.assert_array_equal(beside_edge(1.0 / ideal)[0], expected)


@pytest.mark.parametrize("probability", [0.1, 0.5])
def test_edges_are_lost_with_their_probability(probability):
    ideal = wall(3.0, 60)
    ideal[:, 20:40, 30:50] = 1.0
    beside = beside_edge(1.0 / ideal)
    read = expose(SensorModel(edge_loss=probability), ideal)
    share, count = (read[beside] == 0.0).mean(), beside.sum()
    assert abs(share - probability) < 4.0 * math.sqrt(probability * (1 - probability) / count)
    np.testing.assert_array_equal(read[~beside], ideal[~beside])


@pytest.mark.parametrize(("angle_deg", "expected"), [(50.0, 0.0), (65.0, 0.2), (75.0, 0.6), (84.0, 0.8)])
def test_grazing_surfaces_are_lost_from_60_to_80_degrees(angle_deg, expected):
    camera = DepthCamera(width=9, height=9, horizontal_fov_deg=1.0, vertical_fov_deg=1.0)
    inverse = (1.0 - math.tan(math.radians(angle_deg)) * camera.column_slopes) / 2.0
    ideal = np.broadcast_to(1.0 / inverse, (400, 9, 9))
    read = expose(SensorModel(grazing_loss=0.8), ideal, camera)
    assert abs((read == 0.0).mean() - expected) < 4.0 * math.sqrt(0.25 / read.size) + 0.004


# ---- disparity


def test_depth_comes_in_steps_of_an_eighth_of_a_pixel_of_disparity():
    ideal = np.linspace(0.5, 4.99, 64 * 80, dtype=np.float32).reshape(1, 64, 80)
    read = expose(SensorModel(disparity_step=0.125), ideal)
    steps = 43.5 / read.astype(np.float64) * 8.0
    np.testing.assert_allclose(steps, np.rint(steps), atol=2e-3)
    assert np.abs(43.5 / read - 43.5 / ideal).max() < 0.0625 * 1.001
    for depth, step in ((1.0, 0.0029), (3.0, 0.026), (4.5, 0.058)):
        levels = np.unique(read[np.abs(read - depth) < 0.12])
        assert np.diff(levels).mean() == pytest.approx(step, rel=0.1)


# ---- latency, seeds, states


def driven(simulator: Simulator, steps: int, seed: int = 5) -> list[np.ndarray]:
    generator, seen = np.random.default_rng(seed), [simulator.reset().depth]
    for _ in range(steps):
        moved = simulator.step(generator.integers(NUM_ACTIONS, size=simulator.num_robots))
        seen.append(moved.depth)
        ended = moved.terminated | moved.truncated
        if ended.any():
            seen[-1] = simulator.reset(ended).depth
    return seen


@pytest.mark.parametrize("latency", [1, 3])
def test_images_are_late_by_the_latency_and_begin_with_the_first(latency):
    world = room({"cylinder": {"at": [0.5, 0.3], "radius": 0.2, "height": 1.0}})
    settings = {"camera": DepthCamera(width=20, height=16), "task": Task(max_steps=300), "seed": 1}
    prompt = driven(Simulator(world, 2, **settings), 12)
    late = driven(Simulator(world, 2, sensor=SensorModel(latency=latency), **settings), 12)
    for step, image in enumerate(late):
        np.testing.assert_array_equal(image, prompt[max(0, step - latency)])
    assert not np.array_equal(prompt[0], prompt[1])


def test_after_a_reset_nothing_is_seen_of_the_episode_before():
    world = World.from_dict({"format": 1, "size": [7, 7], "starts": "random", "goals": "random"})
    camera = DepthCamera(width=20, height=16)
    simulator = Simulator(world, 3, camera=camera, sensor=SensorModel(latency=2), seed=0)
    simulator.reset()
    for _ in range(4):
        before = simulator.step(np.array([1, 2, 3])).depth
    observation = simulator.reset(np.array([False, True, False]))
    np.testing.assert_array_equal(observation.depth[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(observation.depth[1], camera.to_uint8(simulator.ideal_depth[1]))
    np.testing.assert_array_equal(simulator.step(np.array([4, 4, 4])).depth[1], observation.depth[1])


def test_collisions_are_judged_on_the_ideal_and_present_image():
    world = room({"box": {"at": [-0.5, 0.0], "size": [0.2, 3.0], "height": 1.0}})
    runs = []
    for sensor in (SensorModel(), replace(KINECT, latency=3)):
        simulator = Simulator(world, 1, sensor=sensor, seed=0)
        simulator.reset()
        flags = [simulator.step(np.array([1]))]
        while not flags[-1].terminated[0]:
            flags.append(simulator.step(np.array([1])))
        runs.append((len(flags), flags[-1].too_near[0], simulator.ideal_depth.tobytes()))
    assert runs[0] == runs[1]
    assert runs[0][1]


NOISY = {
    "camera": DepthCamera(width=20, height=16),
    "task": Task(max_steps=15),
    "sensor": replace(KINECT, latency=2),
}


def test_the_same_seed_gives_the_same_noise_whoever_else_is_there():
    world = room({"cylinder": {"at": [0.5, 0.3], "radius": 0.2, "height": 1.0}})
    runs = [driven(Simulator(world, 3, seed=seed, **NOISY), 40) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
    few, many = (Simulator(world, count, seed=3, **NOISY) for count in (2, 5))
    np.testing.assert_array_equal(few.reset().depth, many.reset().depth[:2])
    for actions in np.random.default_rng(1).integers(NUM_ACTIONS, size=(40, 5)):
        one, other = few.step(actions[:2]), many.step(actions)
        np.testing.assert_array_equal(one.depth, other.depth[:2])
        one, other = (
            simulator.reset(moved.terminated | moved.truncated) for simulator, moved in ((few, one), (many, other))
        )
        np.testing.assert_array_equal(one.depth, other.depth[:2])


def test_episodes_are_the_same_with_and_without_noise():
    world = World.from_dict({"format": 1, "size": [7, 7], "starts": "random", "goals": "random"})
    quiet, noisy = (Simulator(world, 2, seed=8, sensor=sensor) for sensor in (SensorModel(), KINECT))
    for _ in range(3):
        np.testing.assert_array_equal(quiet.reset().pose, noisy.reset().pose)


def test_a_noisy_run_resumes_from_its_state_bit_for_bit():
    world = room({"cylinder": {"at": [0.5, 0.3], "radius": 0.2, "height": 1.0}})
    original = Simulator(world, 3, seed=3, **NOISY)
    driven(original, 20)
    resumed = Simulator(world, 3, seed=99, **NOISY)
    resumed.load_state_dict(pickle.loads(pickle.dumps(original.state_dict())))
    none = np.zeros(3, dtype=bool)
    np.testing.assert_array_equal(resumed.reset(none).depth, original.reset(none).depth)
    for actions in np.random.default_rng(2).integers(NUM_ACTIONS, size=(40, 3)):
        one, other = original.step(actions), resumed.step(actions)
        np.testing.assert_array_equal(one.depth, other.depth)
        ended = one.terminated | one.truncated
        np.testing.assert_array_equal(original.reset(ended).depth, resumed.reset(ended).depth)


def test_a_state_of_another_sensor_is_refused():
    world = room()
    state = Simulator(world, 2, seed=0, **NOISY).state_dict()
    with pytest.raises(ValueError, match="create it with the same worlds, camera, sensor and randomization"):
        Simulator(world, 2, camera=NOISY["camera"]).load_state_dict(state)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"axial_noise": -1.0}, "sensor axial_noise must be a finite number, at least 0; got -1.0"),
        ({"lateral_noise": math.nan}, "sensor lateral_noise must be a finite number, at least 0; got nan"),
        ({"disparity_step": math.inf}, "sensor disparity_step must be a finite number, at least 0; got inf"),
        ({"edge_loss": 1.5}, "sensor edge_loss must be a probability, from 0 to 1; got 1.5"),
        ({"grazing_loss": -0.1}, "sensor grazing_loss must be a probability, from 0 to 1; got -0.1"),
        ({"shadows": "no"}, "sensor shadows must be true or false; got 'no'"),
        ({"filled": 1}, "sensor filled must be true or false; got 1"),
        ({"latency": -1}, "sensor latency must be from 0 to 100 steps; got -1"),
        ({"latency": 1.5}, "sensor latency must be a whole number; got 1.5"),
        ({"latency": 10**9}, "sensor latency must be from 0 to 100 steps; got 1000000000"),
    ],
)
def test_impossible_settings_are_refused_in_one_sentence(settings, message):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - the whole sentence is compared below
        SensorModel(**settings)
    assert str(refused.value) == message

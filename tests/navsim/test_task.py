import math

import numpy as np
import pytest
import shapely

from navsim.camera import DepthCamera
from navsim.places import START_CLEARANCE
from navsim.planner import shortest_path_length
from navsim.raycast import Scene, cast, nearest_depth
from navsim.robot import TURTLEBOT2
from navsim.task import Episodes, Path, Task, goal_distance, heading, rewards
from navsim.world import World
from navsim.worldfile import load_world

CAMERA = DepthCamera()
TASK = Task()


def make_world(*obstacles, size=(7.0, 7.0), **settings):
    return World.from_dict({"format": 1, "size": list(size), "obstacles": list(obstacles), **settings})


def episodes_of(world, task=TASK, camera=CAMERA):
    return Episodes(world, 0, Scene([world]), camera, task, TURTLEBOT2)


def drawn(world, count, seed=0, **settings):
    generator, episodes = np.random.default_rng(seed), episodes_of(world, **settings)
    return [episodes.draw(generator) for _ in range(count)]


def obstacle_view(world, pose, camera=CAMERA):
    """Least depth of the picture without its floor pixels, which are those of the same picture in an open world."""
    pictures = cast(Scene([world, make_world(walls="none")]), np.array([0, 1]), np.array([pose, pose]), camera)
    return pictures[0][pictures[0] < pictures[1]].min(initial=camera.max_range)


def test_heading_is_the_bearing_of_the_goal_from_the_front():
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, math.pi / 2], [1.0, 1.0, math.pi], [0.0, 0.0, -math.pi / 2]])
    goals = np.array([[0.0, 2.0], [0.0, 2.0], [2.0, 1.0], [-1.0, 0.0]])
    np.testing.assert_allclose(heading(poses, goals), [math.pi / 2, 0.0, math.pi, -math.pi / 2], atol=1e-12)


def test_heading_turns_a_complex_number_into_the_goals_direction():
    generator = np.random.default_rng(0)
    poses, goals = generator.uniform(-4, 4, (500, 3)), generator.uniform(-4, 4, (500, 2))
    pointing = np.exp(1j * (poses[:, 2] + heading(poses, goals)))
    offset = (goals[:, 0] - poses[:, 0]) + 1j * (goals[:, 1] - poses[:, 1])
    np.testing.assert_allclose(pointing, offset / abs(offset), atol=1e-12)
    assert (np.abs(heading(poses, goals)) <= math.pi).all()


def test_reward_is_that_of_the_thesis():
    speeds, headings = np.array([0.2, 0.4, 0.4, 0.4, 0.4]), np.array([0.0, 0.0, math.pi, math.pi / 3, 0.0])
    success = np.array([False, False, False, False, True])
    collision = np.array([False, True, False, False, True])
    expected = [0.2 * 0.2 - 0.01, -1.0, -0.4 * 0.2 - 0.01, 0.4 * 0.5 * 0.2 - 0.01, 1.0]
    result = rewards(TASK, speeds, headings, success, collision)
    assert result.dtype == np.float32
    np.testing.assert_allclose(result, expected, rtol=1e-6)


def test_every_term_of_the_reward_is_a_setting():
    task = Task(
        goal_reward=10.0,
        collision_reward=-5.0,
        progress_weight=5.0,
        step_penalty=0.1,
        length_penalty=0.25,
        control_period=0.2,
    )
    speeds = np.array([0.4, 0.4, 0.4, 0.2])
    result = rewards(task, speeds, np.zeros(4), np.array([1, 0, 0, 0], bool), np.array([0, 1, 0, 0], bool))
    np.testing.assert_allclose(result, [10.0, -5.0, 0.4 - 0.1 - 0.02, 0.2 - 0.1 - 0.01], rtol=1e-6)


@pytest.mark.parametrize(
    "setting",
    [
        {"goal_radius": 0.0},
        {"collision_depth": -0.1},
        {"goal_reward": math.nan},
        {"progress_weight": math.inf},
        {"control_period": 0.0},
        {"substep": -0.02},
        {"max_steps": 0},
        {"max_steps": 2.5},
        {"start_view": -1.0},
    ],
)
def test_impossible_rules_are_refused_by_name(setting):
    with pytest.raises(ValueError, match=next(iter(setting))):
        Task(**setting)


def test_a_camera_that_always_sees_the_floor_too_near_is_refused():
    TASK.check_camera(CAMERA)
    with pytest.raises(ValueError, match=r"floor 0\.23 m away"):
        TASK.check_camera(DepthCamera(mount_z=0.1))
    Task(collision_depth=0.0).check_camera(DepthCamera(mount_z=0.1))


def test_listed_pairs_are_drawn_evenly():
    world = make_world(
        starts=[{"at": [0, 0], "yaw_deg": 45}, {"at": [-2, 0], "yaw_deg": -90}], goals=[[3, 3], [3, -3], [2, 0]]
    )
    episodes = drawn(world, 1200)
    counts = np.zeros((2, 3))
    for episode in episodes:
        counts[episode.path[:2]] += 1
        np.testing.assert_array_equal(episode.pose[:2], world.starts[episode.path.start_index].at)
        assert episode.pose[2] == pytest.approx(math.radians(world.starts[episode.path.start_index].yaw_deg))
        np.testing.assert_array_equal(episode.goal, world.goals[episode.path.goal_index].at)
    assert abs(counts - 200).max() < 60  # 4.6 standard deviations


def test_a_path_that_is_asked_for_is_taken():
    world = make_world(starts=[[0, 0], [-2, 0]], goals=[[3, 3], [0.1, 0]])
    episode = episodes_of(world).draw(np.random.default_rng(0), Path(0, 1))
    assert episode.path == Path(0, 1, 0)
    np.testing.assert_array_equal([*episode.pose[:2], *episode.goal], [0, 0, 0.1, 0])


@pytest.mark.parametrize(
    ("path", "message"),
    [(Path(2, 0), "no start 2: it has starts 0 to 1"), (Path(0, -1), "no goal -1: it has goals 0 to 0")],
)
def test_a_path_that_does_not_exist_is_refused(path, message):
    world = make_world(starts=[[0, 0], [-2, 0]], goals=[[3, 3]])
    with pytest.raises(ValueError, match=message):
        episodes_of(world).draw(np.random.default_rng(0), path)


def test_a_listed_place_of_a_world_that_draws_them_is_refused():
    with pytest.raises(ValueError, match="no start 0: it has starts drawn at random, index -1"):
        episodes_of(make_world()).draw(np.random.default_rng(0), Path(0, -1))


def test_open_start_yaws_have_a_free_view_of_a_metre():
    world = make_world(
        {"box": {"at": [1.0, 0.0], "size": [0.4, 0.4], "height": 1.0}},
        {"box": {"at": [-0.8, 0.3], "size": [0.3, 0.3], "height": 0.1}},
        {"box": {"at": [0.0, -0.8], "size": [0.3, 0.3], "base": 0.4, "height": 0.1}},
        {"box": {"at": [0.0, 0.8], "size": [0.5, 0.1], "base": 0.9, "height": 0.1}},
        starts=[[0, 0]],
        goals=[[3, 3]],
    )
    poses = {tuple(episode.pose) for episode in drawn(world, 1000)}
    yaws = {yaw for _, _, yaw in poses}
    every_five_degrees = np.deg2rad(np.arange(-175, 181, 5))
    free = {yaw for yaw in every_five_degrees if obstacle_view(world, np.array([0.0, 0.0, yaw])) >= 1.0}
    assert 5 < len(free) < 60
    assert yaws == free


def test_a_start_without_any_free_view_faces_the_longest():
    posts = [
        {"cylinder": {"at": [0.8 * math.cos(angle), 0.8 * math.sin(angle)], "radius": 0.05, "height": 1.0}}
        for angle in np.deg2rad(np.arange(30, 360, 30))
    ]
    posts.append({"cylinder": {"at": [0.95, 0.0], "radius": 0.05, "height": 1.0}})
    world = make_world(*posts, starts=[[0, 0]], goals=[[3, 3]])
    yaws = {episode.pose[2] for episode in drawn(world, 30)}
    views = {yaw: obstacle_view(world, np.array([0.0, 0.0, yaw])) for yaw in np.deg2rad(np.arange(-175, 181, 5))}
    longest = max(views.values())
    assert longest < 1.0
    for yaw in yaws:
        assert views[min(views, key=lambda other: abs(other - yaw))] == pytest.approx(longest)


def test_pairs_that_would_end_at_once_are_not_drawn():
    world = make_world(
        {"box": {"at": [1.0, 0.0], "size": [1.0, 1.0], "height": 1.0}},
        starts=[
            {"at": [0.2, 0.0], "yaw_deg": 0},  # 0.39 m before the box, by the camera
            {"at": [-2.0, 0.0], "yaw_deg": 180},
        ],
        goals=[[-2.3, 0.0], [-2.0, 2.0]],  # the first within 0.5 m of the second start
    )
    assert {episode.path for episode in drawn(world, 50)} == {Path(1, 1)}


def test_pairs_that_end_at_once_are_drawn_where_there_is_nothing_else():
    world = make_world(starts=[{"at": [0, 0], "yaw_deg": 0}], goals=[[0.2, 0]])
    assert drawn(world, 1)[0].path == Path(0, 0)


def random_room(seed, **settings):
    generator = np.random.default_rng(seed)
    boxes = [
        {
            "box": {
                "at": generator.uniform(-3, 3, 2).tolist(),
                "size": generator.uniform(0.2, 1.0, 2).tolist(),
                "yaw_deg": float(generator.uniform(-90, 90)),
                "height": float(generator.uniform(0.1, 1.0)),
            }
        }
        for _ in range(16)
    ]
    return make_world(*boxes, **settings)


def free_space(world):
    """Where the robot's centre may be, by Shapely."""
    room = shapely.box(*-world.half_size, *world.half_size)
    standing = []
    for obstacle in world.obstacles:
        length, width = obstacle.size
        turned = shapely.affinity.rotate(shapely.box(-length / 2, -width / 2, length / 2, width / 2), obstacle.yaw_deg)
        standing.append(shapely.affinity.translate(turned, *obstacle.at))
    return room.difference(shapely.union_all(standing)), standing


@pytest.mark.parametrize("seed", range(4))
def test_random_episodes_have_room_and_a_way_to_go(seed):
    world = random_room(seed)
    room, standing = free_space(world)
    outline = shapely.union_all([room.exterior, *standing])
    parts = shapely.get_parts(room.buffer(-(TURTLEBOT2.radius - 1e-3), quad_segs=64))
    for episode in drawn(world, 60, seed):
        assert episode.path == Path(-1, -1)
        start, goal = shapely.Point(episode.pose[:2]), shapely.Point(episode.goal)
        assert start.distance(outline) >= TURTLEBOT2.radius + START_CLEARANCE - 1e-9
        assert goal.distance(outline) >= TURTLEBOT2.radius - 1e-9
        assert goal_distance(episode.pose, episode.goal) >= TASK.goal_radius
        assert any(part.covers(start) and part.covers(goal) for part in parts)
        assert obstacle_view(world, episode.pose) >= TASK.start_view


def test_a_random_goal_is_on_the_start_s_side_of_a_wall():
    divided = [{"box": {"at": [0, 0], "size": [0.2, 7.0], "height": 1.0}}]
    both = drawn(make_world(*divided), 40)
    assert all(episode.pose[0] * episode.goal[0] > 0 for episode in both)
    assert len({episode.pose[0] > 0 for episode in both}) == 2
    listed_goal = drawn(make_world(*divided, goals=[[2, 0]]), 40)
    assert all(episode.pose[0] > 0 and episode.path == Path(-1, 0) for episode in listed_goal)
    listed_start = drawn(make_world(*divided, starts=[[-2, 0]]), 40)
    assert all(episode.goal[0] < 0 and episode.path == Path(0, -1) for episode in listed_start)


def test_random_places_fill_the_room():
    episodes = drawn(make_world(), 400)
    for places in (
        np.array([episode.pose[:2] for episode in episodes]),
        np.array([episode.goal for episode in episodes]),
    ):
        assert (np.histogram2d(*places.T, bins=3, range=[[-3.5, 3.5]] * 2)[0] > 15).all()


def test_a_closet_of_a_large_building_is_found():
    """A free floor of 1.65 m in one of 60 m, which two thousand places at random often miss."""
    closet = [
        {"box": {"at": at, "size": size, "height": 1.0}}
        for at, size in (
            ((0, 1.05), (2.2, 0.1)),
            ((0, -1.05), (2.2, 0.1)),
            ((1.05, 0), (0.1, 2)),
            ((-1.05, 0), (0.1, 2)),
        )
    ]
    for settings in ({"starts": [[0.5, 0.5]]}, {"goals": [[0.5, 0.5]]}):
        for episode in drawn(make_world(*closet, size=(60, 60), **settings), 10):
            assert max(np.abs([*episode.pose[:2], *episode.goal])) < 1.0 - TURTLEBOT2.radius


def test_a_world_without_room_says_so():
    with pytest.raises(ValueError, match="no room for an episode"):
        drawn(make_world(), 1, task=Task(goal_radius=20.0))


def test_a_random_start_may_stand_under_what_is_above_the_robot():
    world = make_world({"box": {"at": [0, 0], "size": [7, 7], "base": 1.2, "height": 0.03}})
    assert len(drawn(world, 20)) == 20


def test_places_on_an_open_floor_are_connected_as_ways_are_planned():
    """A barrier longer than the rim around the floor is wide: no way leads around it."""
    world = make_world(
        {"box": {"at": [0.0, 0.0], "size": [0.2, 10.0], "height": 1.0}},
        size=(4.0, 4.0),
        walls="none",
        starts="random",
        goals="random",
    )
    ends = [(episode.pose[:2], episode.goal) for episode in drawn(world, 24)]
    assert all(np.isfinite(shortest_path_length(world, start, goal)) for start, goal in ends)
    assert {bool(start[0] > 0.0) for start, _ in ends} == {False, True}


def test_a_start_that_is_never_wholly_free_is_not_looked_at_for_long(monkeypatch):
    motion = {"path": [[0.9, -0.2], [0.9, 0.2]], "speed": 0.5}
    pacing = {"cylinder": {"at": [0.9, -0.2], "radius": 0.2, "height": 1.7, "motion": motion}}
    world = make_world(pacing, starts=[{"at": [0.0, 0.0], "yaw_deg": 0}], goals=[[3.0, 3.0]])
    episodes, looks = Episodes(world, 0, Scene([world.fixed_prisms]), CAMERA, TASK, TURTLEBOT2), []
    views = episodes._views
    monkeypatch.setattr(episodes, "_views", lambda *arguments: looks.append(1) or views(*arguments))
    episode = episodes.draw(np.random.default_rng(0))
    assert len(looks) < 100
    assert views(episode.pose[None], episode.phases)[0] >= TASK.collision_depth


def test_a_camera_that_sees_no_further_than_the_depth_rule_is_told_by_its_range():
    with pytest.raises(ValueError, match=r"sees no further than its max_range of 0.45 m"):
        Task(collision_depth=0.5).check_camera(DepthCamera(max_range=0.45))


SCANNER = DepthCamera(
    width=181,
    height=1,
    horizontal_fov_deg=170,
    vertical_fov_deg=1.0,
    depth="range",
    blind_zone=0.0,
    mount_x=0.0,
    mount_z=0.2,
)


@pytest.mark.parametrize("camera", [SCANNER, DepthCamera(depth="range", width=20, height=16, vertical_fov_deg=70)])
def test_views_are_what_a_range_camera_measures(camera):
    """At 85 degrees off the axis, a wall 1 m away to the side has a planar depth of 9 cm."""
    world = load_world("complex_train")
    generator = np.random.default_rng(0)
    scene, index = Scene([world, make_world(walls="none")]), np.zeros(60, dtype=np.intp)
    poses = np.column_stack([generator.uniform(-3.2, 3.2, (60, 2)), generator.uniform(-math.pi, math.pi, 60)])
    pictures, floors = cast(scene, index, poses, camera), cast(scene, index + 1, poses, camera)
    ranges = np.where(pictures < floors, pictures * camera.ray_lengths, np.inf).min(axis=(1, 2))
    np.testing.assert_array_equal(nearest_depth(scene, index, poses, camera, 0.8), np.minimum(ranges, np.float32(0.8)))
    assert ((ranges > 0.2) & (ranges < 0.8)).sum() > 10


def test_a_scanner_finds_random_places_where_a_camera_does():
    world = load_world("complex_train").replace(starts="random", goals="random")
    for episode in drawn(world, 5, camera=SCANNER):
        picture = SCANNER.from_planar(cast(Scene([world]), np.array([0]), episode.pose[None], SCANNER))
        assert picture.min() >= TASK.start_view


def test_places_are_found_in_a_large_room_of_which_little_is_free():
    world = make_world({"box": {"at": [-0.5, 0], "size": [99, 100], "height": 1}}, size=(100, 100))
    for episode in drawn(world, 30):
        assert episode.pose[0] > 49 + TURTLEBOT2.radius
        assert episode.goal[0] > 49 + TURTLEBOT2.radius

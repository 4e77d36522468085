"""What is legal in a world but odd: things that an author rarely means.

Each function looks for one oddity and words it as a :class:`navsim.errors.Problem`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely

from navsim.camera import DepthCamera
from navsim.errors import Problem, key_path
from navsim.passages import Passage, narrowest_passages
from navsim.planner import shortest_path_length
from navsim.raycast import Scene, render_depth
from navsim.robot import ACTIONS, TURTLEBOT2, Robot
from navsim.task import Episodes, NoFreeMomentError, Path, Task
from navsim.world import Cylinder, Obstacle, Polygon, World

REACHING_OUT = 1e-3
"""Metres that an obstacle may reach beyond the room without a remark."""
SAME_PLACE = 1e-6
"""Metres within which an outline that touches another one counts as inside it."""
MOST_PATHS = 400
"""Pairs of a start and a goal whose ways are worked out: each takes milliseconds in a furnished room."""
_MANY = 2_000  # obstacles
_AS_EXACT = 5e-4  # radians: angles that are written with three digits and more
_VIEWS = np.deg2rad(np.arange(-175.0, 181.0, 5.0))


@dataclass(frozen=True)
class Equipment:
    """Who is to drive in a world, what it sees with, and by which rules."""

    robot: Robot = TURTLEBOT2
    camera: DepthCamera = field(default_factory=DepthCamera)
    task: Task = field(default_factory=Task)

    def episodes(self, world: World) -> Episodes:
        """How episodes in ``world`` begin."""
        return Episodes(world, 0, Scene([world.fixed_prisms]), self.camera, self.task, self.robot)

    @cached_property
    def narrow(self) -> float:
        """Width of a passage under which the depth rule is likely to end an episode in it, metres."""
        return 2.0 * max(self.task.collision_depth, self.robot.radius)

    @cached_property
    def highest_seen(self) -> float:
        """Height above which the camera sees nothing within its range, metres."""
        return self.camera.mount_z + self.camera.max_range * max(0.0, float(self.camera.row_climbs.max()))


def outlines(obstacles: Sequence[Obstacle]) -> list[shapely.Polygon]:
    """The footprints of obstacles, metres; a cylinder's has 256 corners, or 32 where there are very many obstacles."""
    quad_segs = 64 if len(obstacles) <= _MANY else 8
    return [_outline(obstacle, quad_segs) for obstacle in obstacles]


def _outline(obstacle: Obstacle, quad_segs: int) -> shapely.Polygon:
    if isinstance(obstacle, Cylinder):
        return shapely.Point(obstacle.at).buffer(obstacle.radius, quad_segs=quad_segs)
    if isinstance(obstacle, Polygon):
        return shapely.Polygon(obstacle.points)
    return shapely.Polygon(obstacle.footprints()[0][0])


def oddities(world: World, equipment: Equipment | None = None) -> list[Problem]:
    """Everything odd about ``world``, which keeps the rules."""
    equipment = equipment or Equipment()
    return [
        *_same_names(world),
        *_reaching_out(world),
        *_inside_others(world),
        *_out_of_sight(world, equipment),
        *_radians(world),
        *_reached_at_once(world, equipment.task),
        *_out_of_reach(world, equipment),
        *ended_at_once(world, equipment),
        *_never_free(world, equipment),
        *_narrow_ways(world, equipment),
    ]


def passages_of(world: World, robot: Robot = TURTLEBOT2) -> list[list[Passage]]:
    """The narrowest passage of each path, a row for each start; empty where starts or goals are random.

    They are worked out once for each world.
    """
    if isinstance(world.starts, str) or isinstance(world.goals, str):
        return []
    key = (narrowest_passages, robot.height)
    if key not in world.derived:
        starts = np.array([start.at for start in world.starts])
        goals = np.array([goal.at for goal in world.goals])
        world.derived[key] = narrowest_passages(world, starts, goals, robot.height)
    return world.derived[key]


def way_length(world: World, start: int, goal: int, equipment: Equipment) -> float:
    """The shortest way from a listed start to where a listed goal is reached, metres; worked out once a world."""
    robot, goal_radius = equipment.robot, equipment.task.goal_radius
    known = world.derived.setdefault((way_length, robot.radius, robot.height, goal_radius), {})
    if (start, goal) not in known:
        known[start, goal] = shortest_path_length(
            world,
            world.starts[start].at,  # type: ignore[union-attr]
            world.goals[goal].at,  # type: ignore[union-attr]
            robot.radius,
            robot.height,
            goal_radius,
        )
    return known[start, goal]


def _same_names(world: World) -> Iterator[Problem]:
    first: dict[str, int] = {}
    for i, obstacle in enumerate(world.obstacles):
        before = first.setdefault(obstacle.name, i)
        if before != i:
            text = (
                f"'{obstacle.name}' is also the name of {key_path(('obstacles', before))}; give each a name of its own"
            )
            yield Problem(("obstacles", i, obstacle.kind, "name"), text)


def _reaching_out(world: World) -> Iterator[Problem]:
    for i, obstacle in enumerate(world.obstacles):
        pieces = obstacle.footprints()
        reach = max(float((np.abs(vertices) + radius - world.half_size).max()) for vertices, radius in pieces)
        if reach > REACHING_OUT:
            text = f"reaches {reach:.3g} m beyond the room; move it in or enlarge 'size'"
            yield Problem(("obstacles", i, obstacle.kind), text, at_key=True)


def _inside_others(world: World) -> Iterator[Problem]:
    standing = [i for i, one in enumerate(world.obstacles) if one.motion is None and one.pushable is None]
    footprints = outlines([world.obstacles[i] for i in standing])
    if len(footprints) < 2:
        return
    areas = shapely.area(footprints)
    tree = shapely.STRtree(footprints)
    shrunk = shapely.buffer(footprints, -SAME_PLACE, join_style="mitre")
    holders: dict[int, int] = {}
    for inner, outer in tree.query(shrunk, predicate="within").T.tolist():
        if inner == outer or inner in holders:
            continue
        a, b = world.obstacles[standing[inner]], world.obstacles[standing[outer]]
        is_within = b.base <= a.base + SAME_PLACE and a.top <= b.top + SAME_PLACE
        is_same = is_within and a.base <= b.base + SAME_PLACE and b.top <= a.top + SAME_PLACE
        if is_within and not (is_same and inner < outer and abs(areas[inner] - areas[outer]) < SAME_PLACE):
            holders[inner] = outer
    for inner, outer in sorted(holders.items()):
        i, other = standing[inner], world.obstacles[standing[outer]]
        text = f"is wholly inside '{other.name}' and changes nothing; move it or leave it out"
        yield Problem(("obstacles", i, world.obstacles[i].kind), text, at_key=True)


def _out_of_sight(world: World, equipment: Equipment) -> Iterator[Problem]:
    unseen = max(equipment.highest_seen, equipment.robot.height)
    for i, obstacle in enumerate(world.obstacles):
        if obstacle.base >= unseen:
            text = (
                f"hangs at {obstacle.base:g} m, above the robot and above all that its camera sees "
                f"({unseen:.3g} m at most); it changes nothing"
            )
            yield Problem(("obstacles", i, obstacle.kind, "base"), text)


def _radians(world: World) -> Iterator[Problem]:
    """Angles that are eighths of a turn, if they are not meant in degrees."""
    starts = () if isinstance(world.starts, str) else world.starts
    placed = [
        (("obstacles", i, one.kind, "yaw_deg"), getattr(one, "yaw_deg", 0.0)) for i, one in enumerate(world.obstacles)
    ]
    for where, yaw in [*placed, *((("starts", i, "yaw_deg"), one.yaw_deg or 0.0) for i, one in enumerate(starts))]:
        eighths = round(yaw / (math.pi / 4.0))
        if eighths and abs(yaw - eighths * math.pi / 4.0) < _AS_EXACT and abs(yaw) <= math.tau:
            text = f"{yaw:g} is {45 * eighths} degrees in radians, and degrees are meant here; write {45 * eighths}?"
            yield Problem(where, text)


def _out_of_reach(world: World, equipment: Equipment) -> Iterator[Problem]:
    """Goals to which the way is longer than the robot can drive in an episode."""
    if isinstance(world.starts, str) or isinstance(world.goals, str):
        return
    task = equipment.task
    reach = max(action.linear or 0.0 for action in ACTIONS) * task.control_period * task.max_steps
    exact = set(world.paths[:MOST_PATHS])
    for j, goal in enumerate(world.goals):
        far = []
        for i, start in enumerate(world.starts):
            length = math.dist(start.at, goal.at) - task.goal_radius
            if length <= reach and (i, j) in exact:
                way = way_length(world, i, j, equipment)
                length = way if math.isfinite(way) else length  # that there is none is told elsewhere
            if length > reach:
                far.append((i, length))
        if far:
            (i, length), *more = far
            others = f" (and {len(more)} more)" if more else ""
            text = (
                f"is {length:.4g} m from {key_path(('starts', i))}{others} by the shortest way: the robot drives "
                f"{reach:g} m in the {task.max_steps} steps of an episode; move one of them, or allow more "
                "(--task.max-steps)"
            )
            yield Problem(("goals", j), text)


def _reached_at_once(world: World, task: Task) -> Iterator[Problem]:
    if isinstance(world.starts, str) or isinstance(world.goals, str):
        return
    for j, goal in enumerate(world.goals):
        for i, start in enumerate(world.starts):
            distance = math.dist(start.at, goal.at)
            if distance < task.goal_radius:
                text = (
                    f"is {distance:.2g} m from {key_path(('starts', i))}: nearer than {task.goal_radius:g} m counts as "
                    "reached, so the episode ends with its first step; move one of them"
                )
                yield Problem(("goals", j), text)


def ended_at_once(world: World, equipment: Equipment) -> Iterator[Problem]:
    """Starts where the robot sees something nearer than the depth rule allows before it has moved.

    What moves does not count: an episode begins when it is away.
    """
    limit = equipment.task.collision_depth
    if isinstance(world.starts, str) or limit <= 0.0:
        return
    standing = world.model_copy(update={"obstacles": tuple(one for one in world.obstacles if one.motion is None)})
    for i, start in enumerate(world.starts):
        yaws = _VIEWS if start.yaw_deg is None else np.deg2rad([start.yaw_deg])
        poses = np.column_stack([np.tile(start.at, (len(yaws), 1)), yaws])
        images = equipment.camera.from_planar(render_depth(standing, poses, equipment.camera))
        nearest = images.min(axis=(1, 2))
        if nearest.max() >= limit:
            continue
        ahead = "whichever way it faces" if start.yaw_deg is None else f"facing {start.yaw_deg:g}°"
        remedy = "move it" if start.yaw_deg is None else "turn or move it"
        text = (
            f"{ahead}, the robot sees something {nearest.max():.2g} m away: the depth rule ({limit:g} m) ends the "
            f"episode with its first step; {remedy}"
        )
        yield Problem(("starts", i), text)


def _never_free(world: World, equipment: Equipment) -> Iterator[Problem]:
    """Starts at which no episode can begin for what moves."""
    if isinstance(world.starts, str) or all(one.motion is None for one in world.obstacles):
        return
    episodes = equipment.episodes(world)
    for i in range(len(world.starts)):
        try:
            episodes.draw(np.random.default_rng(0), Path(i, -1 if isinstance(world.goals, str) else 0))
        except NoFreeMomentError:
            text = "no episode can begin here: an obstacle that moves is there, or in something pushable, at all times"
            yield Problem(("starts", i), f"{text}; move the start, or the obstacle's path")
        except ValueError as error:
            yield Problem(("starts", i), str(error))


def _narrow_ways(world: World, equipment: Equipment) -> Iterator[Problem]:
    if isinstance(world.goals, str):
        return
    narrow: dict[tuple[int, Passage], list[int]] = {}
    for i, row in enumerate(passages_of(world, equipment.robot)):
        for j, passage in enumerate(row):
            if passage.width < equipment.narrow - REACHING_OUT:
                narrow.setdefault((j, passage), []).append(i)
    for (j, passage), starts in narrow.items():
        every = len(starts) == len(world.starts)
        who = "every start" if every and len(starts) > 1 else " and ".join(key_path(("starts", i)) for i in starts)
        left, right = passage.sides
        between = f"between '{left}' and '{right}'" if left != right else f"within '{left}'"
        width = 2.0 * equipment.robot.radius
        need = f"fits, but with the depth rule it needs {equipment.narrow:.2g} m to be safe"
        text = (
            f"the widest way from {who} leads through a gap of {passage.width:.2f} m {between}: the robot "
            f"({width:.2f} m wide) {need if width <= passage.width else 'does not fit'}"
        )
        yield Problem(("goals", j), text)

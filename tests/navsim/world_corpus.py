"""World files to hold the schema against the loader: right ones, and ones that are wrong in each way there is."""

from __future__ import annotations

ROOM = "format: 1\nsize: [7.0, 7.0]\n"

RICH = (
    ROOM
    + """\
name: everything
walls: {height: 1.5, thickness: 0.2}
obstacles:
  - box: {name: chest, at: [1.0, -0.5], size: [0.6, 0.4], height: 0.8, base: 0.1, yaw_deg: 30}
  - cylinder: {at: [-1, 1.2], radius: 0.15, height: 3e-1}
  - polygon: {name: wedge, points: [[-3, -3], [-2, -3], [-2.5, -2.5]], height: 1}
  - cylinder: {at: [3, 1], radius: 0.2, height: 1.7, motion: {path: [[3, 1], [3, -1]], speed: 0.5, repeat: circuit}}
  - box: {at: [0.5, 2.5], size: [1, 0.05], height: 2, motion: {hinge: [0, 2.5], swing_deg: [0, 60], speed_deg: 45}}
  - cylinder: {at: [0, -1.5], radius: 0.06, height: 0.12, pushable: {mass: 0.35, friction: 0.2}}
starts:
  - {at: [-2, 0], yaw_deg: 90}
  - {at: [-2, -1]}
  - [2.0, 2.0]
goals:
  - [2.0, -2.5]
  - {at: [-3, 3]}
"""
)

RIGHT = {
    "rich": RICH,
    "least": ROOM,
    "format as a float": "format: 1.0\nsize: [7, 7]\n",
    "no walls": ROOM + "walls: none\n",
    "null walls": ROOM + "walls: ~\n",
    "walls by default": ROOM + "walls: {}\n",
    "no obstacles": ROOM + "obstacles: []\n",
    "random": ROOM + "starts: random\ngoals: random\n",
    "random goals": ROOM + "starts: [[0, 0]]\ngoals: random\n",
    "empty name of an obstacle": ROOM + "obstacles: [{box: {name: '', at: [1, 1], size: [1, 1], height: 1}}]\n",
    "drawn yaw": ROOM + "starts: [{at: [0, 0], yaw_deg: ~}]\n",
    "still": ROOM + "obstacles: [{box: {at: [1, 1], size: [1, 1], height: 1, motion: ~, pushable: ~}}]\n",
    "json": '{"format": 1, "size": [7, 7], "obstacles": [{"cylinder": {"at": [1, 1], "radius": 1, "height": 1}}]}',
    "least length": ROOM + "obstacles: [{box: {at: [1, 1], size: [1e-6, 1], height: 1}}]\n",
    "full turns": ROOM + "starts: [{at: [0, 0], yaw_deg: -360}, {at: [1, 0], yaw_deg: 360}]\n",
    "aliases": ROOM + "obstacles: [{cylinder: &p {at: [1, 1], radius: 0.1, height: 1}}, {cylinder: *p}]\n",
}


def _box(**settings: str) -> str:
    settings = {"at": "[1, 1]", "size": "[1, 1]", "height": "1", **settings}
    return ROOM + "obstacles: [{box: {" + ", ".join(f"{key}: {value}" for key, value in settings.items()) + "}}]\n"


WRONG_STRUCTURE = {
    "a list": "- format: 1\n",
    "a word": "world\n",
    "no format": "size: [7, 7]\n",
    "no size": "format: 1\n",
    "format 2": "format: 2\nsize: [7, 7]\n",
    "format '1'": "format: '1'\nsize: [7, 7]\n",
    "format true": "format: true\nsize: [7, 7]\n",
    "one size": "format: 1\nsize: 7\n",
    "three sizes": "format: 1\nsize: [7, 7, 7]\n",
    "size of words": "format: 1\nsize: ['7', '7']\n",
    "no room": "format: 1\nsize: [7, 0]\n",
    "unknown key": ROOM + "gravity: 9.81\n",
    "misspelt key": ROOM + "wals: none\n",
    "name that is a number": ROOM + "name: 5\n",
    "empty name": ROOM + "name: ''\n",
    "null name": ROOM + "name: ~\n",
    "low walls": ROOM + "walls: low\n",
    "walls as a list": ROOM + "walls: [1, 2]\n",
    "walls of no height": ROOM + "walls: {height: 0}\n",
    "unknown key of walls": ROOM + "walls: {hight: 1}\n",
    "obstacles as a mapping": ROOM + "obstacles: {box: {}}\n",
    "null obstacles": ROOM + "obstacles: ~\n",
    "a word for an obstacle": ROOM + "obstacles: [box]\n",
    "an empty obstacle": ROOM + "obstacles: [{}]\n",
    "a sphere": ROOM + "obstacles: [{sphere: {at: [0, 0], radius: 1}}]\n",
    "two shapes": ROOM + "obstacles: [{box: {at: [1, 1], size: [1, 1], height: 1}, polygon: {}}]\n",
    "settings beside a shape": ROOM + "obstacles: [{box: {}, at: [1, 1]}]\n",
    "a null box": ROOM + "obstacles: [{box: ~}]\n",
    "a box without a height": ROOM + "obstacles: [{box: {at: [1, 1], size: [1, 1]}}]\n",
    "a cylinder without a radius": ROOM + "obstacles: [{cylinder: {at: [1, 1], height: 1}}]\n",
    "a cylinder with a size": ROOM + "obstacles: [{cylinder: {at: [1, 1], size: [1, 1], radius: 1, height: 1}}]\n",
    "a box with a radius": _box(radius="1"),
    "two points": ROOM + "obstacles: [{polygon: {points: [[0, 0], [1, 0]], height: 1}}]\n",
    "points of three": ROOM + "obstacles: [{polygon: {points: [[0, 0, 0], [1, 0, 0], [0, 1, 0]], height: 1}}]\n",
    "a height of 0": _box(height="0"),
    "a height below 0": _box(height="-1"),
    "a height too small": _box(height="1e-7"),
    "a height too great": _box(height="20000"),
    "a height in words": _box(height="tall"),
    "a height in quotes": _box(height="'1'"),
    "true height": _box(height="true"),
    "null height": _box(height="~"),
    "a list of heights": _box(height="[1]"),
    "a base below 0": _box(base="-0.1"),
    "null base": _box(base="~"),
    "a far place": _box(at="[1e5, 0]"),
    "one coordinate": _box(at="[1]"),
    "more than a turn": _box(yaw_deg="361"),
    "a name that is a list": _box(name="[a]"),
    "motion without a path": _box(motion="{speed: 1}"),
    "motion of one point": _box(motion="{path: [[1, 1]], speed: 1}"),
    "motion at rest": _box(motion="{path: [[1, 1], [2, 2]], speed: 0}"),
    "motion too fast": _box(motion="{path: [[1, 1], [2, 2]], speed: 11}"),
    "motion to and fro": _box(motion="{path: [[1, 1], [2, 2]], speed: 1, repeat: to-and-fro}"),
    "motion both ways": _box(motion="{path: [[1, 1], [2, 2]], speed: 1, hinge: [1, 1]}"),
    "motion as a word": _box(motion="fast"),
    "a hinge without a swing": _box(motion="{hinge: [1, 1], speed_deg: 3}"),
    "pushable without a mass": _box(pushable="{}"),
    "pushable without weight": _box(pushable="{mass: 0}"),
    "pushable of no friction below 0": _box(pushable="{mass: 1, friction: -1}"),
    "true pushable": _box(pushable="true"),
    "starts anywhere": ROOM + "starts: anywhere\n",
    "no starts": ROOM + "starts: []\n",
    "null starts": ROOM + "starts: ~\n",
    "one start": ROOM + "starts: {at: [0, 0]}\n",
    "a start in words": ROOM + "starts: [near]\n",
    "a start in three dimensions": ROOM + "starts: [[0, 0, 0]]\n",
    "a start without a place": ROOM + "starts: [{yaw_deg: 3}]\n",
    "a goal with a yaw": ROOM + "goals: [{at: [0, 0], yaw_deg: 3}]\n",
    "a goal of words": ROOM + "goals: [['0', '0']]\n",
    "no goals": ROOM + "goals: []\n",
}
"""What both the schema and the loader refuse."""

WRONG_GEOMETRY = {
    "outside": _box(at="[9, 0]"),
    "a start outside": ROOM + "starts: [[9, 0]]\n",
    "a start at a wall": ROOM + "starts: [[3.4, 0]]\n",
    "a goal in a box": _box() + "goals: [[1, 1]]\n",
    "a circuit that ends where it begins": ROOM
    + "obstacles: [{cylinder: {at: [0, 0], radius: 0.1, height: 1, motion: {path: [[0, 0], [1, 0], [1, 1], [0, 0]], "
    + "speed: 1, repeat: circuit}}}]\n",
    "cut off": ROOM
    + "obstacles: [{box: {at: [0, 0], size: [0.1, 7], height: 1}}]\nstarts: [[-1, 0]]\ngoals: [[1, 0]]\n",
    "no room": "format: 1\nsize: [0.3, 0.3]\n",
    "crossing": ROOM + "obstacles: [{polygon: {points: [[0, 0], [1, 1], [1, 0], [0, 1]], height: 1}}]\n",
    "a point twice": ROOM + "obstacles: [{polygon: {points: [[0, 0], [1, 1], [1, 1], [0, 1]], height: 1}}]\n",
    "flat": ROOM + "obstacles: [{polygon: {points: [[0, 0], [1, 0], [0.5, 1e-13]], height: 1}}]\n",
    "a path that stays": _box(motion="{path: [[1, 1], [1, 1]], speed: 1}"),
    "a swing that stays": _box(motion="{hinge: [1, 1], swing_deg: [4, 4], speed_deg: 1}"),
    "a path out of the room": _box(motion="{path: [[1, 1], [8, 1]], speed: 1}"),
}
"""What the loader refuses, and no schema can: ``navsim.schema.BEYOND_THE_SCHEMA``."""

WRONG_YAML = {
    "a key twice": ROOM + "name: a\nname: b\n",
    "no value": ROOM + "walls:\n",
    "a tag": ROOM + "name: !!python/name:os.system x\n",
    "no such alias": ROOM + "name: *other\n",
    "a bracket too few": ROOM + "goals: [[1, 2]\n",
    "nan": _box(height=".nan"),
}
"""What is lost or refused before there is anything to hold against a schema."""

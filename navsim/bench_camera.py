"""How many depth images a second the ray-caster renders, beside other renderers of the same scene.

All renderers run in one process, on one thread, in turns, on the same poses; medians of processor time are compared, so
that a busy machine changes them little. Every turn begins with an untimed batch and then lasts about as long, so that
what is fast does not spend its turn on caches that others left cold. A peer is used as a careful user would: its scene
is built once, its images come in as few calls as it allows, colours and shadows are left out where it can leave them
out.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.ndimage import maximum_filter, minimum_filter

from navsim.camera import DepthCamera
from navsim.prism import Prism
from navsim.raycast import Scene, cast, nearest_depth
from navsim.world import Box, Cylinder, World
from navsim.worldfile import load_world

SIZES = ((80, 64), (160, 128))
"""Images that are measured, columns and rows."""
WORLDS = ("complex_train", "complex_eval")
"""Shipped worlds that are measured, beside generated rooms."""
_BATCHES = 4  # of poses, all of which a renderer renders when its turn comes, again and again
_TURN = 0.05  # seconds that a turn lasts at least
_SEGMENTS = 32  # of a mesh's cylinder
_AGREEMENT = 0.02  # metres, about one count of a network's image


@dataclass(frozen=True)
class Renderer:
    """Something that renders depth images of one world."""

    name: str
    camera: DepthCamera
    """What it renders; a peer that knows square pixels only differs from what was asked for."""
    render: Callable[[np.ndarray], np.ndarray]
    """From poses ``(N, 3)`` to planar depth ``(N, H, W)``, metres."""


class Row(NamedTuple):
    """One renderer in one world at one size."""

    world: str
    width: int
    height: int
    renderer: str
    images_per_second: float
    """In the median round; NaN where the renderer is not installed."""
    times_slower: float
    """Than the ray-caster."""
    agreement: float
    """Share of pixels within 2 cm of what the ray-caster sees within a pixel; rasterisers sample beside its centre."""
    missing: str = ""
    """Why there are no figures."""


class Scaling(NamedTuple):
    """The cost of an image in a small and in a large world of the same density."""

    small_ms: float
    """Median milliseconds an image in a room of 7x7 m."""
    large_ms: float
    """In a hall of 100x100 m with 10,000 obstacles."""

    @property
    def ratio(self) -> float:
        return self.large_ms / self.small_ms


def generated_room(rng: np.random.Generator, num_obstacles: int = 24, size: float = 7.0) -> World:
    """A room with large and small boxes and cylinders, a third of them lower than the camera or off the floor."""
    places = rng.uniform(-0.5 * size + 0.3, 0.5 * size - 0.3, (num_obstacles, 2))
    obstacles: list[dict[str, Any]] = []
    for number, at in enumerate(places.tolist()):
        kind = number % 6
        height, base = rng.uniform(0.5, 1.5), 0.0
        if kind == 4:
            height = rng.uniform(0.05, 0.25)
        elif kind == 5:
            height, base = rng.uniform(0.03, 0.2), rng.uniform(0.3, 0.8)
        if kind in (1, 4):
            shape = {"at": at, "radius": rng.uniform(0.05, 0.25), "height": height, "base": base}
            obstacles.append({"cylinder": shape})
        else:
            sides = rng.uniform(0.15, 0.6, 2).tolist()
            shape = {"at": at, "size": sides, "height": height, "base": base, "yaw_deg": rng.uniform(-90.0, 90.0)}
            obstacles.append({"box": shape})
    return World.from_dict({"format": 1, "name": "generated room", "size": [size, size], "obstacles": obstacles})


def free_poses(rng: np.random.Generator, world: World, count: int) -> np.ndarray:
    """``(count, 3)`` poses all over the room from which the camera sees nothing nearer than 0.4 m, as a robot does."""
    scene, camera = Scene([world]), DepthCamera()
    found = np.zeros((0, 3))
    while len(found) < count:
        poses = np.concatenate(
            [
                rng.uniform(-world.half_size + 0.2, world.half_size - 0.2, (2 * count, 2)),
                rng.uniform(-math.pi, math.pi, (2 * count, 1)),
            ],
            axis=1,
        )
        free = nearest_depth(scene, np.zeros(len(poses), dtype=np.intp), poses, camera, within=0.4) >= 0.4
        found = np.concatenate([found, poses[free]])
    return found[:count]


def benchmark_camera(
    width: int = 80,
    height: int = 64,
    num_robots: int = 16,
    *,
    peers: bool = False,
    repeats: int = 11,
    worlds: Sequence[str] = WORLDS,
) -> list[Row]:
    """Measures images a second of one size, in generated rooms of 24 obstacles and in ``worlds``.

    Args:
        width, height: of an image, pixels.
        num_robots: images in one call.
        peers: whether to measure the peers that are installed as well.
        repeats: rounds, in each of which every renderer has its turn with the same four times ``num_robots`` poses.
        worlds: names of shipped worlds, or world files.

    Raises:
        WorldError: for a world file that cannot be used.
    """
    rng = np.random.default_rng(0)
    rows = []
    for world in [generated_room(rng), *map(load_world, worlds)]:
        poses = free_poses(rng, world, _BATCHES * num_robots).reshape(_BATCHES, num_robots, 3)
        rows += _compare(world, DepthCamera(width=width, height=height), poses, peers, repeats)
    return rows


def benchmark_scaling(num_robots: int = 16, repeats: int = 21) -> Scaling:
    """Measures 80x64 images in a room of 7x7 m and in a hall of 100x100 m, one obstacle a square metre in both."""
    rng = np.random.default_rng(0)
    casts = []
    for size in (7.0, 100.0):
        world = generated_room(rng, num_obstacles=round(size**2), size=size)
        poses = free_poses(rng, world, _BATCHES * num_robots).reshape(_BATCHES, num_robots, 3)
        casts.append((_ray_caster(world, DepthCamera()).render, poses))
    times: list[list[float]] = [[], []]
    for _ in range(repeats):
        for (render, poses), spent in zip(casts, times, strict=True):
            spent.append(_seconds(render, poses))
    small, large = (statistics.median(spent) / (_BATCHES * num_robots) * 1e3 for spent in times)
    return Scaling(small, large)


def run(
    *,
    sizes: Sequence[tuple[int, int]] = SIZES,
    num_robots: int = 16,
    peers: bool = False,
    repeats: int = 11,
    worlds: Sequence[str] = WORLDS,
    console: Console | None = None,
) -> None:
    """Prints what ``benchmark_camera`` and ``benchmark_scaling`` measure.

    Raises:
        WorldError: for a world file that cannot be used.
    """
    console = console or Console()
    missing: dict[str, str] = {}
    for width, height in sizes:
        rows = benchmark_camera(width, height, num_robots, peers=peers, repeats=repeats, worlds=worlds)
        table = Table(
            title=f"Depth images of {width}x{height}, {num_robots} a call, one thread, processor time",
            title_justify="left",
        )
        table.add_column("world")
        table.add_column("renderer", no_wrap=True)
        table.add_column("images/s", justify="right")
        table.add_column("slower", justify="right")
        table.add_column("agrees", justify="right")
        world = None
        for row in rows:
            if row.world != world:
                table.add_section()
            name, world = "" if row.world == world else row.world, row.world
            if row.missing:
                table.add_row(name, row.renderer, "none", "", "")
                missing[row.renderer] = row.missing
                continue
            speed, slower = f"{row.images_per_second:,.0f}", f"{row.times_slower:.1f}x"
            table.add_row(name, row.renderer, speed, slower, f"{row.agreement:.2%}")
        console.print(table)
    for renderer, why in missing.items():
        console.print(f"{renderer} was left out: {why}", markup=False)
    scaling = benchmark_scaling(num_robots)
    console.print(
        f"80x64 in a room of 7x7 m with 49 obstacles: {1e3 * scaling.small_ms:.0f} µs an image; in a hall of 100x100 m "
        f"with 10,000: {1e3 * scaling.large_ms:.0f} µs, {scaling.ratio:.2f} times as much"
    )


def _seconds(render: Callable[[np.ndarray], np.ndarray], batches: np.ndarray) -> float:
    """Processor time of one pass over ``batches``, the mean of a turn's."""
    render(batches[0])
    start, passes, spent = time.process_time(), 0, 0.0
    while spent < _TURN:
        for poses in batches:
            render(poses)
        passes, spent = passes + 1, time.process_time() - start
    return spent / passes


def _compare(world: World, camera: DepthCamera, poses: np.ndarray, peers: bool, repeats: int) -> list[Row]:
    """One row for the ray-caster and one for each peer; ``poses`` is ``(batches, N, 3)``."""
    renderers, missing = [_ray_caster(world, camera)], {}
    for name, make in _PEERS.items() if peers else ():
        try:
            renderers.append(Renderer(name, *make(world, camera)))
        except ModuleNotFoundError as error:
            missing[name] = f'{error.name} is not installed; pip install "navsim-rl[peers]" brings it'
        except (ImportError, OSError) as error:
            missing[name] = f"the system lacks what it needs ({error}); on Debian, apt install libegl1 libgl1-mesa-dri"
    agreements = [_agreement(renderer, world, poses[0]) for renderer in renderers]
    times: list[list[float]] = [[] for _ in renderers]
    for _ in range(repeats):
        for renderer, spent in zip(renderers, times, strict=True):
            spent.append(_seconds(renderer.render, poses))
    medians = [statistics.median(spent) for spent in times]
    size = (world.name, camera.width, camera.height)
    rows = [
        Row(*size, renderer.name, poses.shape[0] * poses.shape[1] / median, median / medians[0], agreement)
        for renderer, median, agreement in zip(renderers, medians, agreements, strict=True)
    ]
    return rows + [Row(*size, name, math.nan, math.nan, math.nan, why) for name, why in missing.items()]


def _agreement(renderer: Renderer, world: World, poses: np.ndarray) -> float:
    ours = _ray_caster(world, _with_border(renderer.camera)).render(poses)
    theirs = renderer.render(poses)
    low, high = (extreme(ours, size=(1, 3, 3))[:, 1:-1, 1:-1] for extreme in (minimum_filter, maximum_filter))
    return float(np.mean((low - _AGREEMENT < theirs) & (theirs < high + _AGREEMENT)))


def _with_border(camera: DepthCamera) -> DepthCamera:
    """The same camera with one more pixel on every side of the image."""

    def wider(fov_deg: float, pixels: int) -> float:
        return math.degrees(2.0 * math.atan(math.tan(math.radians(0.5 * fov_deg)) * (pixels + 2) / pixels))

    return replace(
        camera,
        width=camera.width + 2,
        height=camera.height + 2,
        horizontal_fov_deg=wider(camera.horizontal_fov_deg, camera.width),
        vertical_fov_deg=wider(camera.vertical_fov_deg, camera.height),
    )


def _ray_caster(world: World, camera: DepthCamera) -> Renderer:
    scene = Scene([world])
    return Renderer("navsim", camera, lambda poses: cast(scene, np.zeros(len(poses), dtype=np.intp), poses, camera))


# ---- peers: from a world and a camera to the camera that they render and their way to render it

_Peer = tuple[DepthCamera, Callable[[np.ndarray], np.ndarray]]


def _rays(camera: DepthCamera) -> np.ndarray:
    """``(H*W, 3)`` forward, left, up of each pixel's ray."""
    left, up = np.meshgrid(camera.column_slopes, camera.row_slopes)
    return np.stack([np.ones(left.size), left.ravel(), up.ravel()], axis=1)


def _rotations(poses: np.ndarray) -> np.ndarray:
    """``(N, 3, 3)``, whose rows are forward, left and up in the world."""
    rotations = np.zeros((len(poses), 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(poses[:, 2])
    rotations[:, 0, 1] = np.sin(poses[:, 2])
    rotations[:, 1, 0] = -rotations[:, 0, 1]
    rotations[:, 2, 2] = 1.0
    return rotations


def _eyes(camera: DepthCamera, poses: np.ndarray) -> np.ndarray:
    """``(N, 3)`` where the cameras are."""
    mount = np.array([camera.mount_x, camera.mount_y, camera.mount_z])
    return np.concatenate([poses[:, :2], np.zeros((len(poses), 1))], axis=1) + mount @ _rotations(poses)


def _triangles(prisms: Sequence[Prism], floor: float) -> np.ndarray:
    """``(T, 3, 3)``, counter-clockwise from outside, of prisms and of a floor as far as ``floor`` metres."""
    angles = np.arange(_SEGMENTS) * 2.0 * math.pi / _SEGMENTS
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners = floor * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    found = [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    for prism in prisms:
        around = prism.vertices + prism.radius * circle if prism.is_cylinder else prism.vertices
        low = np.concatenate([around, np.full((len(around), 1), prism.base)], axis=1)
        high = np.concatenate([around, np.full((len(around), 1), prism.top)], axis=1)
        for i in range(len(around)):
            j = (i + 1) % len(around)
            found += [np.stack([low[i], low[j], high[j]]), np.stack([low[i], high[j], high[i]])]
        for i in range(1, len(around) - 1):
            found += [high[[0, i, i + 1]], low[[0, i + 1, i]]]
    return np.array(found)


def _polygon_prisms(world: World) -> list[Prism]:
    """The prisms of polygons: what a peer without that shape takes as meshes."""
    kinds = [type(obstacle) for obstacle in world.obstacles]
    return [prism for prism in world.prisms if prism.obstacle >= 0 and kinds[prism.obstacle] not in (Box, Cylinder)]


def _cuboids(world: World) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Centre, half extents and yaw of walls and boxes."""
    found = []
    for prism in world.prisms:
        if prism.obstacle < 0:
            low, high = prism.vertices.min(axis=0), prism.vertices.max(axis=0)
            half = np.array([*0.5 * (high - low), 0.5 * (prism.top - prism.base)])
            found.append((np.array([*0.5 * (low + high), 0.5 * (prism.base + prism.top)]), half, 0.0))
    for box in world.obstacles:
        if isinstance(box, Box):
            centre = np.array([*box.at, 0.5 * (box.base + box.top)])
            found.append((centre, 0.5 * np.array([*box.size, box.height]), math.radians(box.yaw_deg)))
    return found


def _embree(world: World, camera: DepthCamera) -> _Peer:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, _triangles(world.prisms, 2.0 * world.half_size.max()).astype(np.float32))
    rays = _rays(camera).astype(np.float32)

    def render(poses: np.ndarray) -> np.ndarray:
        directions = rays @ _rotations(poses).astype(np.float32)
        origins = np.broadcast_to(_eyes(camera, poses).astype(np.float32)[:, None], directions.shape)
        depth = scene.run(np.ascontiguousarray(origins).reshape(-1, 3), directions.reshape(-1, 3), query="DISTANCE")
        return np.minimum(depth, camera.max_range).reshape(len(poses), camera.height, camera.width)

    return camera, render


def _mujoco(world: World, camera: DepthCamera) -> _Peer:
    import mujoco

    spec, geometry = mujoco.MjSpec(), mujoco.mjtGeom
    spec.worldbody.add_geom(type=geometry.mjGEOM_PLANE, size=[0, 0, 1])
    for centre, half, yaw in _cuboids(world):
        turn = [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]
        spec.worldbody.add_geom(type=geometry.mjGEOM_BOX, pos=centre, size=half, quat=turn)
    for can in world.obstacles:
        if isinstance(can, Cylinder):
            size = [can.radius, 0.5 * can.height, 0.0]
            spec.worldbody.add_geom(type=geometry.mjGEOM_CYLINDER, pos=[*can.at, 0.5 * (can.base + can.top)], size=size)
    for number, prism in enumerate(_polygon_prisms(world)):
        triangles = _triangles([prism], 0.0)[2:]
        faces = np.arange(3 * len(triangles))
        spec.add_mesh(name=f"{number}", uservert=triangles.ravel(), userface=faces)
        spec.worldbody.add_geom(type=geometry.mjGEOM_MESH, meshname=f"{number}")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rays, count = _rays(camera), camera.width * camera.height
    geoms = np.empty(count, dtype=np.int32)
    cutoff = camera.max_range * float(np.linalg.norm(rays, axis=1).max())

    def render(poses: np.ndarray) -> np.ndarray:
        depth = np.empty((len(poses), count))
        for eye, rotation, image in zip(_eyes(camera, poses), _rotations(poses), depth, strict=True):
            directions = (rays @ rotation).ravel()
            mujoco.mj_multiRay(model, data, eye, directions, None, True, -1, geoms, image, None, count, cutoff)
        depth[depth < 0.0] = camera.max_range
        return np.minimum(depth, camera.max_range).reshape(len(poses), camera.height, camera.width)

    return camera, render


def _pybullet(world: World, camera: DepthCamera) -> _Peer:
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)

    def add(position: Sequence[float], yaw: float = 0.0, **shape: Any) -> None:
        visual = pybullet.createVisualShape(physicsClientId=client, **shape)
        turn = [0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)]
        pybullet.createMultiBody(
            baseVisualShapeIndex=visual, basePosition=position, baseOrientation=turn, physicsClientId=client
        )

    floor = 2.0 * world.half_size.max()
    add([0.0, 0.0, -0.5], shapeType=pybullet.GEOM_BOX, halfExtents=[floor, floor, 0.5])
    for centre, half, yaw in _cuboids(world):
        add(centre.tolist(), yaw, shapeType=pybullet.GEOM_BOX, halfExtents=half.tolist())
    for can in world.obstacles:
        if isinstance(can, Cylinder):
            middle = [*can.at, 0.5 * (can.base + can.top)]
            add(middle, shapeType=pybullet.GEOM_CYLINDER, radius=can.radius, length=can.height)
    for prism in _polygon_prisms(world):
        corners = _triangles([prism], 0.0)[2:].reshape(-1, 3)
        add(
            [0.0, 0.0, 0.0],
            shapeType=pybullet.GEOM_MESH,
            vertices=corners.tolist(),
            indices=list(range(len(corners))),
            normals=[[0.0, 0.0, 1.0]] * len(corners),
        )
    near, far = 0.02, 1.2 * camera.max_range
    right, up = (
        near * math.tan(math.radians(0.5 * fov)) for fov in (camera.horizontal_fov_deg, camera.vertical_fov_deg)
    )
    projection = pybullet.computeProjectionMatrix(-right, right, -up, up, near, far)

    def render(poses: np.ndarray) -> np.ndarray:
        buffers = []
        for eye, rotation in zip(_eyes(camera, poses), _rotations(poses), strict=True):
            view = pybullet.computeViewMatrix(eye.tolist(), (eye + rotation[0]).tolist(), [0.0, 0.0, 1.0])
            picture = pybullet.getCameraImage(
                camera.width,
                camera.height,
                view,
                projection,
                shadow=0,
                flags=pybullet.ER_NO_SEGMENTATION_MASK,
                renderer=pybullet.ER_TINY_RENDERER,
                physicsClientId=client,
            )
            buffers.append(picture[3])
        buffer = np.array(buffers, dtype=np.float32).reshape(len(poses), camera.height, camera.width)
        return np.minimum(far * near / (far - (far - near) * buffer), camera.max_range)

    return camera, render


def _miniworld(world: World, camera: DepthCamera, samples: int) -> _Peer:
    os.environ.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")
    os.environ.setdefault("LP_NUM_THREADS", "0")  # llvmpipe renders on the calling thread
    import pyglet

    pyglet.options["headless"] = True
    from miniworld.entity import Entity
    from miniworld.miniworld import MiniWorldEnv
    from miniworld.opengl import FrameBuffer
    from pyglet import gl

    triangles = _triangles(world.prisms, 2.0 * world.half_size.max())
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # Miniworld's y points up and its z towards us, from the plan's point of view.
    swap = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])

    class Scenery(Entity):
        is_static = True

        def randomize(self, params: object, rng: object) -> None:
            self.pos, self.dir = np.zeros(3), 0.0

        def render(self) -> None:
            gl.glDisable(gl.GL_TEXTURE_2D)
            gl.glColor3f(0.5, 0.5, 0.5)
            gl.glBegin(gl.GL_TRIANGLES)
            for corners, normal in zip(triangles @ swap, normals @ swap, strict=True):
                gl.glNormal3f(*normal)
                for corner in corners:
                    gl.glVertex3f(*corner)
            gl.glEnd()

    class Environment(MiniWorldEnv):
        def _gen_world(self) -> None:
            self.add_rect_room(min_x=-1e3, max_x=1e3, min_z=-1e3, max_z=1e3, no_ceiling=True)
            self.rooms[0]._render = lambda: None
            self.entities.append(Scenery())
            self.agent.pos, self.agent.dir = np.zeros(3), 0.0
            self.entities.append(self.agent)

    with contextlib.redirect_stdout(io.StringIO()):  # it tells how many samples a pixel this machine can have
        environment = Environment(obs_width=camera.width, obs_height=camera.height, window_width=1, window_height=1)
        frame_buffer = FrameBuffer(camera.width, camera.height, samples)
    agent = environment.agent
    # Its pixels are square: the view is as wide as asked for.
    half_up = camera.height / camera.width * math.tan(math.radians(0.5 * camera.horizontal_fov_deg))
    square = replace(camera, vertical_fov_deg=math.degrees(2.0 * math.atan(half_up)))
    agent.cam_fov_y, agent.cam_height, agent.cam_fwd_disp, agent.cam_pitch = square.vertical_fov_deg, 0.0, 0.0, 0.0

    def render(poses: np.ndarray) -> np.ndarray:
        images = []
        for eye, pose in zip(_eyes(camera, poses) @ swap, poses, strict=True):
            agent.pos, agent.dir = eye, pose[2]
            images.append(environment.render_depth(frame_buffer)[..., 0])
        return np.minimum(np.array(images), camera.max_range)

    return square, render


_PEERS: dict[str, Callable[[World, DepthCamera], _Peer]] = {
    "Embree (embreex)": _embree,
    "MuJoCo (mj_multiRay)": _mujoco,
    "PyBullet (TinyRenderer)": _pybullet,
    "Miniworld (Mesa)": partial(_miniworld, samples=8),  # what it asks for by itself
    "Miniworld (Mesa, 1 sample)": partial(_miniworld, samples=1),
}

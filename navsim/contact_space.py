"""One robot among obstacles that move and that can be pushed, in a Chipmunk space.

Chipmunk solves contacts for velocities; see ``navsim.physics`` for the order of its step and for what that means for a
robot. Here the other bodies are

- what moves by itself: kinematic bodies that stand, at the end of every substep, exactly where their motion in closed
  form puts them. Nothing stops them;
- what can be pushed: dynamic bodies that floor friction slows down. Friction acts against the velocity of the
  footprint as a whole, turning included: (v, c·ω) is slowed down by μ·g as one vector (an ellipsoidal limit surface,
  Howe and Cutkosky 1996), where c is the mean distance of the footprint's points from the centroid. A sliding body
  comes to rest after v²/(2·μ·g), up to rounding. Contacts themselves have no friction and do not bounce.

Overlaps are ended within the substep that brings them. What is fixed comes first: a robot or a pushable body that
something moving presses against a wall stays out of the wall, and the moving thing passes over it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pymunk

from navsim.dynamics import GRAVITY, DynamicObstacle, dynamic_obstacles
from navsim.robot import Robot
from navsim.spaces import ContactSpaceOwner
from navsim.world import World

CONTACT_OVERLAP = 0.5e-3
"""How deep what is pushed out stays in contact, metres: so that the contact holds while it slides."""
ALLOWED_OVERLAP = 1e-3
"""Overlap that needs no correction, metres."""
LONGEST_STEP = 0.02
"""Metres that a moving obstacle may travel in one step of Chipmunk; faster ones take more steps."""
TRACTION = 0.6
"""Coefficient of friction between the wheels and the floor: it limits the force with which the robot pushes things."""

ROBOT, FIXED, MOVING, PUSHABLE = 1, 2, 3, 4
"""Chipmunk's collision types."""
PUSHES = 8
"""Corrections along contact normals before a body is put back instead."""
_CRUSHED = 0.05  # metres: what is deeper than that in a moving obstacle could not give way, and is passed over
_ITERATIONS = 30  # of Chipmunk's solver: chains of bodies of unlike masses need more than its 10


class _Thing:
    """A body with its shapes; ``inner`` metres around its centre of gravity are its own, or less."""

    def __init__(
        self, body: pymunk.Body, shapes: Sequence[pymunk.Shape], heights: tuple[float, float], inner: float
    ) -> None:
        self.body, self.shapes, self.heights, self.inner = body, tuple(shapes), heights, inner
        self.in_contact = False


class _Pushed(_Thing):
    """A pushable obstacle."""

    def __init__(self, body: pymunk.Body, shapes: Sequence[pymunk.Shape], one: DynamicObstacle) -> None:
        super().__init__(body, shapes, (one.base, one.top), _inner_radius(one))
        assert one.solid is not None
        self._solid = one.solid
        # Turning is slowed down this much faster than sliding, relatively; never more than 1.
        self._turn_share = one.solid.mass * one.solid.friction_radius**2 / one.solid.inertia
        self._owed = 0.0  # loss of speed by friction that is still to come after a step, m/s
        self._stops = False

    def slow_down(self, dt: float) -> None:
        """Before a step: lets floor friction act on the way, and on the velocity with which contacts are solved."""
        body, solid = self.body, self._solid
        self._owed, self._stops = 0.0, False
        velocity, turn = body.velocity, body.angular_velocity
        speed = math.hypot(velocity.x, velocity.y, solid.friction_radius * turn)
        loss = solid.deceleration * dt
        if speed == 0.0:
            # What presses against it from now on has to overcome friction; a blow comes half way through, on average.
            self._owed = loss if self.in_contact else 0.5 * loss
            return
        self._stops = loss >= speed
        if self.in_contact:
            # As a force: Chipmunk moves the body first, then applies it, then solves the contacts.
            share = min(loss / speed, 1.0)
            body.force = -share * solid.mass / dt * velocity
            body.torque = -(1.0 if self._stops else share * self._turn_share) * solid.inertia / dt * turn
            self._owed = max(0.0, loss - speed)
            return
        # Free: the way of a step is that of the mean speed, which is exact for a constant deceleration.
        mean = 0.5 * speed / loss if self._stops else 1.0 - 0.5 * loss / speed
        body.velocity = mean * velocity
        body.angular_velocity = (1.0 - (1.0 - mean) * self._turn_share) * turn
        self._owed = mean * speed - max(0.0, speed - loss)

    def slow_down_further(self) -> None:
        """After a step: takes away the rest of what friction takes in it."""
        if self._owed == 0.0:
            return
        body, solid = self.body, self._solid
        velocity, turn = body.velocity, body.angular_velocity
        speed = math.hypot(velocity.x, velocity.y, solid.friction_radius * turn)
        if speed == 0.0:
            return
        if self._owed >= speed or (self._stops and not self.in_contact):
            body.velocity, body.angular_velocity = (0.0, 0.0), 0.0
        else:
            share = self._owed / speed
            body.velocity = (1.0 - share) * velocity
            body.angular_velocity = (1.0 - share * self._turn_share) * turn


class ContactSpace(ContactSpaceOwner):
    """A world's obstacles, as far as the robot or something pushable may touch them.

    Args:
        world: the world.
        robot: the robot.
    """

    def __init__(self, world: World, robot: Robot) -> None:
        super().__init__()
        self.space.iterations = _ITERATIONS
        self._push_limit = TRACTION * robot.mass * GRAVITY
        self._robot = _robot(robot)
        self._things = [_thing(one) for one in dynamic_obstacles(world)]
        self._thing_of = {shape: thing for thing in (self._robot, *self._things) for shape in thing.shapes}
        self._heights = {shape: thing.heights for shape, thing in self._thing_of.items()}
        touching = [self._robot.heights, *(thing.heights for thing in self._things if isinstance(thing, _Pushed))]
        for prism in world.fixed_prisms:
            if any(prism.overlaps_heights(*heights) for heights in touching):
                shape = _shape(self.space.static_body, prism.vertices, prism.radius, FIXED)
                self._heights[shape] = (prism.base, prism.top)
                self.space.add(shape)
        for first in (ROBOT, PUSHABLE):
            for second in (FIXED, MOVING, PUSHABLE):
                self.tell_contacts(first, second)
        self._robot_on_solid = self._touched_solid = self._touched_pushable = False

    def simulate(
        self,
        position: np.ndarray,
        velocities: np.ndarray,
        dt: float,
        schedule: np.ndarray,
        near: np.ndarray,
        poses: np.ndarray,
        speeds: np.ndarray,
    ) -> tuple[tuple[float, float], bool, bool]:
        """Drives the robot through S substeps among D dynamic obstacles; what is pushed is moved in place.

        Args:
            position: ``(2,)`` of the robot, metres.
            velocities: ``(S, 2)`` m/s, the commanded ones of each substep.
            dt: length of a substep, seconds.
            schedule: ``(S * fine + 1, D, 3)`` poses of what moves by itself, at the ends of ``fine`` equal parts of
                each substep.
            near: ``(D,)`` bool, the obstacles to reckon with.
            poses: ``(D, 3)``, of which those of pushable obstacles are read, and written.
            speeds: ``(D, 3)`` m/s and rad/s, likewise.

        Returns:
            the robot's position afterwards, metres; whether it touched something that does not give way; whether it
            touched something pushable.
        """
        fine = (len(schedule) - 1) // len(velocities)
        commands = [(x, y) for x, y in velocities.tolist() for _ in range(fine)]
        robot, here = self._robot, position.tolist()
        # All is where it belongs before it is added: where Chipmunk's tree puts a shape, and so the order in which it
        # solves contacts, depends on place and velocity.
        _place(robot.body, (*here, 0.0), (*commands[0], 0.0))
        robot.in_contact = False
        moving: list[tuple[_Thing, list[list[float]]]] = []
        pushed: list[_Pushed] = []
        slots = np.flatnonzero(near).tolist()
        for slot in slots:
            thing = self._things[slot]
            thing.in_contact = False
            if isinstance(thing, _Pushed):
                _place(thing.body, poses[slot].tolist(), speeds[slot].tolist())
                pushed.append(thing)
            else:
                way = schedule[:, slot].tolist()
                _place(thing.body, way[0], _speeds(way[0], way[1], dt / fine))
                moving.append((thing, way))
        present = [robot, *(self._things[slot] for slot in slots)]
        for thing in present:
            self.space.add(thing.body, *thing.shapes)
        self._robot_on_solid = self._touched_solid = self._touched_pushable = False
        for number in range(len(commands)):
            self._step(commands, number, dt / fine, moving, pushed)
        for thing in present:
            self.space.remove(thing.body, *thing.shapes)
        for slot in slots:
            thing = self._things[slot]
            if isinstance(thing, _Pushed):
                body = thing.body
                poses[slot] = body.position.x, body.position.y, body.angle
                speeds[slot] = body.velocity.x, body.velocity.y, body.angular_velocity
        after = robot.body.position
        return (after.x, after.y), self._touched_solid, self._touched_pushable

    def _step(
        self,
        commands: list[tuple[float, float]],
        number: int,
        dt: float,
        moving: list[tuple[_Thing, list[list[float]]]],
        pushed: list[_Pushed],
    ) -> None:
        """One step of Chipmunk, with all that belongs to it."""
        robot = self._robot
        for thing, way in moving:
            _place(thing.body, way[number], _speeds(way[number], way[number + 1], dt))
        for thing in pushed:
            thing.slow_down(dt)
        if robot.in_contact:
            self._accelerate_robot(commands[min(number + 1, len(commands) - 1)], dt)
        else:
            robot.body.velocity = commands[number]
        robot_start = robot.body.position
        starts = [(thing, thing.body.position, thing.body.angle) for thing in pushed]
        for thing in (robot, *pushed):
            thing.in_contact = False
        self._robot_on_solid = False
        self.space.step(dt)
        for thing, start, angle in starts:
            thing.slow_down_further()
            if thing.in_contact or thing.body.position.get_distance(start) > 0.5 * thing.inner:
                self._push_out(thing, start, angle)
        if robot.in_contact:
            self._push_out(robot, robot_start, robot.body.angle)

    def _accelerate_robot(self, command: tuple[float, float], dt: float) -> None:
        """Applies the force that makes ``command``, m/s, of the velocity before contacts are solved.

        Against what gives way it is at most what the wheels can bring to the floor.
        """
        body = self._robot.body
        gain = body.mass / dt
        x, y = gain * (command[0] - body.velocity.x), gain * (command[1] - body.velocity.y)
        share = 1.0 if self._robot_on_solid else min(1.0, self._push_limit / max(math.hypot(x, y), 1e-12))
        body.force = share * x, share * y

    def note_contact(self, arbiter: pymunk.Arbiter) -> None:
        first, second = arbiter.shapes
        if not self._share_heights(first, second):
            arbiter.process_collision = False
            return
        for shape in (first, second):
            if shape in self._thing_of:
                self._thing_of[shape].in_contact = True
        if first.collision_type == ROBOT:
            if second.collision_type == PUSHABLE:
                self._touched_pushable = True
            else:
                self._touched_solid = self._robot_on_solid = True

    def _share_heights(self, first: pymunk.Shape, second: pymunk.Shape) -> bool:
        (low, high), (base, top) = self._heights[first], self._heights[second]
        return low < top and base < high

    def _push_out(self, thing: _Thing, start: pymunk.Vec2d, angle: float) -> None:
        """Ends the overlaps of a body along contact normals, the deepest first.

        Where that leads nowhere, only those with what is fixed are ended; where that leads nowhere either, or through
        something fixed, it is put back to where it was.
        """
        body = thing.body
        is_out = self._end_overlaps(thing, with_fixed_only=False) or self._end_overlaps(thing, with_fixed_only=True)
        is_near = body.position.get_distance(start) <= 0.5 * thing.inner
        if is_out and (is_near or not self._crosses(thing, start, body.position)):
            return
        body.position, body.angle = start, angle
        if isinstance(thing, _Pushed):
            body.velocity, body.angular_velocity = (0.0, 0.0), 0.0
        self.space.reindex_shapes_for_body(body)

    def _end_overlaps(self, thing: _Thing, with_fixed_only: bool) -> bool:
        """Moves a body out of what it overlaps with; whether that succeeded."""
        for _ in range(PUSHES):
            depth, normal = self._deepest_contact(thing, with_fixed_only)
            if depth <= ALLOWED_OVERLAP:
                return True
            thing.body.position -= normal * (depth - CONTACT_OVERLAP)
            self.space.reindex_shapes_for_body(thing.body)
        return self._deepest_contact(thing, with_fixed_only)[0] <= ALLOWED_OVERLAP

    def _deepest_contact(self, thing: _Thing, with_fixed_only: bool) -> tuple[float, pymunk.Vec2d]:
        """How deep a body is in another, metres, and the direction into it; 0 where it touches nothing.

        The robot does not force its way into what it pushes, but is held off by it; that is pushed by velocity alone.
        """
        deepest, direction = 0.0, pymunk.Vec2d.zero()
        for shape in thing.shapes:
            for info in self.space.shape_query(shape):
                other = info.shape
                if self._thing_of.get(other) is thing or not self._share_heights(shape, other):
                    continue
                kind = other.collision_type
                if kind != FIXED and (with_fixed_only or kind == ROBOT):
                    continue
                depth = max(-point.distance for point in info.contact_point_set.points)
                if kind == MOVING and depth > _CRUSHED:
                    continue
                if depth > deepest:
                    deepest, direction = depth, info.contact_point_set.normal
        return deepest, direction

    def _crosses(self, thing: _Thing, start: pymunk.Vec2d, end: pymunk.Vec2d) -> bool:
        """Whether the way of a body's centre leads through something fixed."""
        hits = self.space.segment_query(start, end, 0.0, pymunk.ShapeFilter())
        low, high = thing.heights
        for hit in hits:
            if hit.shape.collision_type == FIXED:
                base, top = self._heights[hit.shape]
                if low < top and base < high:
                    return True
        return False


def _robot(robot: Robot) -> _Thing:
    body = pymunk.Body(robot.mass, pymunk.moment_for_circle(robot.mass, 0.0, robot.radius))
    disc = _shape(body, np.zeros((1, 2)), robot.radius, ROBOT)
    return _Thing(body, [disc], (0.0, robot.height), robot.radius)


def _thing(one: DynamicObstacle) -> _Thing:
    if one.solid is None:
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        shapes = [_shape(body, part.vertices, part.radius, MOVING) for part in one.parts]
        return _Thing(body, shapes, (one.base, one.top), one.reach)
    body = pymunk.Body(one.solid.mass, one.solid.inertia)
    return _Pushed(body, [_shape(body, part.vertices, part.radius, PUSHABLE) for part in one.parts], one)


def _inner_radius(one: DynamicObstacle) -> float:
    """Metres from the centroid to the nearest edge; 0 for a body of several pieces, whose ways are always looked at."""
    part = one.parts[0]
    if part.radius > 0.0:
        return part.radius
    along = np.roll(part.vertices, -1, axis=0) - part.vertices
    cross = along[:, 0] * -part.vertices[:, 1] + along[:, 1] * part.vertices[:, 0]
    return 0.0 if len(one.parts) > 1 else float((cross / np.hypot(*along.T)).min())


def _shape(body: pymunk.Body, vertices: np.ndarray, radius: float, collision_type: int) -> pymunk.Shape:
    shape: pymunk.Shape
    if radius > 0.0:
        x, y = vertices[0].tolist()
        shape = pymunk.Circle(body, radius, (x, y))
    else:
        shape = pymunk.Poly(body, vertices.tolist())
    shape.collision_type = collision_type
    return shape


def _speeds(begin: Sequence[float], end: Sequence[float], dt: float) -> list[float]:
    """m/s, m/s and rad/s that lead from one pose to another in ``dt`` seconds."""
    return [(b - a) / dt for a, b in zip(begin, end, strict=True)]


def _place(body: pymunk.Body, pose: Sequence[float], speeds: Sequence[float]) -> None:
    body.position, body.angle = (pose[0], pose[1]), pose[2]
    body.velocity, body.angular_velocity = (speeds[0], speeds[1]), speeds[2]

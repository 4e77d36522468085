"""Chipmunk's spaces and bodies, whose memory is free as soon as nobody uses them.

In pymunk, shapes and bodies refer to themselves, and handlers of collisions to themselves, to their space and to the
function that they call, while the space refers to them. Such circles stay until Python's garbage collector comes round:
among the hundreds of thousands of objects of a training, which are there to stay, so seldom that some 40 MB of spaces
wait for it, and more the longer one looks. So here the circles are broken when their owner goes.
"""

from __future__ import annotations

import weakref

import pymunk


class ContactSpaceOwner:
    """Has a Chipmunk space, which goes with it, and is told of contacts.

    Attributes:
        space: the space. Overlaps are not ended by it, bit by bit: owners do it at once.
    """

    def __init__(self) -> None:
        self.space = pymunk.Space()
        self.space.collision_bias = 1.0

    def tell_contacts(self, first: int, second: int) -> None:
        """Has ``note_contact`` called for each contact between shapes of these two collision types, in every step."""
        note_contact = weakref.WeakMethod(self.note_contact)

        def tell(arbiter: pymunk.Arbiter, space: pymunk.Space, data: object) -> None:
            note = note_contact()
            assert note is not None, "the owner steps the space"
            note(arbiter)

        self.space.on_collision(first, second, pre_solve=tell)

    def note_contact(self, arbiter: pymunk.Arbiter) -> None:
        """Two shapes touch."""
        raise NotImplementedError

    def __del__(self) -> None:
        for handler in getattr(self.space, "_handlers", {}).values():
            vars(handler).clear()
        let_go(*self.space.shapes, *self.space.bodies, self.space.static_body)


def let_go(*things: pymunk.Shape | pymunk.Body) -> None:
    """Frees shapes and bodies with the last reference to them; in contacts they must take no part any more."""
    for thing in things:
        for handle in ("_h", "_data_handle"):  # by which Chipmunk finds the object of what it tells of
            vars(thing).pop(handle, None)

"""Views of browsers that show the whole room, and rays of browsers that meet surfaces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.paper import paper_room
from support.rooms import lab
from support.tables import rows

from lmd.planner.viewing import FIELD_OF_VIEW, FILLED_SHARE, framed, pointed_at
from lmd.space.surface import SurfaceArrays

LENGTH = st.floats(0.5, 100.0)
WALLS = ("x_min", "x_max", "y_min", "y_max", "floor", "ceiling")


def shown(low, high, aspect, position, look_at):
    """Corners of a room in a window, from -1 to 1 across and up, `(8, 2)`."""
    ahead = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
    offset = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T - position
    far = np.tan(FIELD_OF_VIEW / 2.0) * (offset @ ahead)
    assert (far > 0.0).all()
    return np.stack([offset @ right / far / aspect, offset @ np.cross(right, ahead) / far], axis=-1)


@given(st.tuples(LENGTH, LENGTH, LENGTH), st.tuples(LENGTH, LENGTH, LENGTH), st.floats(0.3, 4.0))
def test_a_room_of_any_shape_fills_a_window_of_any_shape(low, size, aspect):
    low, high = np.array(low), np.array(low) + size
    corners = shown(low, high, aspect, *framed(low, high, aspect))
    assert np.abs(corners).max() <= FILLED_SHARE + 1e-9
    assert (np.ptp(corners, axis=0).max()) == pytest.approx(2.0 * FILLED_SHARE)


def at(eye, target, room=None, own="none"):
    """Name of the surface that a ray from `eye` to `target` points at, and the point."""
    room = room or paper_room()
    names, surfaces = [surface.name for surface in room.surfaces()], SurfaceArrays.of(room.surfaces())
    eye, target = np.array(eye, dtype=float), np.array(target, dtype=float)
    place = pointed_at(surfaces, eye, target - eye, names.index(own) if own in names else -1)
    if place is None:
        return None, None
    s, (a, b) = place
    return names[s], pytest.approx(surfaces.origin[s] + a * surfaces.u[s] + b * surfaces.v[s])


@pytest.mark.parametrize(("eye", "target", "own", "found", "point"), rows(__file__, "rays"))
def test_a_ray_meets_the_front_of_a_surface_or_the_plane_of_its_own(eye, target, own, found, point):
    assert at(eye, target, own=own) == (found, point)


def test_of_two_surfaces_the_nearer_one_is_met():
    assert at((2.0, 3.5, 1.0), (0.0, 3.5, 1.0), lab())[0] == "obstacle_0_x_max"
    assert at((2.0, 2.8, 1.0), (0.0, 2.8, 1.0), lab())[0] != "obstacle_0_x_max"

"""Where rooms are looked at from."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lmd.planner.framing import FIELD_OF_VIEW, FILLED_SHARE, Framing, framed

LENGTH = st.floats(0.5, 100.0)


def shown(low, high, aspect, position, look_at):
    """Where the corners of a room are in a window, from -1 to 1 across and up, `(8, 2)`."""
    ahead = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
    offset = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T - position
    far = np.tan(FIELD_OF_VIEW / 2.0) * (offset @ ahead)
    assert (far > 0.0).all()
    return np.stack([offset @ right / far / aspect, offset @ np.cross(right, ahead) / far], axis=-1)


@given(st.tuples(LENGTH, LENGTH, LENGTH), st.tuples(LENGTH, LENGTH, LENGTH), st.floats(0.3, 4.0))
def test_a_room_fills_the_window_whatever_their_shapes(low, size, aspect):
    low, high = np.array(low), np.array(low) + size
    corners = shown(low, high, aspect, *framed(low, high, aspect))
    assert np.abs(corners).max() <= FILLED_SHARE + 1e-9
    assert (np.ptp(corners, axis=0).max()) == pytest.approx(2.0 * FILLED_SHARE)


class Camera(SimpleNamespace):
    """The view of a browser."""

    def on_update(self, follow):
        self.follow = follow

    def told(self, **changes):
        """Something about it has changed."""
        vars(self).update(changes)
        run(self.follow(self))


def run(awaitable):
    """Run what awaits nothing."""
    with pytest.raises(StopIteration):
        awaitable.send(None)


def test_a_view_follows_the_window_until_it_is_turned():
    low, high, called = np.zeros(3), np.array([6.0, 4.0, 2.8]), {}
    server = SimpleNamespace(
        initial_camera=SimpleNamespace(),
        on_client_connect=lambda greet: called.update(greet=greet),
        on_client_disconnect=lambda forget: called.update(forget=forget),
    )
    Framing(server, low, high)
    camera = Camera(position=server.initial_camera.position, look_at=server.initial_camera.look_at, aspect=1.2)
    browser = SimpleNamespace(client_id=3, camera=camera)
    run(called["greet"](browser))
    for aspect in (1.2, 2.0, 0.5):
        camera.told(aspect=aspect)
        assert (camera.position == framed(low, high, aspect).position).all()
        assert (camera.look_at == framed(low, high, aspect).look_at).all()
    turned = camera.position + 1.0
    camera.told(position=turned)
    camera.told(aspect=1.6)
    assert (camera.position == turned).all()
    run(called["forget"](browser))
    again = Camera(position=turned, look_at=low, aspect=1.6)  # the same page, connected again
    run(called["greet"](SimpleNamespace(client_id=4, camera=again)))
    assert (again.position == turned).all()

"""Where to look at a room from so that it fills the window."""

import math
from typing import Any, NamedTuple

import numpy as np

from lmd.core.checks import FloatArray
from lmd.plot.common import viewer

FIELD_OF_VIEW = math.radians(50.0)  # vertical
FILLED_SHARE = 0.92  # share of the window's width or height that the room takes
ASPECT = 1.6  # width by height of a window that has not told its own
SAME_PLACE = 1e-3  # distances of the room between two places of a viewer that count as the same


class Frame(NamedTuple):
    """Where the viewer is and what is looked at, `(3,)` each, world frame, metres."""

    position: FloatArray
    look_at: FloatArray


def framed(low: FloatArray, high: FloatArray, aspect: float) -> Frame:
    """The nearest place from which the box between two corners `(3,)` is in view, in the middle of the window.

    Args:
        low, high: the corners with the least and the largest coordinates, metres.
        aspect: of the window, width by height.
    """
    ahead = -viewer()
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), ahead])
    choices = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    corners = choices @ axes.T
    deep = corners[:, 2]
    slopes = FILLED_SHARE * math.tan(FIELD_OF_VIEW / 2.0) * np.array([aspect, 1.0])
    # A corner at (x, deep) is in view from (c, d) if |x - c| <= slope (deep - d): c has a choice as long as d is small.
    edges = [((corners[:, i] - s * deep).max(), (corners[:, i] + s * deep).min(), s) for i, s in enumerate(slopes)]
    across = [(below + above) / 2.0 for below, above, _ in edges]
    nearest = min((above - below) / (2.0 * slope) for below, above, slope in edges)
    middle = (low + high) / 2.0 @ ahead
    return Frame(np.array([*across, nearest]) @ axes, np.array([*across, middle]) @ axes)


class Framing:
    """Lets a room fill the windows of all browsers, whatever their size, until somebody turns or moves the view.

    Args:
        server: of viser.
        low, high: see `framed`.
    """

    def __init__(self, server: Any, low: FloatArray, high: FloatArray) -> None:
        self._low, self._high = low, high
        self._given: dict[int, FloatArray] = {}  # the place each browser was given
        first = framed(low, high, ASPECT)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.position, server.initial_camera.look_at = first
        self._first = first.position

        async def greet(client: Any) -> None:
            async def follow(_: Any) -> None:
                self._follow(client)

            self._given[client.client_id] = self._first
            client.camera.on_update(follow)
            self._follow(client)

        async def forget(client: Any) -> None:
            self._given.pop(client.client_id, None)

        server.on_client_connect(greet)
        server.on_client_disconnect(forget)

    def _follow(self, client: Any) -> None:
        """Give a browser the place for its window, if it is where it was put."""
        camera = client.camera
        place = framed(self._low, self._high, camera.aspect)
        is_ours = any(self._is_there(camera, at) for at in (self._given[client.client_id], place.position))
        if is_ours and not self._is_there(camera, place.position):
            self._given[client.client_id] = place.position
            camera.position, camera.look_at = place

    def _is_there(self, camera: Any, place: FloatArray) -> bool:
        return bool(np.linalg.norm(camera.position - place) < SAME_PLACE * np.linalg.norm(self._high - self._low))

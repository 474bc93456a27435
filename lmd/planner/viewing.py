"""Geometry of the view in a browser: viewpoints from which the room fills the window, and places hit by rays."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lmd.core.checks import FloatArray
from lmd.plot import common
from lmd.plot.common import viewer
from lmd.space.surface import SurfaceArrays

FIELD_OF_VIEW = math.radians(50.0)  # vertical field of view of a browser, rad
FILLED_SHARE = 0.92  # share of the window's width or height that the room fills
ASPECT = 1.6  # ratio of width to height of a window before the browser reports it
SAME_PLACE = 1e-3  # maximum distance of two equal viewpoints, in diagonals of the room
EDGE_ON = 1e-6  # minimum cosine of the angle between a ray and the normal of a surface that the ray meets
ON_SURFACE_M = 1e-6  # tolerance of the borders of a surface, metres


class BrowserView(NamedTuple):
    """Viewpoint of a browser's virtual camera, world frame, metres."""

    position: FloatArray
    """Position of the viewer, `(3,)`."""
    look_at: FloatArray
    """Point that appears in the middle of the window, `(3,)`."""


def framed(low: FloatArray, high: FloatArray, aspect: float) -> BrowserView:
    """Nearest viewpoint from which a whole box is visible, in the middle of the window.

    Args:
        low, high: corners of the box with the least and the largest coordinates, `(3,)`, metres.
        aspect: ratio of width to height of the window.
    """
    ahead = -viewer()
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, ahead), ahead])
    choices = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    corners = choices @ axes.T
    deep = corners[:, 2]
    slopes = FILLED_SHARE * math.tan(FIELD_OF_VIEW / 2.0) * np.array([aspect, 1.0])
    # A corner at (x, deep) is in view from (c, d) if |x - c| <= slope (deep - d). A viewpoint c exists if d is small
    # enough.
    edges = [((corners[:, i] - s * deep).max(), (corners[:, i] + s * deep).min(), s) for i, s in enumerate(slopes)]
    across = [(below + above) / 2.0 for below, above, _ in edges]
    nearest = min((above - below) / (2.0 * slope) for below, above, slope in edges)
    middle = (low + high) / 2.0 @ ahead
    return BrowserView(np.array([*across, nearest]) @ axes, np.array([*across, middle]) @ axes)


class Framing:
    """Fits the room into the window of each browser until the user moves the view.

    The view is fitted at the beginning, and after each change of the window's size.

    Args:
        server: server of viser.
        low, high: corners of the room's box with the least and the largest coordinates, `(3,)`, metres.
    """

    def __init__(self, server: Any, low: FloatArray, high: FloatArray) -> None:
        self._low, self._high = low, high
        self._given: dict[int, FloatArray] = {}  # viewpoint that was sent to each browser
        first = framed(low, high, ASPECT)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.position, server.initial_camera.look_at = first

        async def greet(client: Any) -> None:
            async def follow(_: Any) -> None:
                self._follow(client)

            self._given[client.client_id] = first.position
            client.camera.on_update(follow)
            self._follow(client)

        async def forget(client: Any) -> None:
            self._given.pop(client.client_id, None)

        server.on_client_connect(greet)
        server.on_client_disconnect(forget)

    def _follow(self, client: Any) -> None:
        """Fit the view to the browser's window, unless the user has moved the view."""
        camera = client.camera
        view = framed(self._low, self._high, camera.aspect)
        is_ours = any(self._is_there(camera, at) for at in (self._given[client.client_id], view.position))
        if is_ours and not self._is_there(camera, view.position):
            self._given[client.client_id] = view.position
            camera.position, camera.look_at = view

    def _is_there(self, camera: Any, place: FloatArray) -> bool:
        return bool(np.linalg.norm(camera.position - place) < SAME_PLACE * np.linalg.norm(self._high - self._low))


class Place(NamedTuple):
    """A place on a surface."""

    surface: int
    """Index of the surface."""
    at: FloatArray
    """Coordinates along u and v of the surface, `(2,)`, metres."""


def pointed_at(surfaces: SurfaceArrays, eye: FloatArray, way: FloatArray, own: int = -1) -> Place | None:
    """Place at which a ray first meets the front of a surface.

    The backs of surfaces are transparent, so that walls between the viewer and the room do not stop the ray. A ray that
    meets no front ends in the plane of the surface `own`, even if it meets this plane from behind. So a tag stays on
    its wall if it is dragged beyond the wall's edge, or is seen from behind.

    Args:
        surfaces: W surfaces, treated as whole rectangles, even where no landmark may hang.
        eye: start of the ray, `(3,)`, world frame, metres.
        way: direction of the ray, `(3,)`.
        own: index of the surface that carries the dragged tag; -1 for none.

    Returns:
        the place; None if the ray meets no surface, or is not finite.
    """
    every = np.arange(len(surfaces.normal))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        towards = surfaces.normal @ way
        far = ((surfaces.origin - eye) * surfaces.normal).sum(axis=1) / towards
        is_met = (np.abs(towards) > EDGE_ON) & (far > 0.0)
        at = surfaces.coordinates(every, eye + np.where(is_met, far, 0.0)[:, None] * way)
    within = ((at >= -ON_SURFACE_M) & (at <= surfaces.extent + ON_SURFACE_M)).all(axis=1)
    front = is_met & within & (towards < 0.0)
    if front.any():
        first = int(np.argmin(np.where(front, far, np.inf)))
        return Place(first, at[first])
    return Place(own, at[own]) if own >= 0 and is_met[own] and np.isfinite(at[own]).all() else None


Rgb = tuple[int, int, int]
Colours = NDArray[np.uint8]


def rgb(colour: str) -> Rgb:
    """Red, green and blue components, 0 to 255, of a colour `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


FREE, PINNED = rgb(common.LANDMARK), rgb(common.FIXED)
SELECTED = rgb("#ff7f0e")
UNKNOWN = rgb("#cdcdcd")
WALL = rgb("#ececec")
VALUES = common.COLOUR_MAP  # colour map of the objective's values
GAINS = "magma"  # colour map of gains by one more tag


def alike(colour: Rgb, count: int) -> Colours:
    """Array `(count, 3)` that repeats the colour `colour` in each row."""
    return np.tile(np.array(colour, dtype=np.uint8), (count, 1))


def span_of(values: FloatArray) -> tuple[float, float]:
    """Least and greatest of the `values` `(N,)`, which are in [0, 1]; 0 and 1 if all values are equal."""
    low, high = float(values.min()), float(values.max())
    return (low, high) if low < high else (0.0, 1.0)


def mapped(name: str, shares: ArrayLike) -> Colours:
    """Colours `(N, 3)` that matplotlib's colour map `name` gives to the numbers `shares` `(N,)`, in [0, 1]."""
    from matplotlib import colormaps

    return np.asarray(colormaps[name](np.asarray(shares), bytes=True))[:, :3]

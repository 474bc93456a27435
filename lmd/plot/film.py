"""A rendered flight as a small animated picture: what the camera sees and detects, and where it is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray
from lmd.core.optional import optional
from lmd.estimation.rendered import Moment
from lmd.geometry.camera import Camera
from lmd.geometry.projection import view_edges
from lmd.geometry.se3 import act
from lmd.plot import common
from lmd.plot.detection import BOTH, LEGEND, outlined
from lmd.space.space import Space

SIZE = (9.0, 4.1)  # inches
DPI = 90
WIDTH = 560  # of a frame, pixels
QUALITY = 55  # of the animated picture, 0 to 100
PYRAMID_DEPTH = 0.6  # of the pyramid that stands for the camera, metres


def save_film(
    path: str | Path, moments: Sequence[Moment], camera: Camera, room: Space, landmarks: FloatArray, title: str
) -> None:
    """Write an animated picture that takes as long as the flight: a frame beside the room with the camera.

    Args:
        moments: of the flight, at least two, in order.
        camera: its image and focal lengths give the shape of the pyramid.
        room: drawn in black.
        landmarks: the tags, world frame, metres, `(K, 3)`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    track = np.stack([moment.pose[:3, 3] for moment in moments])
    pictures = []
    for i, moment in enumerate(moments):
        figure.clear()
        figure.suptitle(common.literal(title), fontsize=11, y=0.985)
        _draw_frame(figure, moment)
        _draw_room(figure, moment, camera, room, landmarks, track[: i + 1])
        canvas.draw()
        pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    steps = np.diff([moment.time for moment in moments])
    durations = np.rint(1000.0 * np.append(steps, steps[-1])).astype(int).tolist()
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, quality=QUALITY, method=4
    )


def _draw_frame(figure: Any, moment: Moment) -> None:
    cv2 = optional("cv2", "detection")
    share = WIDTH / moment.image.shape[1]
    small = cv2.resize(moment.image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    axes = figure.add_axes((0.005, 0.09, 0.585, 0.83))
    axes.imshow(outlined(small, share * moment.expected, moment.predicted, share * moment.found))
    axes.set_axis_off()
    for i, (colour, text) in enumerate(LEGEND):
        figure.text(0.01 + 0.2 * i, 0.035, f"■ {text}", color=np.array(colour) / 255.0, fontsize=9)


def _draw_room(
    figure: Any, moment: Moment, camera: Camera, room: Space, landmarks: FloatArray, track: FloatArray
) -> None:
    """The room, the way so far, and the camera with lines to the tags that it found."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    axes = figure.add_axes((0.58, 0.02, 0.43, 0.9), projection="3d")
    axes.view_init(common.ELEVATION, common.AZIMUTH)
    axes.set_axis_off()
    for part, edges in room.outline().items():
        if part in ("room", "obstacles"):
            axes.add_collection(Line3DCollection(edges, colors=common.PARTS[part][0], linewidths=0.8))
    found = np.isfinite(moment.found).all(axis=(1, 2))
    green, position = np.array(BOTH) / 255.0, moment.pose[:3, 3]
    axes.scatter(*landmarks[~found].T, s=6, color=common.UNQUALIFIED, depthshade=False)
    axes.scatter(*landmarks[found].T, s=14, color=green, depthshade=False)
    rays = np.stack([np.broadcast_to(position, landmarks[found].shape), landmarks[found]], axis=1)
    axes.add_collection(Line3DCollection(rays, colors=green, linewidths=0.7, alpha=0.7))
    axes.plot(*track.T, color=common.LANDMARK, lw=1.2)
    axes.add_collection(
        Line3DCollection(act(moment.pose, view_edges(camera, PYRAMID_DEPTH)), colors=common.LANDMARK, linewidths=1.2)
    )
    low, high = room.bounds()
    for name, start, end in zip("xyz", low, high, strict=True):
        getattr(axes, f"set_{name}lim")(start, end)
    axes.set_box_aspect(high - low, zoom=1.08)
    seconds = f"{moment.time:.1f} s, tags detected: {found.sum()}"
    figure.text(0.98, 0.035, seconds, ha="right", fontsize=9)

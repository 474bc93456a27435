"""The room in the browser: surfaces, positions, tags and the camera, as viser draws them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmd.camera import Camera
from lmd.checks import BoolArray, FloatArray
from lmd.geometry.se3 import axis_and_right, camera_pose
from lmd.planner.additions import candidate_cells
from lmd.planner.plan import Plan
from lmd.plot import common
from lmd.problem import Problem
from lmd.tag import upright

Colours = NDArray[np.uint8]

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
FLAT = {"lod": "off", "cast_shadow": False, "receive_shadow": False}  # of viser's batched meshes
ABOVE = 0.01  # metres from a surface to the tags on it, so that they are drawn before it
BALL = 0.12  # radius of a position, in distances to the next one
POINT = 0.008  # half the edge of a landmark that is a point, in diagonals of the room
CELL = 0.97  # of a cell that is coloured
VIEWER = 0.95  # distance from the middle of the room, in diagonals
LIGHT = 2.0  # with which colours come out as they are given, nearly
FRUSTUM = 0.08  # size of the camera, in diagonals
SELECTED, SEEN, UNKNOWN = (255, 127, 14), (255, 221, 51), (205, 205, 205)
ADDED = "magma"  # colour map of what a tag would add


class Picture:
    """Everything that is drawn.

    tags, cells, balls: handles of viser, for callbacks; an instance of `tags` is a tag of the plan, in its order, one
    of `cells` a candidate place, one of `balls` a position of the grid.

    Args:
        server: of viser.
        problem: its room and its grid are drawn.
    """

    def __init__(self, server: Any, problem: Problem) -> None:
        self._server, self._scene, self._problem = server, server.scene, problem
        self.candidates = candidate_cells(problem)
        low, high = problem.scene.room.bounds()
        self._diagonal = float(np.linalg.norm(high - low))
        server.initial_camera.position = (low + high) / 2.0 + VIEWER * self._diagonal * common.viewer()
        server.initial_camera.look_at = (low + high) / 2.0
        # One light from everywhere: colours mean values, and shades would change them.
        self._scene.configure_default_lights(enabled=False)
        self._scene.configure_environment_map(None)
        self._scene.add_light_ambient("/light", intensity=LIGHT)
        self._draw_outline()
        self.cells = self._drawn_cells()
        self.balls = self._drawn_balls()
        self.tags: Any = None
        self._label: Any = None
        self._frustums: list[Any] = []

    def _draw_outline(self) -> None:
        for name, edges in self._problem.scene.room.outline().items():
            colour = _rgb(common.PARTS[name][0])
            self._scene.add_line_segments(f"/outline/{name}", edges, np.array(colour, dtype=np.uint8))

    def _drawn_cells(self) -> Any:
        poses, (half_u, half_v) = self.candidates.poses, (self.candidates.half_u, self.candidates.half_v)
        up = half_v / np.linalg.norm(half_v, axis=1, keepdims=True)
        sizes = np.stack([*(CELL * np.linalg.norm(half, axis=1) for half in (half_u, half_v)), np.ones(len(poses))], 1)
        return self._scene.add_batched_meshes_simple(
            "/surfaces",
            SQUARE,
            TRIANGLES,
            _quaternions(np.cross(up, poses.normals), up, poses.normals),
            poses.positions,
            batched_scales=sizes,
            batched_colors=np.tile(np.array(UNKNOWN, dtype=np.uint8), (len(poses), 1)),
            side="front",  # walls between the viewer and the room are not seen
            **FLAT,
        )

    def _drawn_balls(self) -> Any:
        from trimesh.creation import icosphere

        positions = self._problem.evaluator.positions
        ball = icosphere(subdivisions=1, radius=BALL * common.spacing_of(self._problem.scene.room, positions))
        upright_all = np.tile([1.0, 0.0, 0.0, 0.0], (len(positions), 1))
        colours = np.tile(np.array(UNKNOWN, dtype=np.uint8), (len(positions), 1))
        mesh = (ball.vertices, ball.faces, upright_all, positions)
        return self._scene.add_batched_meshes_simple("/positions", *mesh, batched_colors=colours, **FLAT)

    def show_tags(self, plan: Plan, selected: int | None, seen: BoolArray | None) -> bool:
        """Draw the tags of a plan: the selected one by its id and those `seen` `(K,)` stand out.

        Returns:
            whether `tags` is a new handle, which callbacks do not know yet.
        """
        deployment = plan.deployment
        colours = np.tile(np.array(_rgb(common.LANDMARK), dtype=np.uint8), (len(deployment), 1))
        colours[np.isin(deployment.ids, list(plan.pinned))] = _rgb(common.FIXED)
        if seen is not None:
            colours[seen] = SEEN
        chosen = deployment.ids == selected
        colours[chosen] = SELECTED
        places = deployment.positions + ABOVE * deployment.normals
        turns = _quaternions(*upright(deployment.normals), deployment.normals)
        fresh = self.tags is None or len(self.tags.batched_positions) != len(deployment)
        if fresh:
            half = self._problem.scene.plates.edge / 2.0 or POINT * self._diagonal
            self.tags = self._scene.add_batched_meshes_simple(
                "/tags", half * SQUARE, TRIANGLES, turns, places, batched_colors=colours, side="double", **FLAT
            )
        else:
            self.tags.batched_positions, self.tags.batched_wxyzs, self.tags.batched_colors = places, turns, colours
        self._show_label(selected, places[chosen])
        return fresh

    def _show_label(self, number: int | None, places: FloatArray) -> None:
        if self._label is None:
            self._label = self._scene.add_label("/selected", "", anchor="bottom-center", visible=False)
        self._label.visible = bool(len(places))
        if len(places):
            self._label.text, self._label.position = str(number), places[0]

    def show_values(self, values: FloatArray) -> None:
        """Colour the positions by the objective's values `(P,)`."""
        self.balls.batched_colors = _colours(common.COLOUR_MAP, values)

    def show_additions(self, gains: FloatArray | None) -> None:
        """Colour the surfaces by what a tag would add, `(N,)`, from nothing to the most; None while it is not known."""
        if gains is None:
            self.cells.batched_colors = np.tile(np.array(UNKNOWN, dtype=np.uint8), (len(self.candidates.poses), 1))
            return
        most = float(np.nanmax(gains, initial=0.0))
        colours = _colours(ADDED, np.nan_to_num(gains) / (most or 1.0))
        colours[np.isnan(gains)] = UNKNOWN
        self.cells.batched_colors = colours

    def show_camera(self, position: FloatArray, yaw: float, pitch: float) -> None:
        """Draw the camera, or all of a rig, with the body at `position` `(3,)`, metres, a yaw and a pitch in rad."""
        body = axis_and_right(camera_pose(position[None], np.array([yaw]), np.array([pitch])))
        for number, station in enumerate(self._problem.scene.stations(body)):
            if number == len(self._frustums):
                self._frustums.append(self._add_frustum(number, station.camera))
            forward, right = station.axes[:, :3], station.axes[:, 3:]
            frustum = self._frustums[number]
            frustum.position = position + station.offset
            frustum.wxyz = _quaternions(right, np.asarray(np.cross(forward, right)), forward)[0]

    def _add_frustum(self, number: int, camera: Camera) -> Any:
        tall = camera.image_height * camera.pixel_height
        return self._scene.add_camera_frustum(
            f"/camera_{number}",
            2.0 * math.atan(tall / (2.0 * camera.focal_length)),
            camera.image_width * camera.pixel_width / tall,
            scale=FRUSTUM * self._diagonal,
            color=SEEN,
        )


def _quaternions(right: FloatArray, up: FloatArray, normal: FloatArray) -> FloatArray:
    """The turns that take x, y, z to these unit vectors `(N, 3)`, as w, x, y, z, `(N, 4)`."""
    return np.asarray(Rotation.from_matrix(np.stack([right, up, normal], axis=-1)).as_quat(scalar_first=True))


def _colours(name: str, shares: FloatArray) -> Colours:
    """Shares of 1 `(N,)` as colours of a map of matplotlib, `(N, 3)`."""
    from matplotlib import colormaps

    return np.asarray(colormaps[name](shares, bytes=True)[:, :3])


def _rgb(colour: str) -> tuple[int, int, int]:
    """`#rrggbb` as three numbers."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue

"""Picture of a room, drawn by viser: surfaces, camera positions and tags, with captions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmd.core.checks import FloatArray, IntArray
from lmd.planner.figures import candidate_cells
from lmd.planner.plan import Plan
from lmd.planner.viewing import (
    FREE,
    GAINS,
    PINNED,
    SELECTED,
    UNKNOWN,
    VALUES,
    WALL,
    Framing,
    alike,
    mapped,
    rgb,
)
from lmd.plot import common
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.space.surface import FLAT, Surface

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
SHADOWLESS: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}
MESH_OPTIONS: dict[str, Any] = {"lod": "off", **SHADOWLESS}  # options of viser's batched meshes
TAG_OFFSET_M = 0.01  # distance of drawn tags in front of their surface, so that they are visible, metres
BALL_RADIUS = 0.12  # radius of a position, relative to the spacing of positions
POINT_SIZE = 0.008  # half the edge of a point landmark, in diagonals of the room
CELL_SHARE = 0.97  # coloured share of the width and height of a cell
LIGHT_INTENSITY = 2.0  # intensity of the light at which viser hardly changes colours
NAME, ID, CHOSEN = 1.0, 0.75, 1.1  # sizes of letters, relative to viser's default
MOST_CAPTIONS = 120  # maximum number of ids shown at the start; more ids would hide the tags


class RoomPicture:
    """Drawing of a room, of the camera positions and of the tags.

    `tags` and `cells` are viser's handles of batched meshes, to which callbacks are attached. Instance i of `tags` is
    tag i of the plan. Instance i of `cells` is the i-th place for one more tag (`candidates`).

    Args:
        server: server of viser.
        problem: problem whose room and grid are drawn.
    """

    def __init__(self, server: Any, problem: Problem) -> None:
        self._server, self._scene, self._problem = server, server.scene, problem
        self.candidates = candidate_cells(problem)
        low, high = problem.scene.room.bounds()
        self._diagonal = float(np.linalg.norm(high - low))
        self._framing = Framing(server, low, high)
        # The light is ambient: shading would change the colours, which represent values.
        self._scene.configure_default_lights(enabled=False)
        self._scene.configure_environment_map(None)
        self._scene.add_light_ambient("/light", intensity=LIGHT_INTENSITY)
        self._draw_outline()
        self.cells = self._drawn_cells()
        self.balls = self._drawn_balls()
        self.tags: Any = None
        self.captions = Captions(self._scene, problem.scene.footprints.hanging.surfaces())

    def _draw_outline(self) -> None:
        for name, edges in self._problem.scene.room.outline().items():
            colour = rgb(common.PARTS[name][0])
            self._scene.add_line_segments(f"/outline/{name}", edges, np.array(colour, dtype=np.uint8))
        walls = [face for face in self._problem.scene.room.faces() if face.is_upright]
        if walls:  # filled and, like the cells, invisible from behind
            corners = np.concatenate([self._behind(face) for face in walls])
            triangles = (4 * np.arange(len(walls))[:, None, None] + TRIANGLES).reshape(-1, 3)  # indices of corners
            self._scene.add_mesh_simple("/walls", corners, triangles, color=WALL, side="front", **SHADOWLESS)

    @staticmethod
    def _behind(face: Surface) -> FloatArray:
        """Corners of a face, `(4, 3)`, metres, in counter-clockwise order as seen from its front.

        The corners are moved slightly behind the face, so that tags on the face remain visible.
        """
        (length, height), is_left = face.extent, np.cross(face.u, face.v) @ face.normal > 0.0
        ring = face.point(*np.array([[0.0, 0.0], [length, 0.0], [length, height], [0.0, height]]).T)
        return np.asarray((ring if is_left else ring[::-1]) - TAG_OFFSET_M * face.normal)

    def _drawn_cells(self) -> Any:
        poses, (half_u, half_v) = self.candidates.poses, (self.candidates.half_u, self.candidates.half_v)
        up = half_v / np.linalg.norm(half_v, axis=1, keepdims=True)
        sizes = np.stack(
            [*(CELL_SHARE * np.linalg.norm(half, axis=1) for half in (half_u, half_v)), np.ones(len(poses))], 1
        )
        return self._scene.add_batched_meshes_simple(
            "/surfaces",
            SQUARE,
            TRIANGLES,
            _quaternions(np.cross(up, poses.normals), up, poses.normals),
            poses.positions,
            batched_scales=sizes,
            batched_colors=alike(UNKNOWN, len(poses)),
            side="front",  # walls between the viewer and the room are invisible
            **MESH_OPTIONS,
        )

    def _drawn_balls(self) -> Any:
        from trimesh.creation import icosphere

        positions = self._problem.evaluator.positions
        ball = icosphere(subdivisions=1, radius=BALL_RADIUS * common.spacing_of(self._problem.scene.room, positions))
        upright_all = np.tile([1.0, 0.0, 0.0, 0.0], (len(positions), 1))
        unknown, mesh = alike(UNKNOWN, len(positions)), (ball.vertices, ball.faces, upright_all, positions)
        return self._scene.add_batched_meshes_simple("/positions", *mesh, batched_colors=unknown, **MESH_OPTIONS)

    def show_tags(self, plan: Plan, selected: int | None, ids: bool) -> bool:
        """Draw the tags of a plan.

        Args:
            plan: the plan.
            selected: id of the selected tag; None for none.
            ids: True to show all ids, False to show only the id of the selected tag.

        Returns:
            True if `tags` is a new handle, to which callbacks must be attached.
        """
        deployment = plan.deployment
        painted = alike(FREE, len(deployment))
        painted[np.isin(deployment.ids, list(plan.pinned))] = PINNED
        painted[deployment.ids == selected] = SELECTED
        places = deployment.positions + TAG_OFFSET_M * deployment.normals
        ups = deployment.ups
        turns = _quaternions(np.asarray(np.cross(ups, deployment.normals)), ups, deployment.normals)
        fresh = self.tags is None or len(self.tags.batched_positions) != len(deployment)
        halves = self._halves(deployment)
        if fresh:
            self.tags = self._scene.add_batched_meshes_simple(
                "/tags", SQUARE, TRIANGLES, turns, places, batched_scales=halves, batched_colors=painted,
                side="double", **MESH_OPTIONS,
            )  # fmt: skip
        else:
            self.tags.batched_positions, self.tags.batched_wxyzs, self.tags.batched_colors = places, turns, painted
            self.tags.batched_scales = halves
        above = places + halves[:, None] * ups  # an id is at the upper edge of its tag
        self.captions.show_ids(deployment.ids, above, selected, ids)
        return fresh

    def _halves(self, deployment: Deployment) -> FloatArray:
        """Half the edge length of the square that is drawn for each landmark, `(K,)`, metres.

        The square of a tag is its paper; points have a square of a fixed size.
        """
        papers = self._problem.scene.footprints.papers(deployment)
        return np.where(papers > 0.0, papers / 2.0, POINT_SIZE * self._diagonal)

    def show_values(self, values: FloatArray, span: tuple[float, float]) -> None:
        """Colour the positions by the objective's `values` `(P,)`.

        `span` are the values that the first and the last colour of the colour map represent.
        """
        low, high = span
        self.balls.batched_colors = mapped(VALUES, (values - low) / (high - low))

    def show_additions(self, gains: FloatArray | None) -> None:
        """Colour the N cells of the surfaces by `gains` `(N,)`, the gain by one more tag in each cell.

        The first colour of the colour map represents 0, the last colour the largest gain. Cells whose gain is NaN are
        grey. If `gains` is None, all cells are grey.
        """
        if gains is None:
            self.cells.batched_colors = alike(UNKNOWN, len(self.candidates.poses))
            return
        most = float(np.nanmax(gains, initial=0.0))
        painted = mapped(GAINS, np.nan_to_num(gains) / (most or 1.0))
        painted[np.isnan(gains)] = UNKNOWN
        self.cells.batched_colors = painted


def _quaternions(right: FloatArray, up: FloatArray, normal: FloatArray) -> FloatArray:
    """Quaternions (w, x, y, z), `(N, 4)`, of the rotations that turn the axes x, y, z to `right`, `up`, `normal`.

    These are unit vectors, `(N, 3)` each.
    """
    return np.asarray(Rotation.from_matrix(np.stack([right, up, normal], axis=-1)).as_quat(scalar_first=True))


class Captions:
    """Texts in the picture, as labels of viser: names of surfaces, and ids of tags.

    Args:
        scene: scene of a server of viser.
        surfaces: surfaces whose names are shown.
    """

    def __init__(self, scene: Any, surfaces: Sequence[Surface]) -> None:
        self._scene = scene
        self._names = [_add_name(scene, surface) for surface in surfaces]
        self._ids: list[Any] = []
        self._shown: list[tuple[str, tuple[float, ...], bool, bool]] = []

    def show_names(self, visible: bool) -> None:
        """Show the names of the surfaces, or hide them."""
        for label in self._names:
            label.visible = visible

    def show_ids(self, ids: IntArray, places: FloatArray, selected: int | None, visible: bool) -> None:
        """Show the ids `(K,)` of tags at `places` `(K, 3)`; the selected tag's id is larger and always visible."""
        for k, (number, place) in enumerate(zip(ids.tolist(), places.tolist(), strict=True)):
            self._show_id(k, (str(number), tuple(place), number == selected, visible or number == selected))
        for label in self._ids[len(ids) :]:
            label.visible = False
        del self._shown[len(ids) :]

    def _show_id(self, k: int, wanted: tuple[str, tuple[float, ...], bool, bool]) -> None:
        """Update the label of tag k if it differs from `wanted`, because each update is sent to all browsers.

        `wanted` has the text, the position, True if the tag is selected, and True if the label is visible.
        """
        if k == len(self._ids):
            self._ids.append(self._scene.add_label(f"/ids/{k}", "", anchor="bottom-center", visible=False))
        if k < len(self._shown) and self._shown[k] == wanted:
            return
        label, (label.text, label.position, chosen, label.visible) = self._ids[k], wanted
        label.font_screen_scale = CHOSEN if chosen else ID
        self._shown[k : k + 1] = [wanted]


def _add_name(scene: Any, surface: Surface) -> Any:
    """Draw the name of a surface: below a wall, so that the name is visible even if the wall is not drawn; in the
    middle of a floor or ceiling.
    """
    is_level, (width, height) = abs(surface.normal[2]) > FLAT, surface.extent
    return scene.add_label(
        f"/names/{surface.name}",
        surface.name,
        position=surface.point(width / 2.0, height / 2.0 if is_level else 0.0),
        anchor="center-center" if is_level else "top-center",
        font_screen_scale=NAME,
    )

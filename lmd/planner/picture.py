"""The room in the browser: surfaces, positions, tags and the camera, as viser draws them."""

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmd.core.checks import BoolArray, FloatArray
from lmd.geometry.squares import upright
from lmd.planner.additions import candidate_cells
from lmd.planner.captions import Captions
from lmd.planner.colours import (
    ASKED,
    FREE,
    GAINS,
    MEASURED,
    PINNED,
    SEEN,
    SELECTED,
    UNKNOWN,
    VALUES,
    alike,
    mapped,
    rgb,
)
from lmd.planner.framing import Framing
from lmd.planner.plan import Plan
from lmd.planner.surveyed import Found
from lmd.plot import common
from lmd.problem import Problem
from lmd.scene.deployment import Deployment

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
MESH_OPTIONS = {"lod": "off", "cast_shadow": False, "receive_shadow": False}  # of viser's batched meshes
TAG_OFFSET_M = 0.01  # metres from a surface to the tags on it, so that they are drawn before it
BALL_RADIUS = 0.12  # radius of a position, in distances to the next one
POINT_SIZE = 0.008  # half the edge of a landmark that is a point, in diagonals of the room
CELL_SHARE = 0.97  # of a cell that is coloured
OFFSET_MAGNIFICATION = 20.0  # times that lines to where tags hang are as long
LIGHT_INTENSITY = 2.0  # with which colours come out as they are given, nearly
FRUSTUM_DEPTH = 0.08  # depth of views that are drawn, in diagonals


class Picture:
    """Everything that is drawn.

    tags, cells, balls: handles of viser, for callbacks; an instance of `tags` is a tag of the plan, in its order, one
    of `cells` a candidate place, one of `balls` a position of the grid. depth: of views that are drawn, metres.

    Args:
        server: of viser.
        problem: its room and its grid are drawn.
    """

    def __init__(self, server: Any, problem: Problem) -> None:
        self._server, self._scene, self._problem = server, server.scene, problem
        self.candidates = candidate_cells(problem)
        low, high = problem.scene.room.bounds()
        self._diagonal = float(np.linalg.norm(high - low))
        self.depth = FRUSTUM_DEPTH * self._diagonal
        self._framing = Framing(server, low, high)
        # One light from everywhere: colours mean values, and shades would change them.
        self._scene.configure_default_lights(enabled=False)
        self._scene.configure_environment_map(None)
        self._scene.add_light_ambient("/light", intensity=LIGHT_INTENSITY)
        self._draw_outline()
        self.cells = self._drawn_cells()
        self.balls = self._drawn_balls()
        self.tags: Any = None
        self.captions = Captions(self._scene, problem.scene.plates.hanging.surfaces())

    def _draw_outline(self) -> None:
        for name, edges in self._problem.scene.room.outline().items():
            colour = rgb(common.PARTS[name][0])
            self._scene.add_line_segments(f"/outline/{name}", edges, np.array(colour, dtype=np.uint8))

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
            side="front",  # walls between the viewer and the room are not seen
            **MESH_OPTIONS,
        )

    def _drawn_balls(self) -> Any:
        from trimesh.creation import icosphere

        positions = self._problem.evaluator.positions
        ball = icosphere(subdivisions=1, radius=BALL_RADIUS * common.spacing_of(self._problem.scene.room, positions))
        upright_all = np.tile([1.0, 0.0, 0.0, 0.0], (len(positions), 1))
        unknown, mesh = alike(UNKNOWN, len(positions)), (ball.vertices, ball.faces, upright_all, positions)
        return self._scene.add_batched_meshes_simple("/positions", *mesh, batched_colors=unknown, **MESH_OPTIONS)

    def show_tags(self, plan: Plan, selected: int | None, seen: BoolArray | None, ids: bool) -> bool:
        """Draw the tags of a plan, with their `ids` or only that of the selected one; those `seen` `(K,)` stand out.

        Returns:
            whether `tags` is a new handle, which callbacks do not know yet.
        """
        deployment = plan.deployment
        painted = alike(FREE, len(deployment))
        painted[np.isin(deployment.ids, list(plan.pinned))] = PINNED
        if seen is not None:
            painted[seen] = SEEN
        painted[deployment.ids == selected] = SELECTED
        places = deployment.positions + TAG_OFFSET_M * deployment.normals
        turns = _quaternions(*upright(deployment.normals), deployment.normals)
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
        above = places + halves[:, None] * upright(deployment.normals)[1]
        self.captions.show_ids(deployment.ids, above, selected, ids)
        return fresh

    def _halves(self, deployment: Deployment) -> FloatArray:
        """Half the edges of the papers of tags, `(K,)`, metres; of points, as large as they are drawn."""
        papers = self._problem.scene.plates.papers(deployment)
        return np.where(papers > 0.0, papers / 2.0, POINT_SIZE * self._diagonal)

    def show_survey(self, found: Found, plan: Deployment) -> None:
        """Draw where tags hang, lines from where they are planned, and the photographs that a survey asks for."""
        tags = found.tags
        self._scene.add_batched_meshes_simple(
            "/survey/tags",
            SQUARE,
            TRIANGLES,
            _quaternions(np.asarray(np.cross(tags.ups, tags.normals)), tags.ups, tags.normals),
            tags.places + 2.0 * TAG_OFFSET_M * tags.normals,
            batched_scales=self._halves(tags),
            batched_colors=alike(MEASURED, len(tags)),
            side="double",
            opacity=0.6,
            **MESH_OPTIONS,
        )
        lines = found.offsets(plan, OFFSET_MAGNIFICATION)
        if len(lines):
            self._scene.add_line_segments("/survey/offsets", lines, np.array(MEASURED, dtype=np.uint8))
        for number, (place, ahead) in enumerate(found.photographs, 1):
            right: FloatArray = np.cross(ahead, [0.0, 0.0, 1.0])
            right = right / max(float(np.linalg.norm(right)), 1e-9)
            turn = _quaternions(right[None], np.cross(ahead, right)[None], ahead[None])[0]
            self._scene.add_camera_frustum(
                f"/survey/next_{number}", math.radians(50.0), 4.0 / 3.0, color=ASKED,
                scale=self.depth / 2.0, wxyz=turn, position=place,
            )  # fmt: skip

    def show_values(self, values: FloatArray) -> None:
        """Colour the positions by the objective's values `(P,)`."""
        self.balls.batched_colors = mapped(VALUES, values)

    def show_additions(self, gains: FloatArray | None) -> None:
        """Colour the surfaces by what a tag would add, `(N,)`, from nothing to the most; None while it is not known."""
        if gains is None:
            self.cells.batched_colors = alike(UNKNOWN, len(self.candidates.poses))
            return
        most = float(np.nanmax(gains, initial=0.0))
        painted = mapped(GAINS, np.nan_to_num(gains) / (most or 1.0))
        painted[np.isnan(gains)] = UNKNOWN
        self.cells.batched_colors = painted


def _quaternions(right: FloatArray, up: FloatArray, normal: FloatArray) -> FloatArray:
    """Quaternions w, x, y, z, `(N, 4)`, of the rotations that take the axes x, y, z to these unit vectors `(N, 3)`."""
    return np.asarray(Rotation.from_matrix(np.stack([right, up, normal], axis=-1)).as_quat(scalar_first=True))

"""Floor plan: the room's walls and obstacles, and the allowed regions for landmarks on surfaces."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, NotNegative, Positive, entries, span
from lmd.space.allowed import polygons
from lmd.space.blockers import Blockers, checked_ring, edges, on_hull, planes, upright_bodies
from lmd.space.fixture import Fixture
from lmd.space.parts import FACES, KeepOut, Obstacle, all_made, check_metres, check_surfaces, checked_names
from lmd.space.surface import PLACEMENT_TOLERANCE, Surface, free_of

# Depth of the free space that a face must have in front, metres.
FREE_BEFORE_M = 1e-3


@dataclass(frozen=True)
class FloorPlan(Checked):
    """Room with upright walls over a simple polygon, with pillars, furniture, doors and windows.

    Raises:
        InputError: a polygon crosses itself or is clockwise, a pillar or an obstacle is not inside the room, or a name
            is unknown. Other causes: a keep-out (part of a surface without landmarks) is not on its surface, or a
            surface has no allowed region.
    """

    outline: Annotated[Sequence[Sequence[float]], checked_ring]
    """Vertices [x, y], counter-clockwise, metres. The wall from vertex i to the next is `wall_<i>`."""
    height: Positive
    """Height of the ceiling above the floor, metres."""
    holes: Annotated[Sequence[Sequence[Sequence[float]]], partial(entries, check=checked_ring)] = ()
    """Pillars from floor to ceiling, polygons like the outline; their walls are named `hole_<i>_wall_<j>`."""
    obstacles: Annotated[Sequence[Any], partial(all_made, kind=Obstacle)] = ()
    """Boxes in the room: `Obstacle`s, or mappings of their arguments. The faces are named `obstacle_<i>_<face>`."""
    surfaces: Sequence[str] | None = None
    """Names of the surfaces that may carry landmarks: walls, `floor` and `ceiling`; None for all. Faces listed in
    `Obstacle.faces` carry landmarks, too.
    """
    keep_out: Annotated[Sequence[Any], partial(all_made, kind=KeepOut)] = ()
    """Parts of surfaces without landmarks: `KeepOut`s, or mappings of their arguments."""
    band: Annotated[Sequence[float], partial(span, point=False)] | None = None
    """Lowest and highest z of landmarks on upright surfaces, metres; None for all heights."""
    margin: NotNegative = 0.0
    """Distance of landmarks from the edges of a surface, measured along the surface's u and v, metres."""
    path: str | None = None
    """Path of the file from which the plan was read."""
    note: str = ""
    """Remark on the file from which the plan was read, a sentence; may be empty."""

    def _validate(self) -> None:
        hint = "give metres; divide millimetres by 1000"
        check_metres([*np.ptp(np.array(self.outline), axis=0), self.height], "outline makes", hint, "outline")
        check_surfaces(self.keep_out, list(self._faces))
        if self.band is not None:
            span("band", self.band, low=0.0, high=self.height)
        self._check_parts()
        if self.surfaces is not None:
            built = [name for name in self._faces if not name.startswith("obstacle_")]
            object.__setattr__(self, "surfaces", checked_names("surfaces", self.surfaces, built))
        self.carriers  # noqa: B018 # raises if a surface has no allowed region

    def _check_parts(self) -> None:
        """Raise `InputError` if a pillar or an obstacle is not inside the room, or a keep-out is not on its surface.

        A keep-out is a part of a surface that must stay free of landmarks.
        """
        import shapely

        outline, holes = shapely.Polygon(self.outline), [shapely.Polygon(hole) for hole in self.holes]
        for i, hole in enumerate(holes):
            if not outline.contains_properly(hole):
                raise InputError(f"holes[{i}] is not inside the outline.", f"holes[{i}]")
            if any(hole.intersects(other) for other in holes[:i]):
                raise InputError(f"holes[{i}] meets another hole.", f"holes[{i}]")
        free = self.ground.buffer(PLACEMENT_TOLERANCE)
        for i, obstacle in enumerate(self.obstacles):
            (x, y, z), (x_end, y_end, z_end) = obstacle.low, obstacle.high
            inside = free.covers(shapely.box(x, y, x_end, y_end))
            if not inside or z < -PLACEMENT_TOLERANCE or z_end > self.height + PLACEMENT_TOLERANCE:
                raise InputError(
                    f"obstacles[{i}] from {list(obstacle.low)} to {list(obstacle.high)} is not inside the room.",
                    f"obstacles[{i}]",
                )
            for name in obstacle.faces:
                face = self._faces[f"obstacle_{i}_{name}"]
                if self._region(face).is_empty:
                    raise InputError(
                        f"obstacles[{i}].faces: {name} stands against a wall, the floor or the ceiling, so it cannot "
                        "carry landmarks.",
                        f"obstacles[{i}].faces",
                    )
        for i, part in enumerate(self.keep_out):
            name = f"keep_out[{i}]"
            face = self._faces[part.surface]
            part.check_on(name, face.extent)
            if not self._region(face).intersects(part.region(face)):
                along, up = face.extent
                raise InputError(f"{name} lies outside {part.surface}, which is {along:.4g} x {up:.4g} m.", name)

    @cached_property
    def ground(self) -> Any:
        """Floor of the room, a shapely polygon: the area in the outline minus the pillars (`holes`)."""
        import shapely

        return shapely.Polygon(self.outline, self.holes)

    @cached_property
    def blockers(self) -> Blockers | None:
        """Convex bodies that can block lines between points of the room; None without such bodies."""
        bodies = [*upright_bodies(self.ground), *(obstacle.body for obstacle in self.obstacles)]
        return Blockers.of(bodies) if bodies else None

    @cached_property
    def hull(self) -> tuple[FloatArray, FloatArray]:
        """Lines n . x = d through the walls that lie on the convex hull of the room's outline.

        Returns:
            outward unit normals n, `(N, 2)`, and offsets d, metres, `(N,)`.
        """
        return planes(edges(self.outline)[on_hull(self.ground)])

    @cached_property
    def rim(self) -> tuple[FloatArray, FloatArray]:
        """Lines n . x = d through all sides of the walls' convex hull: unit normals n, `(N, 2)`, and offsets d, `(N,)`.

        The normals point outwards; offsets are in metres. The bodies that fill the space outside the outline extend to
        these lines.
        """
        import shapely

        return planes(edges(shapely.orient_polygons(self.ground.convex_hull).exterior.coords[:-1]))

    def contains(self, points: FloatArray, clearance: float = 0.0) -> BoolArray:
        """Mask of the points `(..., 3)` in the closed room, `(...)`.

        To count, a point must be at least `clearance`, metres, from the planes of walls, holes and obstacles.
        """
        p = np.asarray(points)
        inside = np.ones(p.shape[:-1], dtype=np.bool_)
        for (normals, offsets), away in ((self.rim, 0.0), (self.hull, clearance)):
            inside &= (p[..., :2] @ normals.T <= offsets - away + PLACEMENT_TOLERANCE).all(axis=-1)
        inside &= (p[..., 2] >= -PLACEMENT_TOLERANCE) & (p[..., 2] <= self.height + PLACEMENT_TOLERANCE)
        if self.blockers is not None:
            inside &= ~self.blockers.grown(clearance).inside(p)
        return np.asarray(inside)

    @cached_property
    def _faces(self) -> dict[str, Surface]:
        """Faces of walls, floor, ceiling and obstacles by name: whole rectangles, with no part cut out."""
        faces = [self._wall(f"wall_{i}", edge, -1.0) for i, edge in enumerate(edges(self.outline))]
        for i, hole in enumerate(self.holes):
            faces += [self._wall(f"hole_{i}_wall_{j}", edge, 1.0) for j, edge in enumerate(edges(hole))]
        vertices, (ex, ey, ez) = np.array(self.outline), np.eye(3)
        low = np.append(vertices.min(axis=0), 0.0)
        length, width = (float(side) for side in np.ptp(vertices, axis=0))
        faces.append(Surface("floor", low, ex, ey, ez, (length, width)))
        faces.append(Surface("ceiling", low + self.height * ez, ex, ey, 0.0 - ez, (length, width)))
        for i, obstacle in enumerate(self.obstacles):
            faces += obstacle.surfaces(f"obstacle_{i}").values()
        return {face.name: face for face in faces}

    def _wall(self, name: str, edge: FloatArray, side: float) -> Surface:
        """Wall over an edge of the floor plan.

        The wall faces to the right of the edge if `side` is 1, and to the left of the edge if `side` is -1.
        """
        (normal,), _ = planes(edge[None])
        length = float(np.linalg.norm(edge[1] - edge[0]))
        # As in a cuboid, u points towards higher x, or towards higher y if u is along y.
        start, end = sorted(edge.tolist())
        along = np.append((np.array(end) - start) / length, 0.0)
        facing = np.append(normal if side > 0.0 else 0.0 - normal, 0.0)
        return Surface(name, np.append(start, 0.0), along, np.eye(3)[2], facing, (length, self.height))

    @property
    def faces(self) -> tuple[Surface, ...]:
        """Faces of walls, floor, ceiling and obstacles: whole rectangles, with no part cut out."""
        return tuple(self._faces.values())

    @property
    def kept_out(self) -> list[FloatArray]:
        """Vertices of each keep-out (part of a surface without landmarks), world frame, metres, `(N, 3)` each."""
        on = ((self._faces[part.surface], part.ring) for part in self.keep_out)
        return [face.point(*face.from_left_and_below(ring).T) for face, ring in on]

    @property
    def fixtures(self) -> list[Fixture]:
        """Obstacles and keep-outs (parts of surfaces without landmarks, such as doors), for drawings.

        One that has no name of its own is named by its index, such as `obstacle 0`.
        """
        parts = [(f"keep_out {i}", *pair) for i, pair in enumerate(zip(self.keep_out, self.kept_out, strict=True))]
        parts += [(f"obstacle {i}", part, part.corners()) for i, part in enumerate(self.obstacles)]
        return [Fixture(part.name or number, corners) for number, part, corners in parts]

    def clearings(self, clearance: float) -> list[list[tuple[float, ...]]]:
        """Outlines of the floor area at least `clearance`, metres, from walls, pillars and obstacles, for drawings.

        An outline is a list of vertices (x, y), metres.
        """
        import shapely

        taken = [shapely.box(*part.low[:2], *part.high[:2]) for part in self.obstacles]
        left = shapely.buffer(self.ground.difference(shapely.union_all(taken)), -clearance, join_style="mitre")
        return [list(ring.coords[:-1]) for ring in shapely.get_parts(shapely.boundary(left))]

    @cached_property
    def carriers(self) -> tuple[Surface, ...]:
        """Surfaces that may carry landmarks: walls in the order of `surfaces`, then faces of obstacles."""
        built = [name for name in self._faces if not name.startswith("obstacle_")]
        names = list(self.surfaces if self.surfaces is not None else built)
        names += [
            f"obstacle_{i}_{face}" for i, part in enumerate(self.obstacles) for face in FACES if face in part.faces
        ]
        return tuple(self._carrier(self._faces[name]) for name in names)

    def _carrier(self, face: Surface) -> Surface:
        """Copy of the surface `face` with the region in which landmarks are allowed."""
        taken = [_covered(face, obstacle) for obstacle in self.obstacles]
        taken += [part.region(face) for part in self.keep_out if part.surface == face.name]
        region = free_of(face, self._region(face), self.margin, self.band, taken)
        if region.is_empty:
            raise InputError(
                f"surfaces: nothing may hang on {face.name}: its keep_out, band, margin and the objects in front of it "
                "leave no free part.",
                "surfaces",
            )
        return face.where(region)

    def _region(self, face: Surface) -> Any:
        """Part of a surface's rectangle that is inside the room, a shapely polygon in coordinates (a, b), metres.

        For a face of an obstacle, this is the part in front of which the room has free space.
        """
        import shapely

        along, up = face.extent
        if face.name in ("floor", "ceiling"):
            return shapely.transform(self.ground, lambda at: at - face.origin[:2])
        if not face.name.startswith("obstacle_"):
            return shapely.box(0.0, 0.0, along, up)
        before = face.origin + FREE_BEFORE_M * face.normal
        if face.normal[2] != 0.0:
            return shapely.box(0.0, 0.0, along, up) if 0.0 <= before[2] <= self.height else shapely.Polygon()
        free = self.ground.intersection(shapely.LineString([before[:2], before[:2] + along * face.u[:2]]))
        parts = [np.array(part.coords) for part in shapely.get_parts(free) if not part.is_empty]
        ends = [np.sort((part - before[:2]) @ face.u[:2]) for part in parts]
        return polygons(shapely.union_all([shapely.box(line[0], 0.0, line[-1], up) for line in ends]))


def _covered(face: Surface, obstacle: Obstacle) -> Any:
    """Part of a face that an obstacle covers by touching the face: a shapely polygon, possibly empty.

    The polygon has the coordinates (a, b) of the face, metres.
    """
    import shapely

    corners = obstacle.corners() - face.origin
    depth = corners @ face.normal
    touching = corners[depth <= PLACEMENT_TOLERANCE]
    if not len(touching) or depth.max() <= PLACEMENT_TOLERANCE:
        return shapely.Polygon()
    a, b = touching @ face.u, touching @ face.v
    return shapely.box(a.min(), b.min(), a.max(), b.max())

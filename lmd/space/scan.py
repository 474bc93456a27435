"""Room from a triangle mesh: surfaces for landmarks, free space and obstacles."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import (
    BoolArray,
    Checked,
    FloatArray,
    InputError,
    IntArray,
    NotNegative,
    Positive,
    span,
)
from lmd.space.allowed import eroded, polygons, spread, trapezoids
from lmd.space.fixture import Fixture
from lmd.space.mesh import (
    LEVEL_NORMAL_Z,
    STOREY,
    UNEVEN,
    Interior,
    Mesh,
    areas_of,
    doubt_of,
    flat_parts,
    grown,
    plane_of,
    standing_on,
    surface_of,
)
from lmd.space.parts import KeepOut, all_made, check_surfaces, checked_names
from lmd.space.surface import PLACEMENT_TOLERANCE, Surface, free_of
from lmd.space.triangles import Triangles, unit_normals

# An object is a wall if it spans the first share of the room's height, and floor or ceiling if it covers the second
# share of the room's area.
WALL, GROUND = 0.9, 0.5
# Relative rounding of the coordinates of a file.
FILE_ROUNDING = 1e-5
# Objects within this distance in front of a surface exclude landmarks, metres.
FREE_BEFORE_M = 0.01
# The front of a patch is the side with more clear lines to camera positions. For this test: number of points on the
# patch, their distance from the patch, metres, and number of camera positions.
PLACES, AWAY, WITNESSES = 9, 1e-3, 300
# Least angle between faces at a drawn edge, rad, and maximum number of drawn edges.
CREASE, MOST_EDGES = 0.35, 5000


@dataclass(frozen=True)
class Scan(Checked):
    """Room from a triangle mesh, such as a scan or a CAD model, in the coordinates of the file rotated to z up.

    Surfaces are planar patches: adjacent coplanar triangles of one object into which a square of `least_area` fits. A
    patch has the name of its object; if the object has several patches, `_0`, `_1`, ... follow in the order of
    decreasing area. Patches of objects without a name are `patch_0`, `patch_1`, ... All triangles block lines of sight
    from both sides.

    Raises:
        InputError: no patch is large enough, a name is unknown, a keep-out reaches beyond its patch, or the up axis is
            ambiguous.
    """

    mesh: Mesh
    """Mesh with z up; `lmd.formats.meshes.read_mesh` reads a mesh from a file."""
    least_area: Positive = 0.1
    """Area of an upright square, square metres; a patch into which this square does not fit carries no landmarks."""
    surfaces: Sequence[str] | None = None
    """Names of the patches that may carry landmarks; None for all."""
    keep_out: Annotated[Sequence[Any], partial(all_made, kind=KeepOut)] = ()
    """Parts of patches without landmarks: `KeepOut`s, or mappings of their arguments, measured from the edges of the
    rectangle around the patch.
    """
    band: Annotated[Sequence[float], partial(span, point=False)] | None = None
    """Lowest and highest z of landmarks on upright patches, metres; None for all heights."""
    margin: NotNegative = 0.0
    """Distance of landmarks from the edges of a patch along its u and v, metres."""

    def _validate(self) -> None:
        if not self._patches:
            raise InputError(
                f"least_area = {self.least_area:g} m2 is more than any planar patch of {self.mesh.path!r} has.",
                "least_area",
            )
        if not self.mesh.up_is_sure and (doubt := doubt_of(self.mesh, undecided=True)):
            raise InputError(f"up must be given for {self.mesh.path!r}: {doubt}", "up")
        if self.surfaces is not None:
            object.__setattr__(self, "surfaces", checked_names("surfaces", self.surfaces, list(self._patches)))
        check_surfaces(self.keep_out, list(self._patches))
        for i, part in enumerate(self.keep_out):
            corners = self._corners[self._patches[part.surface]]
            part.check_on(f"keep_out[{i}]", surface_of("", corners, plane_of(corners)[0]).extent)

    @property
    def doubt(self) -> str | None:
        """Sentence with the evidence that the axis `Mesh.up` of the file does not point up; None without evidence."""
        return doubt_of(self.mesh, undecided=False)

    @cached_property
    def triangles(self) -> Triangles:
        """All triangles of the mesh, as obstacles to lines of sight.

        The tolerance of the triangles, see `Triangles`, is greater than the unevenness of any patch.
        """
        uneven = [plane_of(self._corners[part])[1] for part in self._patches.values()]
        return Triangles.of(self.mesh.vertices, self.mesh.faces, PLACEMENT_TOLERANCE + max(uneven))

    @cached_property
    def solids(self) -> Triangles | None:
        """Triangles from which the camera keeps its clearance: all triangles except floor and ceiling.

        The result is None if there are no other triangles.
        """
        z, (low, high) = self._corners[..., 2], self.bounds
        level = np.abs(unit_normals(self._corners)[:, 2]) > LEVEL_NORMAL_Z
        ends = (z.max(axis=1) < low[2] + STOREY) | (z.min(axis=1) > high[2] - STOREY)
        faces = self.mesh.faces[~(level & ends)]
        return Triangles.of(self.mesh.vertices, faces, self.triangles.tolerance) if len(faces) else None

    @cached_property
    def interior(self) -> Interior:
        """Free space of the mesh, a graph that determines the points inside the room, see `Interior`."""
        return Interior(self.triangles, *self.bounds)

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of the box around the mesh, `(3,)` each."""
        return self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)

    @cached_property
    def _corners(self) -> FloatArray:
        return self.mesh.vertices[self.mesh.faces]

    @cached_property
    def _flat(self) -> list[IntArray]:
        return flat_parts(self.mesh)

    @property
    def _half_edge(self) -> float:
        """Half the edge of the square of `least_area`, metres."""
        return float(np.sqrt(self.least_area)) / 2.0 * (1.0 - FILE_ROUNDING)

    @cached_property
    def _patches(self) -> dict[str, IntArray]:
        """Indices of the triangles of each patch that is large enough, by name, largest area first."""
        chosen = []
        for part in self._flat:
            corners = self._corners[part]
            if areas_of(corners).sum() < self.least_area * (1.0 - FILE_ROUNDING):
                break  # all further parts are smaller
            normal, uneven = plane_of(corners)
            if uneven <= UNEVEN:
                surface = surface_of("", corners, normal)
                if not eroded(_shape(surface), self._half_edge).is_empty:
                    chosen.append(part)
        objects = [int(self.mesh.of[part[0]]) for part in chosen]
        named: dict[str, IntArray] = {}
        for i, (part, number) in enumerate(zip(chosen, objects, strict=True)):
            name, rank = self.mesh.names[number] or "patch", objects[:i].count(number)
            named[name if objects.count(number) == 1 and name != "patch" else f"{name}_{rank}"] = part
        return named

    def carriers(self, positions: FloatArray) -> tuple[Surface, ...]:
        """Surfaces that may carry landmarks, facing the side that is visible from most of `positions` `(P, 3)`.

        Patches that are not visible or have no allowed region are omitted.

        Raises:
            InputError: a patch listed in `surfaces` would be omitted, or no patch remains.
        """
        chosen = positions[np.unique(np.linspace(0, len(positions) - 1, WITNESSES).astype(int))]
        carriers = []
        for name in self.surfaces or self._patches:
            surface = self._facing(name, chosen)
            region = None if surface is None else self._free(surface)
            if surface is not None and region is not None:
                carriers.append(surface.where(region))
            elif self.surfaces is not None:
                why = "is seen from no position of the camera" if surface is None else "has no free place for tags"
                raise InputError(f"surfaces: {name} {why}.", "surfaces")
        if not carriers:
            raise InputError("surfaces: no patch is both visible from a camera position and free for tags.", "surfaces")
        return tuple(carriers)

    def _facing(self, name: str, positions: FloatArray) -> Surface | None:
        """Surface of a patch, facing the side that is visible from more of the `positions` `(P, 3)`.

        None if neither side is visible from any of the positions.
        """
        corners = self._corners[self._patches[name]]
        normal, _ = plane_of(corners)
        surface = surface_of(name, corners, normal)
        places = np.array([surface.point(*at) for at in surface.grid(PLACES)])
        front, back = (
            int(self.triangles.clear(positions[:, None], places + AWAY * way).sum()) for way in (normal, 0.0 - normal)
        )
        if not front and not back:
            return None
        return surface if front >= back else surface_of(name, corners, 0.0 - normal)

    def _free(self, surface: Surface) -> Any:
        """Allowed region of a patch; None if the region has no place for a square of the area `least_area`."""
        standing = standing_on(surface, np.delete(self._corners, self._patches[surface.name], axis=0), FREE_BEFORE_M)
        taken = [_area_of(standing), *(part.region(surface) for part in self._kept_out(surface))]
        region = self._inside(surface, free_of(surface, _shape(surface), self.margin, self.band, taken), standing)
        return None if eroded(region, self._half_edge).is_empty else region

    def _kept_out(self, surface: Surface) -> list[KeepOut]:
        return [part for part in self.keep_out if part.surface == surface.name]

    def _inside(self, surface: Surface, region: Any, standing: Sequence[Any]) -> Any:
        """Part of a patch's allowed region that borders on the inside of the room.

        Parts below the floor, beyond a wall or in furniture are excluded. Triangles that stand on the patch at a right
        angle divide the region into cells. A cell is inside the room if any of its points is inside, as no triangle
        crosses a cell. Strips narrower than 2 `FREE_BEFORE_M` are ignored.
        """
        import shapely

        lines = [shape for shape in standing if shape.geom_type == "LineString"]
        divided = region.difference(shapely.union_all(grown(lines, PLACEMENT_TOLERANCE)))
        outside = []
        for cell in shapely.get_parts(polygons(grown(divided, -FREE_BEFORE_M))):
            pieces = trapezoids(cell)
            places = surface.point(*spread(pieces, np.full((len(pieces), 2), 0.5)).T) + AWAY * surface.normal
            if not self.interior.contains(places).any():
                outside.append(grown(cell, FREE_BEFORE_M))
        return polygons(region.difference(shapely.union_all(outside))) if outside else region

    @cached_property
    def faces(self) -> tuple[Surface, ...]:
        """Surfaces of all planar parts of the mesh, two for each part: one for each of its sides."""
        found = []
        for part in self._flat:
            corners = self._corners[part]
            normal, _ = plane_of(corners)
            found += [surface_of("", corners, way) for way in (normal, 0.0 - normal)]
        return tuple(found)

    @cached_property
    def edges(self) -> FloatArray:
        """Edges of the mesh for drawings, `(M, 2, 3)`: sharp edges, and edges of only one triangle.

        At most the `MOST_EDGES` longest edges are returned.
        """
        triangles, corners = self.triangles, self.triangles.corners
        ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)
        turn = (triangles.beyond * triangles.normals[:, None]).sum(axis=-1).reshape(-1)
        drawn = ends[turn < np.cos(CREASE)]
        drawn = np.unique(np.sort(drawn.view([("", float)] * 3), axis=1).view(float).reshape(-1, 6), axis=0)
        drawn = drawn.reshape(-1, 2, 3)
        length = np.linalg.norm(drawn[:, 1] - drawn[:, 0], axis=1)
        return np.asarray(drawn[np.sort(np.argsort(-length, kind="stable")[:MOST_EDGES])])

    def fixtures(self, surfaces: Sequence[Surface]) -> list[Fixture]:
        """Fixtures: the named objects of the file, except floor, ceiling and walls; and the keep-outs on `surfaces`.

        An object is a wall if its height is at least the fraction `WALL` of the room's height. An object is floor or
        ceiling if it covers at least the fraction `GROUND` of the room's bounding rectangle.
        """
        low, high = self.bounds
        found = []
        order = np.argsort(self.mesh.of, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(self.mesh.of[order])) + 1):
            name, corners = self.mesh.names[self.mesh.of[part[0]]], np.unique(self.mesh.faces[part])
            thing = Fixture(name, self.mesh.vertices[corners])
            height, ground = np.ptp(thing.corners[:, 2]) / (high - low)[2], np.prod((high - low)[:2])
            if name and height < WALL and thing.footprint.area < GROUND * ground:
                found.append(thing)
        parts = [part for surface in surfaces for part in self._kept_out(surface)]
        return found + [
            Fixture(part.name or f"keep_out {self.keep_out.index(part)}", corners)
            for part, corners in zip(parts, self.kept_out(surfaces), strict=True)
        ]

    def kept_out(self, surfaces: Sequence[Surface]) -> list[FloatArray]:
        """Vertices of the keep-outs on surfaces, world frame, metres, `(N, 3)` each."""
        return [surface.point(*part.ring.T) for surface in surfaces for part in self._kept_out(surface)]

    def keeps_away(self, points: FloatArray, clearance: float) -> BoolArray:
        """Mask of the points `(..., 3)` that are at least `clearance`, metres, from walls and objects, `(...)`."""
        if self.solids is None or not clearance:
            return np.ones(points.shape[:-1], dtype=np.bool_)
        return self.solids.distance(points, clearance) >= clearance - PLACEMENT_TOLERANCE


def _area_of(shapes: Sequence[Any]) -> Any:
    import shapely

    return polygons(shapely.union_all([shape for shape in shapes if shape.geom_type == "Polygon"]))


def _shape(surface: Surface) -> Any:
    import shapely

    return shapely.box(0.0, 0.0, *surface.extent) if surface.allowed is None else surface.allowed

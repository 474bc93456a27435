"""Body of a robot: boxes whose faces may carry cameras. The body may fill only a limited part of a camera's image.

Coordinates are in the body frame of `lmd.scene.rig`: x forward, y to the left, z up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np

from lmd.core.checks import BoolArray, Checked, FloatArray, InputError, NotNegative, Point, Positive, Share
from lmd.space.parts import KeepOut, all_made, check_surfaces, checked_names
from lmd.space.surface import Surface, free_of

FACES = ("front", "back", "left", "right", "top", "bottom")
# Outward unit normals of the faces, in the order of `FACES`.
NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


@dataclass(frozen=True)
class Box(Checked):
    """Axis-aligned box of the body.

    Args:
        low, high: opposite corners, body frame, metres.
        faces: those of the `FACES` that may carry cameras; empty for a box that carries no camera and only blocks the
            view.
        name: name of the box, which precedes the names of its faces, as in `mast_front`; empty for faces with names
            like `front`.

    Raises:
        InputError: the box is empty, or `faces` has an unknown name.
    """

    low: Point
    high: Point
    faces: Sequence[str] = ("front", "back", "left", "right", "top")
    name: str = ""

    def _validate(self) -> None:
        if any(a >= b for a, b in zip(self.low, self.high, strict=True)):
            raise InputError(f"low = {list(self.low)} must be below high = {list(self.high)}.", "low")
        object.__setattr__(self, "faces", checked_names("faces", self.faces, FACES) if self.faces else ())

    def surfaces(self) -> list[Surface]:
        """Faces of the box that may carry cameras, as whole rectangles.

        A face has two axes u and v. Seen from outside the box, u points to the right and v up; on the top and the
        bottom face, v points forward.
        """
        found = []
        for face in self.faces:
            normal = NORMALS[FACES.index(face)]
            up = np.array([1.0, 0.0, 0.0]) if normal[2] else np.array([0.0, 0.0, 1.0])
            right = np.cross(up, normal)
            low, high = np.array(self.low), np.array(self.high)
            origin = np.where(normal + up + right > 0.0, low, high)
            origin = np.where(normal > 0.0, high, np.where(normal < 0.0, low, origin))
            extent = tuple(abs(float(axis @ (high - low))) for axis in (right, up))
            name = f"{self.name}_{face}" if self.name else face
            found.append(Surface(name, origin, right, up, normal, extent))  # type: ignore[arg-type] # two numbers
        return found


@dataclass(frozen=True)
class Body(Checked):
    """Body of a robot that carries cameras.

    Args:
        boxes: boxes of the body, `Box` or mappings of its arguments.
        keep_out: regions of faces that must stay free of cameras, `KeepOut` or mappings of its arguments.
        margin: least distance of a camera's centre from the edges of its face, metres.
        standoff: distance of a camera's centre from its face, metres.
        own_share: greatest fraction of a camera's image that may show the body.

    Raises:
        InputError: a value is out of range, no face may carry a camera, or two faces have one name.
    """

    boxes: Annotated[Sequence[Box | Mapping[str, Any]], partial(all_made, kind=Box)]
    keep_out: Annotated[Sequence[KeepOut | Mapping[str, Any]], partial(all_made, kind=KeepOut)] = ()
    margin: NotNegative = 0.02
    standoff: Positive = 0.02
    own_share: Share = 0.0

    def _validate(self) -> None:
        names = [face.name for box in self._boxes for face in box.surfaces()]
        if not names:
            raise InputError("boxes must have a face that may carry cameras.", "boxes")
        if len(set(names)) < len(names):
            raise InputError("boxes have two faces of the same name; give each box a name of its own.", "boxes")
        check_surfaces(self._keep_outs, names)
        self.surfaces()

    @property
    def _boxes(self) -> tuple[Box, ...]:
        return self.boxes  # type: ignore[return-value] # made so

    @property
    def _keep_outs(self) -> tuple[KeepOut, ...]:
        return self.keep_out  # type: ignore[return-value] # made so

    @cached_property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Two opposite corners of each of the B boxes, body frame, metres, `(B, 3)` each: with the least coordinates,
        and with the greatest.
        """
        return np.array([box.low for box in self._boxes]), np.array([box.high for box in self._boxes])

    def surfaces(self) -> tuple[Surface, ...]:
        """Faces that may carry cameras, each reduced to the regions where a camera may be.

        Faces without such a region are omitted.

        Raises:
            InputError: no face has an allowed region.
        """
        return self._surfaces

    @cached_property
    def _surfaces(self) -> tuple[Surface, ...]:
        import shapely

        left = []
        for face in (face for box in self._boxes for face in box.surfaces()):
            for i, part in enumerate(self._keep_outs):
                if part.surface == face.name:
                    part.check_on(f"keep_out[{i}]", face.extent)
            taken = [part.region(face) for part in self._keep_outs if part.surface == face.name]
            free = free_of(face, shapely.box(0.0, 0.0, *face.extent), self.margin, None, taken)
            if not free.is_empty:
                left.append(face.where(free))
        if not left:
            raise InputError("boxes have no face with a place for a camera; reduce margin or keep_out.", "boxes")
        return tuple(left)

    def own_part(self, centre: FloatArray, rays: FloatArray) -> float:
        """Fraction of R rays from a camera's centre that hit the body; 1 if the centre is inside the body.

        Args:
            centre: the camera's centre, body frame, metres, `(3,)`.
            rays: directions of the rays, body frame, `(R, 3)`.
        """
        low, high = self.corners
        if ((centre > low) & (centre < high)).all(axis=1).any():
            return 1.0
        return float(self._met(centre, rays).mean())

    def _met(self, centre: FloatArray, rays: FloatArray) -> BoolArray:
        """Mask `(R,)` of the rays that hit a box of the body."""
        low, high = self.corners
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack([(low - centre) / rays[:, None], (high - centre) / rays[:, None]])
        # A ray within the plane of a face (0 / 0) does not hit the face.
        enters, leaves = (np.nan_to_num(of, nan=0.0) for of in (ends.min(axis=0), ends.max(axis=0)))
        return np.asarray(((leaves.min(axis=-1) > enters.max(axis=-1)) & (leaves.min(axis=-1) > 0.0)).any(axis=1))

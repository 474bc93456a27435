"""Admissible mounts of cameras on a body, and their encoding as genes, numbers in [0, 1] that optimisers vary.

A mount is a camera and its pose in the body frame. Mounts are rounded to whole millimetres and milliradians, so the
mount in a file is exactly the mount that was evaluated.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated

import numpy as np

from lmd.cameras.body import Body
from lmd.core.checks import Checked, FloatArray, InputError, NotNegative, integer, span
from lmd.geometry.camera import Camera
from lmd.geometry.projection import bearings
from lmd.scene.rig import Mount, Rig
from lmd.space.surface import SurfaceArrays

DECIMALS = 3  # number of decimals of positions, metres, and angles, radians
IMAGE_SAMPLES = (17, 13)  # pixels sampled along width and height of an image to measure the share of the body
TURN_STEPS = 8  # number of equal steps by which a camera is turned if it sees too much of the body
GIVEN_TOLERANCE = 0.0016  # greatest accepted deviation of a given mount from its encoding, metres and rad
DRAWS_PER_CAMERA = 200  # greatest number of random mounts drawn for each camera
QUARTER_TURN = math.pi / 2.0
HALF_TURN = {"low": -math.pi - 0.01, "high": math.pi + 0.01}  # bounds of an angle, rad, with a margin for rounding


@dataclass(frozen=True)
class MountSpace(Checked):
    """Search space for the mounts of `count` cameras on the faces of a body, with limits on the cameras' angles.

    A camera in whose image the body would fill more than `Body.own_share` is turned in steps towards the normal of its
    face.

    Args:
        body: body that carries the cameras.
        lenses: kinds of cameras (intrinsics and lens); each camera may be of any of these kinds.
        count: number of cameras.
        yaw: least and greatest yaw from the normal of a side face, positive to the left, rad; on the top and the bottom
            face the yaw is not limited.
        pitch: least and greatest pitch, positive down as for `Mount`, rad.
        roll: least and greatest roll, rad.
        apart: least distance between the centres of two cameras, metres.

    Raises:
        InputError: a value is out of range.
    """

    body: Body
    lenses: Sequence[Camera]
    count: Annotated[int, partial(integer, low=1, high=64)] = 2
    yaw: Annotated[Sequence[float], partial(span, **HALF_TURN)] = (-QUARTER_TURN, QUARTER_TURN)
    pitch: Annotated[Sequence[float], partial(span, low=-QUARTER_TURN - 0.01, high=QUARTER_TURN + 0.01)] = (-0.8, 0.8)
    roll: Annotated[Sequence[float], partial(span, **HALF_TURN)] = (0.0, 0.0)
    apart: NotNegative = 0.08
    _rays: dict[Camera, FloatArray] = field(default_factory=dict, init=False, compare=False, repr=False)

    def _validate(self) -> None:
        if not self.lenses:
            raise InputError("lenses must have at least one camera, got none.", "lenses")

    @cached_property
    def _surfaces(self) -> SurfaceArrays:
        return SurfaceArrays.of(self.body.surfaces())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the G genes of one camera: `along`, `up` (place on the body), `yaw`, `pitch`, `roll` and `lens`.

        Of `pitch`, `roll` and `lens` (the kind of the camera), those with only one possible value are left out.
        """
        turns = tuple(name for name in ("yaw", "pitch", "roll") if np.ptp(getattr(self, name)) or name == "yaw")
        return ("along", "up", *turns, *(("lens",) if len(self.lenses) > 1 else ()))

    def mount(self, genes: FloatArray) -> Mount | None:
        """Decode the genes `(G,)` in [0, 1] of one camera; None if the body still fills too much of the camera's image
        after all steps of turning the camera.
        """
        s, of = self._surfaces, dict(zip(self.names, genes.tolist(), strict=True))
        edges = np.append(0.0, s.shares)
        piece = int(np.clip(np.searchsorted(edges, of["along"], side="right") - 1, 0, len(s.shares) - 1))
        along = (of["along"] - edges[piece]) / (edges[piece + 1] - edges[piece])
        surface = s.of_piece[piece]
        at = s.spread(np.array([piece]), np.array([[np.clip(along, 0.0, 1.0), of["up"]]]))
        normal = s.normal[surface]
        place = s.points(np.array([surface]), at)[0] + self.body.standoff * normal
        camera = self.lenses[min(int(of.get("lens", 0.0) * len(self.lenses)), len(self.lenses) - 1)]
        pitch, roll = (_within(getattr(self, name), of.get(name, 0.0)) for name in ("pitch", "roll"))
        if abs(normal[2]) > 0.5:  # top or bottom
            yaw, ahead = _within((-math.pi, math.pi), of["yaw"]), None
            level = self.pitch[0] if normal[2] > 0.0 else self.pitch[1]
        else:
            ahead = math.atan2(normal[1], normal[0])
            yaw = _within(self.yaw, of["yaw"])
            level = _nearest(0.0, self.pitch)
        for step in range(TURN_STEPS + 1):
            left = 1.0 - step / TURN_STEPS
            turn = yaw if ahead is None else ahead + _between(_nearest(0.0, self.yaw), yaw, left)
            mount = rounded(camera, place, turn, _between(level, pitch, left), roll)
            if self.own_part(mount) <= self.body.own_share:
                return mount
        return None

    def mounts(self, genes: FloatArray) -> tuple[Mount, ...] | None:
        """Decode the genes `(count, G)` of all cameras; None if a camera is not admissible, or two cameras are closer
        than `apart`.
        """
        found = [self.mount(row) for row in genes]
        mounts = tuple(mount for mount in found if mount is not None)
        return mounts if len(mounts) == len(found) and self.are_apart(mounts) else None

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Genes `(count, G)` of random admissible cameras.

        Raises:
            InputError: no admissible cameras were found.
        """
        genes, mounts = [], list[Mount]()
        for _ in range(DRAWS_PER_CAMERA * self.count):
            row = rng.random(len(self.names))
            mount = self.mount(row)
            if mount is not None and self.are_apart([*mounts, mount]):
                genes.append(row)
                mounts.append(mount)
            if len(genes) == self.count:
                return np.stack(genes)
        raise InputError(
            f"count = {self.count} cameras do not fit on the body: they must be at least {self.apart:g} m apart and "
            "must not see the body.",
            "count",
        )

    def are_apart(self, mounts: Sequence[Mount]) -> bool:
        """True if the centres of every two cameras are at least `apart` from each other."""
        at = np.array([mount.translation for mount in mounts])
        distance = np.linalg.norm(at[:, None] - at, axis=-1)[np.triu_indices(len(at), 1)]
        return bool((distance >= self.apart).all())

    def own_part(self, mount: Mount) -> float:
        """Fraction of a camera's image that shows the body, estimated from a sample of pixels."""
        if mount.camera not in self._rays:
            self._rays[mount.camera] = _rays_of(mount.camera)
        return self.body.own_part(np.array(mount.translation), self._rays[mount.camera] @ mount.rotation.T)

    def genes(self, rig: Rig) -> FloatArray:
        """Encode the cameras of a rig as genes `(count, G)`.

        Raises:
            InputError: the rig has another number of cameras, or a mount is not admissible.
        """
        if len(rig.mounts) != self.count:
            raise InputError(f"count = {self.count}, but the rig has {len(rig.mounts)} cameras.", "count")
        found = [self._nearest_genes(mount) for mount in rig.mounts]
        for i, (genes, mount) in enumerate(zip(found, rig.mounts, strict=True)):
            there = self.mount(genes)
            if there is None or not _alike(there, mount):
                raise InputError(
                    f"rig[{i}] is not a pose that the body allows, so the search cannot start from it.",
                    "rig",
                )
        return np.stack(found)

    def _nearest_genes(self, mount: Mount) -> FloatArray:
        """Genes `(G,)` of `mount` or, if it is outside the search space, of the nearest mount inside."""
        s, place = self._surfaces, np.array(mount.translation)
        foot = place - self.body.standoff * s.normal  # (W, 3)
        every = np.arange(len(foot))
        at = s.coordinates(every, foot)
        distance = np.linalg.norm(s.points(every, at) - foot, axis=-1)
        surface = int(distance.argmin())
        at, piece = s.nearest(np.array([surface]), at[surface][None])
        along, up = s.gathered(piece, at)[0]
        edges = np.append(0.0, s.shares)
        first = edges[piece[0]] + np.clip(along, 1e-9, 1.0 - 1e-9) * (edges[piece[0] + 1] - edges[piece[0]])
        normal = s.normal[surface]
        flat = abs(normal[2]) > 0.5
        ahead, limits = (0.0, (-math.pi, math.pi)) if flat else (math.atan2(normal[1], normal[0]), self.yaw)
        angles = {"yaw": _turned(mount.yaw - ahead), "pitch": mount.pitch, "roll": mount.roll}
        of = {"along": first, "up": up, "lens": 0.0}
        for angle, value in angles.items():
            low, high = limits if angle == "yaw" else getattr(self, angle)
            of[angle] = float(np.clip((value - low) / (high - low), 0.0, 1.0)) if high > low else 0.5
        if mount.camera in self.lenses:
            of["lens"] = (list(self.lenses).index(mount.camera) + 0.5) / len(self.lenses)
        return np.array([of[gene] for gene in self.names])


def rounded(camera: Camera, place: FloatArray, yaw: float, pitch: float, roll: float) -> Mount:
    """Make a mount of a camera, with its pose in the body frame rounded to whole millimetres and milliradians."""
    yaw, pitch, roll = (round(value, DECIMALS) + 0.0 for value in (_turned(yaw), pitch, roll))
    return Mount(camera, tuple((np.round(place, DECIMALS) + 0.0).tolist()), yaw, pitch, roll)


def _alike(one: Mount, other: Mount) -> bool:
    """True if two mounts differ at most by the rounding to millimetres and milliradians."""
    away = np.abs(np.array(one.translation) - other.translation).max()
    return one.camera == other.camera and max(away, np.abs(one.rotation - other.rotation).max()) <= GIVEN_TOLERANCE


def _between(low: float, high: float, share: float) -> float:
    return low + share * (high - low)


def _nearest(value: float, limits: Sequence[float]) -> float:
    return min(max(value, limits[0]), limits[1])


def _within(limits: Sequence[float], gene: float) -> float:
    return _between(limits[0], limits[1], gene)


def _turned(angle: float) -> float:
    """Wrap an angle to [-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)


def _rays_of(camera: Camera) -> FloatArray:
    """Viewing directions of R sampled pixels of a camera, including pixels at the image borders, `(R, 3)`; the
    components point forward, to the left and up.
    """
    sizes = (camera.image_width, camera.image_height)
    u, v = (np.linspace(0.0, size, samples) for size, samples in zip(sizes, IMAGE_SAMPLES, strict=True))
    seen = bearings(camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    seen = seen[np.isfinite(seen).all(axis=1)]
    return np.stack([seen[:, 2], -seen[:, 0], -seen[:, 1]], axis=-1)

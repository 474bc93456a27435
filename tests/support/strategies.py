"""Strategies of the property tests: valid rooms, cameras, PDFs, visibility models and deployments."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from lmd.geometry.camera import Camera
from lmd.geometry.frames import optical_axis
from lmd.geometry.lens import Lens
from lmd.scene import pdf
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.scene.tag import FAMILIES, Tag
from lmd.sight.models.fiducial import Fiducial
from lmd.sight.models.limits import measured
from lmd.sight.models.paper import OCCLUSION_MODES, Visibility
from lmd.space.cuboid import Cuboid

yaws = st.floats(-math.pi, math.pi)
pitches = st.floats(-math.pi / 2, math.pi / 2)
unit_vectors = st.tuples(yaws, pitches).map(lambda angles: optical_axis(*angles))
points = st.tuples(*[st.floats(-10.0, 10.0)] * 3).map(np.array)
seeds = st.integers(0, 2**32 - 1)


@st.composite
def cameras(draw):
    focal_length = draw(st.floats(2.0, 12.0))
    width, height = (float(draw(st.integers(200, 2000))) for _ in range(2))
    centre = draw(st.sampled_from([(0.5, 0.5), (0.2, 0.6), (0.7, 0.9)]))
    return Camera(
        focal_length=focal_length,
        pixel_width=draw(st.sampled_from([0.002, 0.0058, 0.01])),
        pixel_height=draw(st.sampled_from([0.002, 0.0058, 0.01])),
        principal_point=(centre[0] * width, centre[1] * height),
        image_width=width,
        image_height=height,
        aperture=draw(st.one_of(st.just(0.0), st.floats(0.5, 10.0))),
        focus_distance=draw(st.one_of(st.just(math.inf), st.floats(200.0, 1e4))),
    )


@st.composite
def lenses(draw):
    """Of each model; some fold soon, some never."""
    if draw(st.booleans()):
        return Lens("equidistant", tuple(draw(st.floats(-0.1, 0.1)) for _ in range(4)))
    radial, small = st.floats(-0.5, 0.5), st.floats(-0.02, 0.02)
    kinds = (radial, radial, small, small, radial, radial, radial, radial, small, small, small, small)
    return Lens("plumb_bob", tuple(draw(kind) for kind in kinds[: draw(st.sampled_from([4, 5, 8, 12]))]))


FISHEYE = ("equidistant",)
BENT = ("plumb_bob", "rational_polynomial")


@st.composite
def distorted_cameras(draw, models=(*BENT, *FISHEYE)):
    """Barrels, pincushions, moustaches and prisms, the strongest of which nearly fold in the corners; and fisheyes."""
    camera, model = draw(cameras()), draw(st.sampled_from(models))
    lens, radius = [draw(st.floats(-1.0, 1.0)) for _ in range(12)], math.tan(camera.widest_angle)
    circle = draw(st.one_of(st.just(math.inf), st.floats(0.6, 2.2))) * min(camera.image_width, camera.image_height)
    if model == "equidistant":
        # Corners up to 150 degrees from the axis.
        angle = draw(st.floats(0.3, 2.6))
        shorter, sizes = angle / radius, [0.2 / ((2 * n + 1) * angle ** (2 * n)) for n in (1, 2, 3, 4)]
        sharper = {name: shorter * getattr(camera, name) for name in ("pixel_width", "pixel_height")}
        return replace(camera, distortion=_scaled(lens, sizes), distortion_model=model, image_circle=circle, **sharper)
    radial = 0.05 / radius**2, 0.025 / radius**4
    sizes = [*radial, 0.005 / radius, 0.005 / radius, 0.01 / radius**6]
    if model == "rational_polynomial":
        sizes += [*radial, 0.01 / radius**6, *(0.005 / radius, 0.005 / radius**3) * 2]
    bent = replace(camera, distortion=_scaled(lens, sizes), distortion_model=model)
    return replace(bent, image_circle=circle) if is_bent(bent) else bent  # a pinhole's image has no end


def is_bent(camera):
    """Return whether a camera has a lens that distorts, with at least one coefficient that is not zero."""
    return camera.lens is not None


def _scaled(numbers, sizes):
    return tuple(number * size for number, size in zip(numbers, sizes, strict=False))


@st.composite
def visibilities(draw):
    return Visibility(
        thold=draw(st.floats(0.05, 1.0)),
        # Boundaries are as far from a camera as nu: below 1e-150 m, the square of that is zero.
        nu=draw(st.one_of(st.sampled_from([0.0, 0.05, 0.1, 0.5]), st.floats(1e-6, 0.5))),
        occlusion=draw(st.sampled_from(OCCLUSION_MODES)),
        circle_of_confusion=draw(st.sampled_from([1.0, 4.0, 10.0])),
    )


@st.composite
def rooms(draw, spacings=(0.4, 0.7, 1.1), cells=3):
    """Rooms with a limited number of cells along an axis, which keeps a scene small."""
    size = draw(st.tuples(*[st.floats(1.0, 6.0)] * 3))
    shares = draw(st.tuples(*[st.sampled_from([0.1, 0.3, 1.0])] * 3))
    return Cuboid(
        size=size,
        reachable_size=tuple(s * share for s, share in zip(size, shares, strict=True)),
        spacing=tuple(
            max(draw(st.sampled_from(spacings)), s * share / cells) for s, share in zip(size, shares, strict=True)
        ),
        positions=draw(st.sampled_from(["cells", "vertices"])),
    )


@st.composite
def sampled_pdfs(draw):
    angles = draw(st.lists(st.tuples(yaws, pitches), min_size=1, max_size=30))
    weight = np.array([draw(st.floats(0.01, 1.0)) for _ in angles])
    return pdf.OrientationPdf(*np.array(angles).T, weight / weight.sum())


def pdfs_of(most):
    """PDFs with a limited number of divisions."""
    divisions = st.integers(4, most)
    return st.one_of(
        st.builds(pdf.grid_with_ends, divisions),
        st.builds(pdf.grid_of_cells, divisions),
        st.builds(pdf.solid_angle, divisions),
        st.builds(pdf.level_flight, divisions, pitch=pitches),
        sampled_pdfs(),
    )


pdfs = pdfs_of(6)


@st.composite
def rolled_pdfs(draw, kinds=pdfs):
    drawn = draw(kinds)
    roll = np.array([draw(st.floats(-math.pi, math.pi)) for _ in range(draw(st.integers(1, 3)))])
    return pdf.OrientationPdf(drawn.yaw, drawn.pitch, drawn.weight, roll=np.resize(roll, len(drawn.weight)))


@st.composite
def fiducials(draw):
    detector, family = draw(st.sampled_from(list(measured())))
    edge = draw(st.one_of(st.sampled_from([0.05, 0.1, 0.3]), st.floats(0.05, 0.3)))
    tag = Tag(edge, family if family in FAMILIES else f"{family}_50", draw(st.sampled_from([0.0, 1.0, 2.0])))
    return Fiducial(
        tag, detector, psf_sigma=draw(st.sampled_from([0.0, 0.5, 2.0])), motion_blur=draw(st.sampled_from([0.0, 3.0]))
    )


def fiducial_scenes(camera=st.one_of(cameras(), distorted_cameras())):  # noqa: B008
    return st.builds(Scene, rooms(), camera, rolled_pdfs(), fiducials())


def scenes(room=rooms(), visibility=visibilities()):  # noqa: B008
    return st.builds(Scene, room, cameras(), pdfs, visibility)


@st.composite
def flush_deployments(draw, room, most=12, least=1):
    return RandomDeployment(draw(st.integers(least, most))).draw(room, np.random.default_rng(draw(seeds)))


@st.composite
def free_deployments(draw, room, most=12, least=1):
    """Landmarks anywhere in the room with any normal; some coincide, some sit on a camera position."""
    count, (low, high) = draw(st.integers(least, most)), room.bounds()
    rng = np.random.default_rng(draw(seeds))
    positions = rng.uniform(low, high, (count, 3))
    outside = ~room.contains(positions)
    positions[outside] = RandomDeployment(count).draw(room, rng).positions[outside]
    normals = rng.normal(size=(count, 3))
    grid = room.grid()
    for k in range(count):
        match draw(st.sampled_from(["anywhere", "anywhere", "coincident", "near", "at a camera", "facing one"])):
            case "coincident":
                positions[k] = positions[rng.integers(count)]
            case "near":
                near = np.clip(positions[rng.integers(count)] + rng.normal(scale=0.1, size=3), low, high)
                positions[k] = near if room.contains(near) else positions[k]
            case "at a camera":
                positions[k] = grid[rng.integers(len(grid))]
            case "facing one":
                normals[k] = grid[rng.integers(len(grid))] - positions[k] + 1e-9
    return Deployment(positions, normals / np.linalg.norm(normals, axis=1, keepdims=True))


def deployments(room, most=12, least=1):
    return st.one_of(flush_deployments(room, most, least), free_deployments(room, most, least))


@st.composite
def scenes_with_deployments(draw, **parts):
    scene = draw(scenes(**parts))
    return scene, draw(deployments(scene.room))


def _perpendicular(axis, towards):
    side = towards - (towards @ axis) * axis
    length = np.linalg.norm(side)
    return side / length if length > 1e-6 else _perpendicular(axis, np.roll(towards, 1) + axis[::-1])


@st.composite
def scenes_with_boundary_landmarks(draw):
    """Landmarks exactly on a limit of the coverage of some grid position and axis, nudged by some rounding errors."""
    scene = draw(scenes())
    camera, visibility, limits = scene.camera, scene.visibility, scene.sight
    near, far = camera.depth_of_field(visibility.circle_of_confusion)
    deepest = min(camera.resolution_depth(visibility.thold), far)
    grid, axes = scene.room.grid(), scene.pdf.axes
    positions, normals = [], []
    for _ in range(draw(st.integers(1, 5))):
        here, axis = draw(st.sampled_from(list(grid))), draw(st.sampled_from(list(axes)))
        side = _perpendicular(axis, draw(st.one_of(unit_vectors, st.just(np.array([0.0, 0.0, 1.0])))))
        angle = draw(st.sampled_from([0.0, 0.5, 1.0, 1.0])) * camera.cone_half_angle
        if draw(st.booleans()):
            angle = math.acos(limits.min_cosine)
        depth = draw(st.sampled_from([near, deepest, limits.min_depth, limits.max_depth, (near + deepest) / 2.0]))
        depth *= 1.0 + draw(st.integers(-2, 2)) * 2.0**-52
        sight = math.cos(angle) * axis + math.sin(angle) * side
        offset = sight * depth / draw(st.sampled_from([math.cos(angle), 1.0]))
        facing, across = -sight, _perpendicular(sight, side + axis)
        positions.append(here + offset)
        normals.append(draw(st.sampled_from([facing, facing, across, -across])))
        if draw(st.booleans()):  # a second landmark exactly nu from the line of sight, or on top of the first
            along = draw(st.sampled_from([0.5, 1.0, 1.0 + 2.0**-32, 1.0 + 2.0**-29, 1.5, -1.0, 0.0]))
            positions.append(here + along * offset + draw(st.sampled_from([visibility.nu, 0.0])) * across)
            normals.append(facing)
    normals = np.array(normals)
    return scene, Deployment(np.array(positions), normals / np.linalg.norm(normals, axis=1, keepdims=True))


angles = st.one_of(st.sampled_from([0.0, math.pi / 2, math.pi]), st.floats(-math.pi, math.pi))
translations = st.one_of(st.just((0.0, 0.0, 0.0)), st.just((0.0, 0.0, 0.2)), st.tuples(*[st.floats(-0.5, 0.5)] * 3))


@st.composite
def mounts(draw, kinds):
    camera, translation = draw(st.sampled_from(kinds)), draw(translations)
    if draw(st.booleans()):
        return Mount(camera, translation, draw(angles), draw(angles), draw(angles))
    quaternion = np.random.default_rng(draw(st.integers(0, 99))).normal(size=4)
    return Mount(camera, translation, quaternion=quaternion / np.linalg.norm(quaternion))


@st.composite
def rigs(draw, any_camera=cameras()):  # noqa: B008
    """Rigs of two or three cameras of two kinds: for another number of kinds much would be compiled anew."""
    found = draw(st.lists(any_camera, min_size=2, max_size=2, unique=True))
    each = tuple(draw(mounts([camera])) for camera in found)
    return Rig(each + tuple(draw(st.lists(mounts(found), max_size=1))))


def with_probabilities(scene, seed):
    """The scene with probabilities that `seed` and a position decide; some orientations never occur somewhere."""
    size = len(scene.pdf.weight)

    def at(positions):
        rows = []
        for position in np.asarray(positions):
            rng = np.random.default_rng([seed, *(np.abs(position) * 1e6).astype(np.uint64)])
            row = rng.random(size) * (rng.random(size) < 0.7) + 1e-3 * (np.arange(size) == rng.integers(size))
            rows.append(row / row.sum())
        return np.array(rows)

    return replace(scene, pdf=replace(scene.pdf, by_position=at, continuous=None, refine=None))

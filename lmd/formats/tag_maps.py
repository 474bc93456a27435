"""Reader that turns tag maps of several ecosystems into deployments; and the joint covariance of a surveyed map.

`tables/tag_map.yaml` lists the formats; `lmd.export` writes tag maps. Errors of neighbouring tags in a surveyed map are
correlated, so the covariances of single tags in `map.csv` misstate the effect of the map's errors on a pose. The joint
covariance of all tags is in `map.npz` beside `map.csv`.

Source: `convert_apriltag_layouts.py` of WPILib.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import Checked, FloatArray, InputError, IntArray, Switch, said_of
from lmd.formats.keyed_tags import parameters_of
from lmd.formats.placed_tag import HALF_TURN, Found, PlacedTag, axes_of, check_family, one_family
from lmd.formats.registry import read
from lmd.formats.tag_tables import deployment_of
from lmd.formats.trees import File, Keys, arrays_of
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import POINT, ExistingDeployment
from lmd.scene.families import FAMILIES
from lmd.scene.labels import Labels
from lmd.scene.tag import Tag
from lmd.space.space import Space

FILE = "map.npz"
LARGEST_COVARIANCE = 1 << 30  # maximum size of a file of a covariance, bytes
LARGEST_MAP = 1 << 22  # maximum number of characters of YAML or JSON; a tag has a few hundred
SAME_POSITION = 1e-4  # difference of positions from which on two files are of different maps, metres
EDGE_DIGITS = 12  # number of decimals of an edge, metres; further digits are rounding errors of conversions
IS_JSON = re.compile(r"(?:\s++|//[^\n]*\n|/\*(?>.*?\*/))*+{", re.DOTALL)  # comments may precede the mapping
IS_YAML = re.compile(r"%YAML|---|(?!Unnamed: )\s*['\"]?[\w/*:]+['\"]?\s*:(?:\s|$)")


class TagMapFile(File):
    """File of a tag map, whose keys (`data`) are empty for a text that is neither YAML nor JSON, such as a table."""

    @cached_property
    def data(self) -> Keys:
        """Content of the map as a tree of keys and values; from a parameter file of ROS 2, only the parameters of its
        node.

        Raises:
            InputError: the text begins like YAML or JSON but is broken or too long.
        """
        if not (IS_JSON.match(self.text) or IS_YAML.match(self.first)):
            return {}
        if len(self.text) > LARGEST_MAP:
            raise InputError(f"a map has at most {LARGEST_MAP} characters, but this map has {len(self.text)}.")
        return parameters_of(super().data)


def read_deployment(
    path: Any,
    name: str = "path",
    family: str | None = None,
    axes: Sequence[str] | None = None,
    columns: str | Sequence[str] | None = None,
) -> Deployment:
    """Read the tags of a map, or the landmarks of a table, see `lmd.formats.tag_tables`.

    Tag sizes in the file become `Deployment.edges`.

    Args:
        path: path of the file.
        name: name of the argument that gave the path, for messages.
        family: family of the tags, which the file must not contradict; None for landmarks that are points. The upward
            direction of tags that OpenCV detects depends on the family.
        axes: directions, in words, of the axes x, y and z of a tag's frame, for a file that does not define this frame,
            such as a table; see `lmd.formats.placed_tag.axes_of`.
        columns: for a text that does not name its columns, names of the columns, or name of the program that wrote it.

    Raises:
        InputError: the file cannot be read, is not a map with poses of tags, or has tags of another family.
    """
    file = TagMapFile(path, name, asked={"axes": axes, "columns": columns})
    try:
        found: Found = read("tag map", file)
        if found.table is not None:
            deployment, families = deployment_of(found.table, axes)
            check_family(path, one_family(families), family)
            return deployment
        check_family(path, one_family(tag.family for tag in found.tags), family)
        if not found.tags:
            raise InputError("it has no tag with a position.")
        turned = found.by_opencv and family is not None and FAMILIES[family].apriltag
        tags = [tag._replace(axes=tag.axes @ HALF_TURN) for tag in found.tags] if turned else found.tags
        return _deployment(path, tags, found.note)
    except InputError as error:
        known = error.argument in (name, "axes", "columns") or str(path) in str(error)
        raise error if known else InputError(f"{path}: {error}") from None
    except KeyError as error:
        raise InputError(f"{path}: the key {error} is missing.") from None
    except (IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"{path}: one of its values has the wrong type ({error}).") from None


def _deployment(path: Any, tags: Sequence[PlacedTag], note: str) -> Deployment:
    edges = np.array([np.nan if tag.edge is None else float(f"{tag.edge:.{EDGE_DIGITS}g}") for tag in tags])
    labels = Labels(np.array([tag.number for tag in tags]))
    axes = np.array([tag.axes for tag in tags])
    positions: FloatArray = np.array([tag.position for tag in tags])
    deployment = Deployment(positions, axes[:, :, 2], labels=labels, edges=edges, note=note)
    return deployment.turned(path, axes[:, :, 1])


def write_map_covariance(path: Path, ids: IntArray, positions: FloatArray, covariance: FloatArray) -> None:
    """Write the joint covariance of the errors in the poses of all tags.

    The error of a pose is a twist in the frame of its tag, three rotations before three shifts.

    Args:
        path: file.
        ids: ids of the K tags, ascending, `(K,)`.
        positions: positions of the tags, metres, `(K, 3)`. A reader compares them with its map, and refuses the file of
            another map.
        covariance: joint covariance of the K twists, rad and metres, `(6 K, 6 K)`; its upper triangle is written, row
            by row.
    """
    upper = covariance[np.triu_indices(len(covariance))]
    with path.open("wb") as file:
        np.savez_compressed(file, ids=ids, positions=positions, upper=upper.astype(np.float32))


def read_map_covariance(path: Any, name: str, tags: Deployment) -> tuple[IntArray, FloatArray]:
    """Read the joint covariance of the errors in the poses of the map `tags`, see `write_map_covariance`.

    Returns:
        ids of K tags, ascending, `(K,)`; and covariance of their twists, rad and metres, `(6 K, 6 K)`.

    Raises:
        InputError: the file cannot be read, is not a covariance of a map, or is of another map than `tags`.
    """
    refused = InputError(f"{name}: {str(path)!r} is not a covariance of a map, as a survey writes it.", name)
    try:
        arrays = arrays_of(path, name, LARGEST_COVARIANCE, most=LARGEST_COVARIANCE) or {}
        ids, positions, upper = arrays["ids"], arrays["positions"], arrays["upper"]
    except (KeyError, InputError):
        raise refused from None
    size = 6 * len(ids) if ids.ndim == 1 else 0
    if ids.dtype.kind != "i" or upper.dtype.kind != "f" or not size or upper.shape != (size * (size + 1) // 2,):
        raise refused
    if positions.shape != (len(ids), 3) or positions.dtype.kind != "f":
        raise refused
    _, here, there = np.intersect1d(tags.ids, ids, return_indices=True)
    if not np.allclose(tags.places[here], positions[there], rtol=0.0, atol=SAME_POSITION):
        text = f"{name}: {str(path)!r} is of another survey than the map beside it: take both files from one survey"
        raise InputError(f"{text}, or remove {FILE}.", name)
    found = np.zeros((size, size))
    found[np.triu_indices(size)] = upper
    found += np.triu(found, 1).T
    if not np.isfinite(found).all() or (np.diag(found) < 0.0).any() or (np.diff(ids) <= 0).any():
        raise refused
    return ids.astype(np.int64), found


@dataclass(frozen=True)
class FileDeployment(Checked, ExistingDeployment):
    """Deployment from a CSV, written by `Deployment.to_csv` or by another program, or from a tag map.

    Args:
        path: path of the file, see `lmd.formats.tag_maps.read_deployment`.
        count: number K of landmarks; if given, the file must have exactly K rows.
        free: True to skip the checks of the placement. Landmarks may then be on no surface, outside the room or the
            allowed regions, or face into their surface. Tags with their white margins may then overlap.
        family: family of the tags, instead of the family of the scene's tag.
        axes: directions, in words, of the axes x, y and z of a tag's frame in a table, see
            `lmd.formats.placed_tag.axes_of`.
        columns: for a text that does not name its columns, names of the columns, or name of a program, see
            `lmd.formats.columns.LAYOUTS`.

    Raises:
        InputError: `free` is neither true nor false, or the axes do not form a frame.
    """

    path: str | None
    count: int | None = None
    free: Switch = False
    family: str | None = None
    axes: tuple[str, ...] | None = None
    columns: str | tuple[str, ...] | None = None

    def _validate(self) -> None:
        axes_of(self.axes)

    def draw(self, room: Space, rng: np.random.Generator, tag: Tag = POINT) -> Deployment:
        """See `DeploymentSource.draw`."""
        if self.path is None:
            raise InputError("path is missing: a CSV of landmarks or a tag map is needed.", "path")
        family = None if tag.is_point else self.family or tag.family
        deployment = read_deployment(self.path, family=family, axes=self.axes, columns=self.columns)
        if self.count is not None and self.count != len(deployment):
            raise InputError(f"count = {self.count}, but {self.path} has {len(deployment)} landmarks.", "count")
        with said_of(self.path):
            hung = deployment.with_surfaces(room, self.free, tag.paper_share * deployment.edges_of(tag))
        if not self.free and (fault := hung.fault(room, near=True)):
            raise InputError(f"free = false, but in {self.path} {fault}.", "free")
        return hung

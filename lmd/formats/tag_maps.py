"""Tag maps of several ecosystems, read as deployments; `lmd.export` writes tag maps.

Source: `convert_apriltag_layouts.py` of WPILib.
"""

import re
from collections.abc import Sequence
from functools import cached_property
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.formats import tag_map_readers as readers
from lmd.formats.opencv_calibrations import xml_of
from lmd.formats.placed_tag import RIGHT_UP_OUT, Found, Keys, PlacedTag, axes_of, check_family, one_family
from lmd.formats.registry import File, read
from lmd.formats.tag_tables import deployment_of
from lmd.scene.deployment import Deployment
from lmd.scene.families import FAMILIES
from lmd.scene.labels import Labels

LARGEST_MAP = 1 << 22  # greatest number of characters of YAML or JSON; a tag has some hundred
EDGE_DIGITS = 12  # decimals of an edge, metres; further digits are rounding errors of conversions
IS_JSON = re.compile(r"(?:\s++|//[^\n]*\n|/\*(?>.*?\*/))*+{", re.DOTALL)  # comments may come first
IS_YAML = re.compile(r"%YAML|---|(?!Unnamed: )\s*['\"]?[\w/*:]+['\"]?\s*:(?:\s|$)")


class TagMapFile(File):
    """File of a tag map; a text that is neither YAML nor JSON has no keys."""

    @cached_property
    def has_keys(self) -> bool:
        """True for YAML and JSON."""
        return bool(IS_JSON.match(self.text) or IS_YAML.match(self.first))

    @cached_property
    def root(self) -> Element | None:
        """Outermost element of XML; None for another text.

        Raises:
            InputError: the text begins like XML but is broken, or has entities.
        """
        return xml_of(self.text)

    @cached_property
    def keys(self) -> Keys:
        """Keys of the map; for a node of ROS 2, the keys below its parameters.

        Raises:
            InputError: the text begins like YAML or JSON but is broken, or is too long.
        """
        if not self.has_keys:
            return {}
        if len(self.text) > LARGEST_MAP:
            raise InputError(f"a map has at most {LARGEST_MAP} characters, it has {len(self.text)}.")
        return readers.parameters_of(super().keys)


def read_deployment(
    path: Any,
    name: str = "path",
    family: str | None = None,
    axes: Sequence[str] | None = None,
    columns: str | Sequence[str] | None = None,
) -> Deployment:
    """Read the tags of a map, or the landmarks of a table, see `lmd.formats.landmark_table`.

    Tag sizes in the file become `Deployment.edges`.

    Args:
        name: name of the argument with the path, for messages.
        family: family of the tags, which the file must not contradict, and on which OpenCV's up depends; None for
            points.
        axes: directions of the axes of a tag's frame, for a file that does not define them, such as a table, see
            `lmd.formats.placed_tag.axes_of`.

    Raises:
        InputError: the file cannot be read, is no map with poses of tags, or has tags of another family.
    """
    file = TagMapFile(path, name, asked={"columns": columns})
    try:
        found: Found = read("tag map", file)
        if found.table is not None:
            deployment, families = deployment_of(found.table, axes)
            check_family(path, one_family(families), family)
            return deployment
        check_family(path, one_family(tag.family for tag in found.tags), family)
        if not found.tags:
            raise InputError("it has no tags with places.")
        turned = found.by_opencv and family is not None and FAMILIES[family].apriltag
        tags = [tag._replace(axes=tag.axes @ readers.HALF_TURN) for tag in found.tags] if turned else found.tags
        if found.any_frame:
            return _in_frame(path, tags, axes)
        return _deployment(path, tags, found.note)
    except InputError as error:
        known = error.argument in (name, "axes", "columns") or str(path) in str(error)
        raise error if known else InputError(f"{path}: {error}") from None
    except KeyError as error:
        raise InputError(f"{path}: the key {error} is missing.") from None
    except (IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"{path}: a value in it is of another kind than a tag map has there ({error}).") from None


def _in_frame(path: Any, tags: Sequence[PlacedTag], axes: Sequence[str] | None) -> Deployment:
    """Tags with the frame that the user defines by `axes`; an error if the file itself defines the frame."""
    turn = axes_of(axes).T
    note = (
        f"{path}: the axes x, y, z of a tag point {', '.join(RIGHT_UP_OUT if axes is None else axes)}"
        f"{', and axes can say otherwise' if axes is None else ''}"
    )
    return _deployment(path, [tag._replace(axes=tag.axes @ turn) for tag in tags], note)


def _deployment(path: Any, tags: Sequence[PlacedTag], note: str) -> Deployment:
    edges = np.array([np.nan if tag.edge is None else float(f"{tag.edge:.{EDGE_DIGITS}g}") for tag in tags])
    labels = Labels(np.array([tag.number for tag in tags]))
    axes = np.array([tag.axes for tag in tags])
    positions: FloatArray = np.array([tag.position for tag in tags])
    deployment = Deployment(positions, axes[:, :, 2], labels=labels, edges=edges, note=note)
    return deployment.turned(path, axes[:, :, 1])

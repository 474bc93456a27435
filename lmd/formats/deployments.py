"""Deployments from files: a table of landmarks, or a tag map."""

from dataclasses import dataclass

import numpy as np

from lmd.core.checks import Checked, InputError, Switch, said_of
from lmd.formats.placed_tag import axes_of
from lmd.formats.tag_maps import read_deployment
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import POINT, ExistingDeployment
from lmd.scene.tag import Tag
from lmd.space.space import Space


@dataclass(frozen=True)
class FileDeployment(Checked, ExistingDeployment):
    """Deployment from a CSV, written by `Deployment.to_csv` or by another program, or from a tag map.

    Args:
        path: path of the file, see `lmd.formats.tag_maps.read_deployment`.
        count: K; if given, the file must have that many rows.
        free: True if the placement is not checked: landmarks may be on no surface, outside the room or the allowed
            regions, or face into their surface, and papers may overlap.
        family: family of the tags, instead of the family of the scene's tag.
        axes: directions of x, y and z of a tag's frame in a table, see `lmd.formats.placed_tag.axes_of`.
        columns: names of the columns of a text that does not name them, or the name of a program, see
            `lmd.formats.columns.LAYOUTS`.

    Raises:
        InputError: `free` is neither true nor false, or the axes are no frame.
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

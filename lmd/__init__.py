"""Landmark deployment: places for fiducial markers from which a camera can localise itself.

A `Scene` has a room, a camera, a PDF of the camera's orientations and a visibility model. A `Problem` has a scene, an
objective and a source of start deployments. `optimise` finds a deployment for a problem; `evaluate` scores any.

    >>> import lmd
    >>> room = lmd.Cuboid(size=(3.2, 3.2, 1.7), reachable_size=(2.6, 2.6, 1.2), spacing=0.8)
    >>> camera = lmd.Camera(focal_length=4.03, pixel_width=0.0033, pixel_height=0.0033, principal_point=(960, 540),
    ...                     image_width=1920, image_height=1080, aperture=1.44)
    >>> scene = lmd.Scene(room, camera, lmd.pdf.level_flight(), lmd.Visibility(thold=0.28))
    >>> problem = lmd.Problem(scene, lmd.Coverage(n=2, thold_p=0.7), lmd.RandomDeployment(count=20))
    >>> result = lmd.optimise(problem, evaluations=60, seed=0)
    >>> len(result.deployment)
    20
    >>> lmd.evaluate(problem, result.deployment)["fitness"] == result.fitness
    True

Most users need only the names exported here; the packages `lmd.<package>` have more.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lmd.core.checks import InputError as InputError
    from lmd.formats.meshes import read_mesh as read_mesh
    from lmd.formats.tag_maps import FileDeployment as FileDeployment
    from lmd.geometry.camera import Camera as Camera
    from lmd.objectives.coverage import Coverage as Coverage
    from lmd.objectives.localisation import Localisation as Localisation
    from lmd.objectives.sampling import Sampling as Sampling
    from lmd.optimisers.annealing import Annealing as Annealing
    from lmd.optimisers.base import Result as Result
    from lmd.optimisers.ledger import Budget as Budget
    from lmd.plot.scenes import save_scene_figure as save_scene_figure
    from lmd.problem import Problem as Problem
    from lmd.run import evaluate as evaluate
    from lmd.run import optimise as optimise
    from lmd.scene import pdf as pdf
    from lmd.scene.deployment import Deployment as Deployment
    from lmd.scene.deployment_sources import RandomDeployment as RandomDeployment
    from lmd.scene.deployment_sources import UniformDeployment as UniformDeployment
    from lmd.scene.rig import Mount as Mount
    from lmd.scene.rig import Rig as Rig
    from lmd.scene.scene import Scene as Scene
    from lmd.scene.tag import Tag as Tag
    from lmd.sight.models.fiducial import Fiducial as Fiducial
    from lmd.sight.models.paper import Visibility as Visibility
    from lmd.space.cuboid import Cuboid as Cuboid
    from lmd.space.floor_plan import FloorPlan as FloorPlan
    from lmd.space.mesh_room import MeshRoom as MeshRoom
    from lmd.space.parts import Reachable as Reachable
    from lmd.space.prism import Prism as Prism
    from lmd.space.scan import Scan as Scan

# Modules of the names. A module is imported at the first use of a name, as numba alone takes a second to load.
_HOMES = {
    name: module
    for module, names in {
        "lmd.core.checks": "InputError",
        "lmd.formats.meshes": "read_mesh",
        "lmd.formats.tag_maps": "FileDeployment",
        "lmd.objectives": "Coverage Localisation Sampling",
        "lmd.optimisers.annealing": "Annealing",
        "lmd.optimisers.base": "Budget Result",
        "lmd.plot.scenes": "save_scene_figure",
        "lmd.problem": "Problem",
        "lmd.run": "evaluate optimise",
        "lmd.scene": "Camera Deployment Mount RandomDeployment Rig Scene Tag UniformDeployment",
        "lmd.sight.models": "Fiducial Visibility",
        "lmd.space": "Cuboid FloorPlan MeshRoom Prism Reachable Scan",
    }.items()
    for name in names.split()
}

__version__ = "0.1.0"
__all__ = [*_HOMES, "__version__", "pdf"]


def __getattr__(name: str) -> Any:
    if name == "pdf":
        return importlib.import_module("lmd.scene.pdf")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'lmd' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)

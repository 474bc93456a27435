"""Parts of a problem: camera or rig, positions and orientations, tags and their deployment, and visibility criteria."""

from lmd.geometry.camera import Camera
from lmd.scene.deployment import Deployment
from lmd.scene.deployment_sources import RandomDeployment, UniformDeployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.scene.tag import Tag

__all__ = ["Camera", "Deployment", "Mount", "RandomDeployment", "Rig", "Scene", "Tag", "UniformDeployment"]

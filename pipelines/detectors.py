"""The configured detectors."""

from typing import TYPE_CHECKING

from omegaconf import DictConfig

from .building import instantiate, settings_of

if TYPE_CHECKING:
    from lmd.detection.detectors import Detector


def detector_of(cfg: DictConfig, name: str) -> "Detector":
    """The detector that is called `name` in `detectors`.

    Raises:
        InputError: there is none, it refuses its arguments, or does not read the family of the tags.
    """
    from lmd.core.checks import InputError
    from lmd.scene.tag import FAMILIES

    settings = settings_of(cfg, f"detectors.{name}")
    try:
        detector: Detector = instantiate(settings)
    except InputError:
        family = FAMILIES.get(str(settings.get("family")))
        if family is None or family.apriltag:
            raise
        text = f"tag.family = {settings.family} is one of ArUco's, which the detector {name} does not read"
        raise InputError(f"{text}: detectors=[aruco] does.") from None
    return detector

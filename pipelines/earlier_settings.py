"""What runs of earlier versions had recorded as their settings, as they would be recorded now."""

from typing import Any

from omegaconf import DictConfig, OmegaConf

from .app import flat_settings
from .hyperparameters import GROUPS, completed

OWN_ENCODING, ENCODING = "optimiser.encoding", "encoding.kind"


def settings_now(settings: dict[str, Any], cfg: DictConfig) -> dict[str, Any]:
    """Flat settings with the defaults of the classes of the optimiser and the camera, and the encoding that was used.

    Earlier versions recorded neither: of an optimiser only what its file said, and `encoding.kind` even where the
    optimiser had an encoding of its own.

    Args:
        cfg: names the classes.
    """
    now = flat_settings(OmegaConf.create({group: completed(cfg[group]) for group in GROUPS})) | settings
    own = now.pop(OWN_ENCODING, None)
    return now if own is None else now | {ENCODING: own}

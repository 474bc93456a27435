"""Construction of a visibility model and of the crowd in the way."""

from copy import deepcopy
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf, open_dict

from .nodes import instantiate, keyed

if TYPE_CHECKING:
    from lmd.problem import Problem
    from lmd.scene.criteria import Criteria
    from lmd.space.crowd import Crowd


def visibility_of(node: DictConfig) -> "tuple[Criteria, Crowd | None]":
    """Build the visibility model and the crowd of the group `visibility`; None without a crowd.

    Raises:
        InputError: a setting is refused.
    """
    import inspect

    from lmd.core.checks import InputError
    from lmd.space.crowd import Crowd

    alone = deepcopy(node)
    with open_dict(alone):
        given = alone.pop("crowd", None)
    plain = OmegaConf.to_container(given, resolve=True) if OmegaConf.is_config(given) else given
    criteria = instantiate(alone)
    if plain is None or plain == 0:
        return criteria, None
    settings: dict[str, Any] = plain if isinstance(plain, dict) else {"number": plain}  # type: ignore[assignment]
    known = tuple(inspect.signature(Crowd).parameters)
    for key in settings:
        if key not in known:
            raise InputError(f"visibility.crowd.{key} is no setting that is known; a crowd has {', '.join(known)}.")
    with keyed("visibility.crowd"):
        return criteria, Crowd(**{"number": None, **settings})


def refuse_crowd(problem: "Problem", command: str) -> None:
    """Raise `InputError` if somebody is in the way, which a command ignores."""
    from lmd.core.checks import InputError

    if problem.scene.crowd is not None:
        raise InputError(f"{command} does not work with visibility.crowd: leave it out.")

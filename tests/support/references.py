"""Formulas and rules that the library must agree with, written apart from it."""

import re

import numpy as np
import yaml

from lmd.geometry.squares import corners, upright
from lmd.sight.reference import coverage_caps


def view_matrices(scene, deployment, position, axes):
    """Information on position and rotation of each landmark, zero in views that do not cover it, `(A, K, 6, 6)`."""
    points = corners(deployment.positions, deployment.normals, upright(deployment.normals)[1], scene.tag.edge or 0.0)
    offset = points - position
    distance = np.linalg.norm(offset, axis=-1)[..., None]
    b = offset / distance
    cross = np.cross(np.eye(3), b[..., None, :])  # -[b]x
    towards = np.eye(3) - b[..., :, None] * b[..., None, :]
    jacobian = np.concatenate([-towards / distance[..., None], -cross], axis=-1)  # (K, 4, 3, 6)
    information = np.einsum("kcia,kcib->kab", jacobian, jacobian)
    centre = deployment.positions - position
    with np.errstate(all="ignore"):  # of a landmark that is not covered the depth may be anything
        weight = (np.linalg.norm(centre, axis=1) / (axes[:, :3] @ centre.T)) ** 3
    covered = np.where(coverage_caps(scene, deployment, position, axes), weight, 0.0)
    return covered[..., None, None] * information


NODE_KEY = "ros__parameters"
TRUE, FALSE = ({form for word in words for form in (word, word.capitalize(), word.upper())} for words in
               (("y", "yes", "true", "on"), ("n", "no", "false", "off")))  # fmt: skip
INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9]\d*)")  # of strtol
DOUBLE = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|\.?inf|infinity|\.?nan)", re.IGNORECASE)  # of strtod
NODE = re.compile(r"(/?(\w+|\*\*)/)*([A-Za-z_]\w*|\*)|/\*\*")


def parameters(text):
    """Values of the parameters by node and dotted name; `ValueError` where a node would abort."""
    events = [event for event in yaml.parse(text) if not isinstance(event, yaml.StreamStartEvent)]
    if any(isinstance(event, yaml.AliasEvent) for event in events):
        raise ValueError("Will not support aliasing")
    found, rest = {}, iter(events[1:])
    _nodes(next(rest), rest, "", found)
    return found


def _keys(event, rest, what):
    if not isinstance(event, yaml.MappingStartEvent):
        raise ValueError(f"{what}: Cannot have a value before {NODE_KEY}")
    key = next(rest)
    if isinstance(key, yaml.MappingEndEvent):
        raise ValueError(f"{what}: an empty mapping ends the mapping around it")
    while not isinstance(key, yaml.MappingEndEvent):
        yield key.value
        key = next(rest)


def _nodes(event, rest, name, found):
    for key in _keys(event, rest, name):
        if key == NODE_KEY:
            if not NODE.fullmatch(name):
                raise ValueError(f"{name!r} is no name of a node")
            _values(next(rest), rest, "", found.setdefault(name, {}))
        else:
            _nodes(next(rest), rest, f"{name}/{key}".lstrip("/") if name else key, found)


def _values(event, rest, within, found):
    for key in _keys(event, rest, within):
        name, value = f"{within}{key}", next(rest)
        if isinstance(value, yaml.MappingStartEvent):
            _values(value, rest, f"{name}.", found)
        elif isinstance(value, yaml.ScalarEvent):
            found[name] = _scalar(value, name)
        else:
            found[name] = []
            while not isinstance(entry := next(rest), yaml.SequenceEndEvent):
                found[name].append(_scalar(entry, name))
            if len({type(one) for one in found[name]}) != 1:
                raise ValueError(f"{name}: Sequence should be of same type, and not empty")


def _scalar(event, name):
    if not isinstance(event, yaml.ScalarEvent):
        raise ValueError(f"{name}: a list must hold numbers or texts")
    if event.style in ("'", '"'):
        return event.value
    if not event.value:
        raise ValueError(f"{name}: No value")
    if event.value in TRUE | FALSE:
        return event.value in TRUE
    if INTEGER.fullmatch(event.value):
        return int(event.value, 0 if "x" in event.value.lower() else 8 if event.value.lstrip("+-")[0] == "0" else 10)
    return float(event.value.lstrip(".")) if DOUBLE.fullmatch(event.value) else event.value

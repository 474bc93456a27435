"""Tag maps in the formats of this project: a table and a JSON document."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.tables import write_table
from lmd.formats.columns import FAMILY
from lmd.formats.tag_map import QUATERNION, TagMap
from lmd.scene.deployment import COLUMNS, UP_COLUMNS
from lmd.scene.edges import EDGE
from lmd.scene.labels import ID

CORNER_NAMES = ("top_left", "top_right", "bottom_right", "bottom_left")
FRAME = "metres; z up; of a tag x is right, y up, z out of it; its quaternion turns this frame to the world"


def write_csv(path: Path, tags: TagMap) -> None:
    """Write `tags.csv`: the columns of `Deployment.to_csv`, then quaternion, corners and family."""
    deployment = tags.deployment
    placed = np.hstack([deployment.places, deployment.normals, deployment.ups])
    turned = np.hstack([tags.quaternions, tags.corners.reshape(-1, 12)])
    corners = [f"{corner}_{axis}" for corner in CORNER_NAMES for axis in "xyz"]
    columns: dict[str, Any] = {
        ID: tags.ids,
        **dict(zip((*COLUMNS, *UP_COLUMNS), placed.T, strict=True)),
        **({EDGE: tags.sizes} if deployment.has_own_edges else {}),
        **dict(zip((*QUATERNION, *corners), turned.T, strict=True)),
        FAMILY: [tags.tag.family] * len(tags.ids),
    }
    labels = {} if deployment.labels is None else deployment.labels.columns
    write_table(path, columns | {name: texts for name, texts in labels.items() if name not in columns})


def write_json(path: Path, tags: TagMap) -> None:
    """Write `tags.json`."""
    rows = zip(tags.ids, tags.sizes.tolist(), tags.positions, tags.quaternions, tags.corners, strict=True)
    document = {
        "family": tags.tag.family,
        EDGE: tags.tag.size,
        "frame": FRAME,
        "tags": [
            {
                ID: number,
                EDGE: size,
                "position": position.tolist(),
                "quaternion": dict(zip("wxyz", quaternion.tolist(), strict=True)),
                "corners": dict(zip(CORNER_NAMES, corners.tolist(), strict=True)),
            }
            for number, size, position, quaternion, corners in rows
        ],
    }
    write_document(path, document)


def write_document(path: Path, keys: dict[str, Any]) -> None:
    """Write keys as JSON."""
    path.write_text(f"{json.dumps(keys, indent=1)}\n", encoding="utf-8")

"""What a format of tag maps promises: what it has written is read again."""

import numpy as np

from lmd.formats.tag_map import TagMap
from lmd.formats.tag_maps import read_deployment


def check_format(form, tags, folder):
    """Check that the same file is written each time, and that the tags are read from it with their places and turns.

    What is printed is read by nobody and has no contract. What the readers of others expect only a test of its own can
    tell, see `tests/formats/test_tag_maps.py`.

    Args:
        form: a `lmd.formats.registry.Writer`, with its reader.
        tags: a map that the format can hold.
        folder: is written to.

    Returns:
        the deployment that was read; it has edges if the file says how large the tags are.
    """
    once, again = folder / "once", folder / "again"  # what a file holds decides, not its name
    for path in (once, again):
        form.write(path, tags=tags)
    assert once.read_bytes() == again.read_bytes(), "another file of the same tags"
    deployment, found = tags.deployment, read_deployment(once, family=tags.tag.family)
    np.testing.assert_array_equal(found.ids, deployment.ids)
    for field in ("positions", "normals", "ups"):
        np.testing.assert_allclose(getattr(found, field), getattr(deployment, field), atol=1e-7, err_msg=field)
    if found.has_own_edges:
        np.testing.assert_allclose(TagMap(tags.room, tags.tag, found).sizes, tags.sizes, rtol=1e-9)
    return found

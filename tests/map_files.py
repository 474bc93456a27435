"""Maps of tags that tests write, read, and compare with one tag."""

import json

from numpy.testing import assert_allclose

from lmd.formats.tag_maps import read_deployment

UP = [0.0, 0.0, 1.0]


def reader(folder):
    """A function that writes a text, or an object as JSON, to a file in `folder`, and reads it as a deployment."""

    def read(text, name="map", **options):
        (folder / name).write_text(text if isinstance(text, str) else json.dumps(text))
        return read_deployment(folder / name, **options)

    return read


def assert_is(deployment, number, position, normal, up=UP, atol=1e-9):
    """Assert that a deployment has this tag alone."""
    assert deployment.ids.tolist() == [number]
    found = deployment.positions[0], deployment.normals[0], deployment.ups[0]
    for value, expected in zip(found, (position, normal, up), strict=True):
        assert_allclose(value, expected, atol=atol)

"""The names of surfaces and the ids of tags in the picture."""

from types import SimpleNamespace

import numpy as np
from floor_plans import lab

from lmd.planner.captions import Captions


class Label(SimpleNamespace):
    """A label of viser, with the number of changes."""

    changes = 0

    def __setattr__(self, name, value):
        type(self).changes += 1
        super().__setattr__(name, value)


def captions(surfaces=()):
    """Captions, and their labels by path."""
    labels = {}

    def add_label(path, text, **settings):
        labels[path] = Label(text=text, **settings)
        return labels[path]

    return Captions(SimpleNamespace(add_label=add_label), surfaces), labels


def test_each_surface_is_named_at_its_lower_edge_or_in_its_middle():
    surfaces = lab().surfaces()
    named, labels = captions(surfaces)
    assert [label.text for label in labels.values()] == [surface.name for surface in surfaces]
    for label, surface in zip(labels.values(), surfaces, strict=True):
        a, b = surface.coordinates(label.position)
        assert a == surface.extent[0] / 2.0
        assert b == (surface.extent[1] / 2.0 if surface.name in ("floor", "ceiling") or surface.normal[2] else 0.0)
    named.show_names(False)
    assert not any(label.visible for label in labels.values())


def test_ids_follow_the_tags_and_only_what_changes_is_told():
    named, labels = captions()
    ids, places = np.array([7, 3, 9]), np.arange(9.0).reshape(3, 3)
    named.show_ids(ids, places, 3, True)
    assert [(label.text, label.position, label.visible) for label in labels.values()] == [
        (str(number), tuple(place), True) for number, place in zip(ids, places.tolist(), strict=True)
    ]
    Label.changes = 0
    named.show_ids(ids, places, 3, True)
    assert Label.changes == 0
    named.show_ids(ids, places, 3, False)
    assert [label.visible for label in labels.values()] == [False, True, False]
    named.show_ids(ids[:1], places[:1], None, True)
    assert [label.visible for label in labels.values()] == [True, False, False]
    named.show_ids(ids, places, None, True)
    assert [label.visible for label in labels.values()] == [True, True, True]

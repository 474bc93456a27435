from dataclasses import dataclass

import pytest

from lmd.core.checks import Checked, Count, InputError, Positive


@dataclass(frozen=True)
class Lamp(Checked):
    power: Positive
    hours: Count | None = None

    def _validate(self):
        if self.power == self.hours:
            raise InputError("power is hours.")


def test_fields_are_replaced_by_the_results_of_their_checks():
    assert repr([Lamp(power=4, hours=1e3), Lamp(1.0)]) == "[Lamp(power=4.0, hours=1000), Lamp(power=1.0, hours=None)]"


@pytest.mark.parametrize(
    ("fields", "said"), [((0.0, 0), "power"), ((None,), "power"), ((1.0, 0), "hours"), ((2, 2), "is")]
)
def test_the_first_wrong_field_is_named(fields, said):
    with pytest.raises(InputError, match=rf"{said} (must be|hours)"):
        Lamp(*fields)

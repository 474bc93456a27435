from dataclasses import dataclass

import pytest

from lmd.core.checks import Checked, Count, InputError, Positive


@dataclass(frozen=True)
class Lamp(Checked):
    power: Positive
    hours: Count | None = None

    def _validate(self):
        if self.power == self.hours:
            raise InputError("hours is power.")


def test_fields_are_replaced_by_the_results_of_their_checks():
    assert repr([Lamp(power=4, hours=1e3), Lamp(1.0)]) == "[Lamp(power=4.0, hours=1000), Lamp(power=1.0, hours=None)]"


@pytest.mark.parametrize("fields", [{"power": 0.0, "hours": 0}, {"power": None}, {"hours": 0}, {"hours": 2}])
def test_the_first_wrong_field_is_named(fields):
    with pytest.raises(InputError, match=f"{next(iter(fields))} (must be|is)"):
        Lamp(**({"power": 2.0} | fields))

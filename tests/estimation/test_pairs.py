import numpy as np
import pandas as pd
import pytest

from lmd.estimation.pairs import paired, to_markdown


def figures(errors, shares):
    """Figures of one estimator from `(S,)` position errors and shares by deployment."""
    rows = [
        {"deployment": name, "estimator": "pnp", "seed": seed, "position_error": error, "within_20mm": share}
        for name in errors
        for seed, (error, share) in enumerate(zip(errors[name], shares[name], strict=True))
    ]
    return pd.DataFrame(rows)


def test_flights_are_compared_one_by_one():
    rng = np.random.default_rng(0)
    hard = rng.uniform(0.01, 1.0, 12)  # how hard a flight is matters more than the deployment
    (row,) = paired(figures({"a": hard, "b": 0.8 * hard}, {"a": np.full(12, 0.25), "b": np.full(12, 0.5)})).to_dict(
        "records"
    )
    assert (row["deployment"], row["against"], row["flights"], row["position_better"]) == ("b", "a", 12, 12)
    assert row["position_ratio"] == pytest.approx(0.8)
    assert row["within_20mm_gain"] == pytest.approx(0.25)
    # All of 12 differences have the same sign: 2 of the 2^12 equally likely patterns are as extreme.
    assert row["position_p"] == pytest.approx(2.0 / 2**12)
    assert row["within_20mm_p"] < 0.01


def test_equal_deployments_do_not_differ_and_flights_without_an_estimate_are_left_out():
    errors = np.array([0.1, 0.2, np.nan])
    shares = {"a": [0.0, 0.5, 0.0], "b": [0.0, 0.5, 0.0]}
    (row,) = paired(figures({"a": errors, "b": errors}, shares)).to_dict("records")
    assert (row["flights"], row["position_ratio"], row["position_better"]) == (2, 1.0, 0)
    assert row["position_p"] == row["within_20mm_p"] == 1.0
    none = np.full(3, np.nan)
    (row,) = paired(figures({"a": errors, "b": none}, shares)).to_dict("records")
    assert row["flights"] == 0
    assert np.isnan(row["position_ratio"])
    assert np.isnan(row["position_p"])


def test_the_table_names_both():
    table = figures({"a": [0.1, 0.1], "b": [0.05, 0.05], "c": [0.2, 0.2]}, {key: [0.5, 0.5] for key in "abc"})
    text = to_markdown(paired(table)).splitlines()
    assert len(text) == 4
    assert text[2].startswith("| b | a | pnp | x 0.50 | 2 of 2 flights |")
    assert text[3].startswith("| c | a | pnp | x 2.00 | 0 of 2 flights |")

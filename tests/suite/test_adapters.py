"""The suite as pymoo takes it; docs/suite.md has programs of other libraries, which a test runs."""

import lmd.suite


def test_pymoo_minimises_the_negative_values_of_one_objective_or_two():
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.optimize import minimize

    box, two = lmd.suite.problem("tiny_mean"), lmd.suite.problem("localised_against_tags")
    found = minimize(lmd.suite.pymoo_problem(box), GA(pop_size=8), ("n_eval", 24), seed=0)
    assert found.F[0] == -box(found.X)
    assert -found.F[0] >= max(box(genes) for genes in found.pop.get("X"))
    found = minimize(lmd.suite.pymoo_problem(two), NSGA2(pop_size=8), ("n_eval", 16), seed=0)
    assert (-two(found.X) == found.F).all()

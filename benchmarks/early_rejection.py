"""Could a safe bound reject a move before it is tried exactly? `python benchmarks/early_rejection.py`.

Bounds the smoothed objective after a local move by what the best cap anywhere could add at each position that the new
place reaches, on top of what is left without the landmark, and counts how many moves this bound rejects at the
temperature at which a run of `annealing` ends, beside how many are rejected when tried exactly.
"""

import numpy as np
from hydra import compose, initialize_config_dir

from lmd.coverage.incremental import counts_of, state_of, try_move
from lmd.coverage.kernels import PROBABILITY_ONE
from lmd.coverage.state import fixed_of, scratch_of
from lmd.optimisers.base import Budget
from pipelines.app import CONF, build_optimiser, build_problem

EVALUATIONS = 3000
MOVES = 300


def main() -> None:
    """Measure and print."""
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("optimise")
    problem, single = build_problem(cfg), cfg.optimiser.single
    deployment = build_optimiser(cfg, 0).run(problem, Budget(EVALUATIONS)).deployment
    evaluator, n = problem.evaluator, problem.objective.n
    fixed = fixed_of(evaluator, n)
    state = state_of(fixed, deployment)
    scratch = scratch_of(state)
    rng = np.random.default_rng(0)

    def value(probability: np.ndarray) -> np.ndarray:
        above = probability - problem.objective.thold_p - single.margin
        return 1.0 / (1.0 + np.exp(-above / single.width[-1])) + single.share * probability

    def moved(k: int, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
        try_move(k, *place, *normal, fixed, state, scratch)
        return scratch.units[fixed.place] / PROBABILITY_ONE

    before = state.units[fixed.place] / PROBABILITY_ONE
    # What one more landmark in the direction of any axis would add at each position, at most.
    weight = evaluator.weights / PROBABILITY_ONE
    one_short = (counts_of(state, len(weight))[fixed.place] == n - 1) * weight
    in_cap = fixed.axes.T @ fixed.axes >= evaluator.limits[0]
    best_cap = (one_short @ in_cap).max(axis=1)
    exact, bound = np.empty(MOVES), np.empty(MOVES)
    for i in range(MOVES):
        k = int(rng.integers(problem.count))
        normal = state.normals[:, k]
        step = rng.normal(0.0, single.step[-1], 3) * (normal == 0.0)
        place = np.clip(state.landmarks[:, k] + step, 0.0, problem.scene.room.size)
        exact[i] = (value(moved(k, place, normal)) - value(before)).mean()
        reached = scratch.new.reached[fixed.place]
        without = moved(k, place, -normal)  # nobody sees its back
        most = np.minimum(without + (before - without) + best_cap, 1.0)
        bound[i] = (value(np.where(reached, most, without)) - value(before)).mean()
    threshold = single.temperature[-1] * np.log(rng.random(MOVES))
    print(f"{MOVES} local moves of one landmark at the end of a run of {EVALUATIONS} evaluations:")
    print(f"rejected when tried exactly: {(exact < threshold).mean():.1%}, median gain {np.median(exact):.2e}")
    print(f"rejected by the bound: {(bound < threshold).mean():.1%}, median bound {np.median(bound):.2e}")


if __name__ == "__main__":
    main()

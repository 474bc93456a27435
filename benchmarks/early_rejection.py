"""How many moves does a safe bound reject, and what does it cost? `python benchmarks/early_rejection.py`.

Draws moves of one landmark as a run of `annealing` does at its end, and decides on each by its exact gain and by the
bound on it, with the same random number. Then measures `bound_move` beside a whole trial and a move carried out.
"""

import time

import numpy as np
from hydra import compose, initialize_config_dir
from numba import njit

from lmd.incremental.coverage_field import coverage_field
from lmd.incremental.field import move
from lmd.incremental.trial import bound_move, finish_move
from lmd.optimisers.annealing.proposals import propose
from lmd.optimisers.ledger import Budget
from lmd.pipelines.app import CONF
from lmd.pipelines.building import build_optimiser, build_problem
from lmd.sight.kernels import PROBABILITY_ONE
from lmd.space.surface import SurfaceArrays

EVALUATIONS = 3000
MOVES = 2000
REPEATS = 10


@njit(nogil=True)
def try_all(who, places, surfaces, field, state, scratch, finish):  # type: ignore[no-untyped-def]
    """Try each of the moves, or only bound it; P_n of each, in units."""
    units = np.empty((len(who), len(state.units)), dtype=np.int64)
    for i in range(len(who)):
        bound_move(field, who[i], places[i], surfaces[i], state, scratch)
        if finish:
            finish_move(field, who[i], state, scratch)
        units[i] = scratch.units
    return units


@njit(nogil=True)
def move_all(who, places, surfaces, field, state, scratch):  # type: ignore[no-untyped-def]
    """Carry out each of the moves."""
    for i in range(len(who)):
        move(field, who[i], places[i], surfaces[i], state, scratch)


def main() -> None:
    """Measure and print."""
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("optimise")
    problem, optimiser = build_problem(cfg), build_optimiser(cfg, 0)
    optimiser.run(problem, Budget(EVALUATIONS))
    field = coverage_field(problem.fitness_evaluator, problem.objective.n)
    state = field.state(optimiser.here)
    settings = optimiser.single.settings(1.0, near=optimiser.spread * problem.scene.visibility.spacing)
    rng, room = np.random.default_rng(0), SurfaceArrays.of(problem.scene.room.surfaces())
    who, places = rng.integers(problem.count, size=MOVES), np.empty((MOVES, 6))
    surfaces = np.array([propose(who[i : i + 1], state, room, settings, rng, places[i : i + 1]) for i in range(MOVES)])

    def mean_value(units: np.ndarray) -> np.ndarray:
        probability = units[..., field.index_of] / PROBABILITY_ONE
        above = probability - problem.objective.thold_p - settings.margin
        value = 1.0 / (1.0 + np.exp(-above / settings.width)) + settings.share * probability
        return value @ problem.fitness_relevance / problem.fitness_relevance.sum()

    best = {False: np.inf, True: np.inf}
    units = {}
    scratch = field.scratch(state)
    for _ in range(REPEATS):
        for finish in best:
            began = time.perf_counter()
            units[finish] = try_all(who, places, surfaces, field, state, scratch, finish)
            best[finish] = min(best[finish], time.perf_counter() - began)
    lowest = settings.temperature * np.log(rng.random(MOVES))
    gain, bound = (mean_value(units[finish]) - mean_value(state.units) for finish in (True, False))
    rejected, early = gain < lowest, bound < lowest
    carried_out = np.inf
    for _ in range(REPEATS):
        state = field.state(optimiser.here)
        began = time.perf_counter()
        move_all(who[~rejected], places[~rejected], surfaces[~rejected], field, state, scratch)
        carried_out = min(carried_out, time.perf_counter() - began)
    print(f"{MOVES} moves of one landmark at the end of a run of {EVALUATIONS} evaluations:")
    print(f"rejected: {rejected.mean():.1%}; of these by the bound: {early.sum() / rejected.sum():.1%}")
    print(f"bound: {1e6 * best[False] / MOVES:.1f} us, whole trial: {1e6 * best[True] / MOVES:.1f} us")
    print(f"accepted, trial included: {1e6 * carried_out / (~rejected).sum():.1f} us")


if __name__ == "__main__":
    main()

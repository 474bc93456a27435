"""Optuna searches parameters of `ega` on a problem of the suite: `python examples/tune.py`."""

from functools import partial

import optuna

import lmd
import lmd.suite
from lmd.optimisers.genetic import EGA


def tuned(trials: int = 30, evaluations: int = 500) -> optuna.Study:
    """The study; each trial is the mean of two seeds."""
    problem = lmd.suite.problem("tiny_mean").problem

    def fitness(trial: optuna.Trial) -> float:
        """Mean of the fitness that the parameters of a trial reach."""
        eliminated = trial.suggest_int("eliminated", 0, 15)
        mutation = trial.suggest_float("mutation_probability", 0.001, 0.2, log=True)
        partner = trial.suggest_categorical("partner", ["pool", "survivor"])
        ega = partial(EGA, eliminated=eliminated, mutation_probability=mutation, partner=partner)
        results = [ega(seed=seed).run(problem, lmd.Budget(evaluations)) for seed in range(2)]
        return sum(result.fitness for result in results) / len(results)

    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=0))
    study.optimize(fitness, n_trials=trials)
    return study


if __name__ == "__main__":
    best = tuned()
    print(best.best_params, f"{best.best_value:.2%}")

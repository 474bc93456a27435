"""Contracts of the replaceable parts, as functions that check an implementation.

| part | contract |
| --- | --- |
| criterion: a model of sight, `lmd.scene.criteria.Criteria` | `contracts.criterion.check_criterion` |
| objective: `lmd.objectives.base.Objective` | `contracts.objective.check_objective` |
| field: values updated as landmarks move, `lmd.incremental.field.Field` | `contracts.field.check_field` |
| space: a room, `lmd.space.space.Space` | `contracts.space.check_space` |
| optimiser: `lmd.optimisers.base.Optimiser` | `contracts.optimiser.check_optimiser` |
| estimator: `lmd.estimation.estimators.Estimator` | `contracts.estimator.check_estimator` |
| format: of tag maps, `lmd.formats.registry.Writer` | `contracts.format.check_format` |

Each raises `AssertionError` where a promise is broken. The tests call it on every implementation of the library.
"""

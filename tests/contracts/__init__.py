"""What each part that can be replaced promises, as functions to call on a part of one's own.

| part | contract |
| --- | --- |
| criterion: a model of sight, `lmd.scene.criteria.Criteria` | `contracts.criterion.check_criterion` |
| field: values updated as landmarks move, `lmd.incremental.field.Field` | `contracts.field.check_field` |

Each raises `AssertionError` where a promise is broken. The tests call it on every implementation of the library.
"""

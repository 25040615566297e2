"""The tasks of a study, by the name that a study file and commands have."""

from foten_study.tasks import abx, oddity, paired, rating, threshold
from foten_study.tasks.kind import TaskKind

TASKS: dict[str, TaskKind] = {
    "rating": rating.KIND,
    "paired": paired.KIND,
    "abx": abx.KIND,
    "oddity": oddity.KIND,
    "threshold": threshold.KIND,
}

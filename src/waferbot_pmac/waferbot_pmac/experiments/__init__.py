# SPDX-License-Identifier: Apache-2.0
"""
Experiments: what the axes are commanded to do, as YAML, and the positions that come of it.

The form is given by `experiment.schema.json` beside this file; the shipped experiments are the
`*.yaml` files here. `load_experiment` reads and checks one, `commanded_positions` turns it into
the commanded position of every motor in every servo cycle.
"""

from waferbot_pmac.experiments.evaluation import commanded_positions
from waferbot_pmac.experiments.loading import Experiment, load_experiment, shipped_experiments
from waferbot_pmac.experiments.units import check_units, suits

__all__ = [
    'Experiment',
    'check_units',
    'commanded_positions',
    'load_experiment',
    'shipped_experiments',
    'suits',
]

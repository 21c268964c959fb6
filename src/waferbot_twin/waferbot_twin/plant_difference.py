# SPDX-License-Identifier: Apache-2.0
"""
The mathematical plant beside the multibody plant in closed loop, as in Fig. 4.3 of the thesis.

Both are driven by the same controller and amplifiers through the same experiment, in process. What
differs are the equations of the mechanism, and the method by which they and the motors' are solved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import yaml

from waferbot_plant.description import LAGRANGE, MULTIBODY
from waferbot_plant.description_file import whole_text
from waferbot_plant.plant import description_source, load_machine
from waferbot_twin.engines.inprocess import CHUNK_TICKS, Twin
from waferbot_twin.plan import Plan


@dataclass(frozen=True)
class Difference:
    """Difference of two plants' positions as the encoder of an axis counts them, in m or rad."""

    axis: str
    unit: str
    largest: float
    rms: float
    largest_counts: int
    travel: float

    @property
    def text(self) -> str:
        """The difference as one line."""
        return (
            f'{self.axis}: at most {self.largest:.3g} {self.unit} ({self.largest_counts} counts), '
            f'RMS {self.rms:.3g} {self.unit}, of a motion over {self.travel:.4g} {self.unit}'
        )


def is_mathematical(plan: Plan) -> bool:
    """Return whether the machine of a plan moves by the equations of Appendix B."""
    return load_machine(plan.model.description).description.formulation == LAGRANGE


def multibody_plan(plan: Plan) -> Plan:
    """Return the plan with the same machine by the multibody equations."""
    machine = yaml.safe_load(whole_text(description_source(plan.model.description)))
    machine['formulation'] = MULTIBODY
    text = yaml.safe_dump(machine, sort_keys=False)
    return replace(plan, model=plan.model.with_settings('plant', {'description': text}))


def plant_differences(plan: Plan) -> list[Difference]:
    """
    Run a plan of the mathematical plant on both plants; return how far they come apart, by axis.

    Raises `UserError` if either blows up.
    """
    twins = [
        Twin.of(one.model, one.timing, one.experiment) for one in (plan, multibody_plan(plan))
    ]
    servo, units = twins[0].servo_parameters[0], twins[0].machine.description.axis_units
    axes = twins[0].layout.axes
    largest, squares = np.zeros(len(axes), np.int64), np.zeros(len(axes))
    low, high = np.full(len(axes), np.inf), np.full(len(axes), -np.inf)
    samples = 0
    places = servo['Ixx03']
    while twins[0].tick < plan.ticks:
        ticks = min(CHUNK_TICKS, plan.ticks - twins[0].tick)
        one, other = (twin.advance(ticks).counts[:, places] for twin in twins)
        if len(one) == 0:
            continue
        apart = one - other
        largest = np.maximum(largest, np.abs(apart).max(axis=0))
        squares += np.square(apart.astype(float)).sum(axis=0)
        low, high = np.minimum(low, one.min(axis=0)), np.maximum(high, one.max(axis=0))
        samples += len(one)
    per_count = 1.0 / servo['counts_per_unit']
    rms = np.sqrt(squares / max(samples, 1))
    return [
        Difference(
            axis,
            units[axis],
            float(largest[place] * per_count[place]),
            float(rms[place] * per_count[place]),
            int(largest[place]),
            float((high[place] - low[place]) * per_count[place]),
        )
        for place, axis in enumerate(axes)
    ]
